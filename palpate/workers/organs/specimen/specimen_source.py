"""A bench experiment as a source of a diagnosis."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from palpate.storage.values import BoolArray, FloatArray, Volume
from palpate.workers.common_keys import validated
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.fits.gauss_newton import Fit
from palpate.workers.diagnosis.outcome.body_pictures import Displacements, edge_arrays
from palpate.workers.diagnosis.outcome.diagnosis_source import SourceContent
from palpate.workers.diagnosis.outcome.diagnosis_summary import PredictedState, Summary
from palpate.workers.diagnosis.problem.inverse_problem import (
    FreeConstant,
    InverseProblem,
    Scan,
    at_points_with_forces,
)
from palpate.workers.diagnosis.problem.prepared_parts import ReadPrepared
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.mechanics.fem.loads_and_regions import DisplacementField
from palpate.workers.organs.plausibility_rule import Finding
from palpate.workers.organs.specimen.load_cells import (
    LoadCell,
    covariance_with,
    load_cells,
    readings_mm,
    with_load_cells,
)
from palpate.workers.organs.specimen.marker_and_field_data import Observed
from palpate.workers.organs.specimen.mesh_and_boundary_errors import (
    boundary_covariance,
    part_of_compliance,
    supported,
)
from palpate.workers.organs.specimen.observed_and_predicted import (
    COMPONENTS,
    RecordingNoise,
    marker_states,
    predict,
    predicted_states,
    region_rows,
)
from palpate.workers.organs.specimen.specimen_body import body_of
from palpate.workers.organs.specimen.specimen_checks import (
    confirmed_scatter,
    findings,
    outside_intervals,
)
from palpate.workers.organs.specimen.specimen_effects import (
    BENDING,
    NO_STIFFENING,
    NOT_SIMULATED,
    confounded_effects,
    specimen_effects,
)
from palpate.workers.organs.specimen.specimen_keys import LoadsSpec, SpecimenSpec, StateSpec
from palpate.workers.organs.specimen.specimen_problem import (
    free_constants,
    is_wall,
    problem_of,
    region_of,
)

# Name of the volume in the content of an experiment.
BODY = "body"


@dataclass(frozen=True, eq=False)
class Components:
    """Differences between model and observation along x, y and z, point by point.

    Parameters
    ----------
    seen_mm : ndarray, shape (m,)
        Observed displacements: x, y and z of each point in turn, then readings of load cells.
    """

    seen_mm: FloatArray

    def __call__(
        self, points: FloatArray, reference: InterfacePoints
    ) -> tuple[FloatArray, FloatArray]:
        """See `Scan.compare`."""
        moved = ((points - reference.points) * reference.normals).sum(axis=1)
        return moved - self.seen_mm, reference.normals


class SpecimenSource:
    """A bench experiment; see `workers.diagnosis.outcome.diagnosis_source.Source`.

    Parameters
    ----------
    spec : SpecimenSpec
    observed : Observed
        Points and displacements from its recordings.
    voxels : Volume or None
        The body of its mesh file; None for a block.
    """

    kind = "specimen"

    def __init__(self, spec: SpecimenSpec, observed: Observed, voxels: Volume | None) -> None:
        self.spec = spec
        self.observed = observed
        self.body = body_of(spec, voxels)
        self._softer: dict[int, float] = {}

    @classmethod
    def from_content(cls, content: SourceContent) -> "SpecimenSource":
        """Restore an experiment from stored content."""
        record, arrays = content.record, content.arrays
        spec = validated(SpecimenSpec, record["spec"], "The experiment")
        unseen = np.full((len(spec.predict), *arrays["points_mm"].shape), np.nan)
        observed = Observed(
            points_mm=arrays["points_mm"],
            names=tuple(record["names"]),
            moved_mm=arrays["moved_mm"],
            covariance=arrays["covariance"],
            sd_mm=record["sd_mm"],
            misfit_mm=record["misfit_mm"],
            repeats_mm=tuple(arrays["repeats_mm"].tolist()),
            boundary_mm=arrays["boundary_mm"],
            boundary_moved_mm=arrays["boundary_moved_mm"],
            held_out_points_mm=arrays.get("held_out_points_mm", arrays["points_mm"]),
            held_out_mm=arrays.get("held_out_mm", unseen),
            recording_sd_mm=record.get("recording_sd_mm", record["sd_mm"]),
            notes=tuple(record.get("notes", ())),
            scatter=record.get("scatter", ""),
        )
        return cls(spec, observed, content.volumes.get(BODY))

    @property
    def content(self) -> SourceContent:
        """Content of the file, the recordings and the body of the mesh file."""
        observed, voxels = self.observed, self.body.voxels
        record = {
            "spec": self.spec.model_dump(mode="json"),
            "names": list(observed.names),
            "sd_mm": observed.sd_mm,
            "misfit_mm": observed.misfit_mm,
            "recording_sd_mm": observed.recording_sd_mm,
            "notes": list(observed.notes),
            "scatter": observed.scatter,
        }
        arrays = {
            "points_mm": observed.points_mm,
            "moved_mm": observed.moved_mm,
            "covariance": observed.covariance,
            "repeats_mm": np.array(observed.repeats_mm, np.float64),
            "boundary_mm": observed.boundary_mm,
            "boundary_moved_mm": observed.boundary_moved_mm,
            "held_out_points_mm": observed.held_out_points_mm,
            "held_out_mm": observed.held_out_mm,
        }
        return SourceContent(self.kind, record, {} if voxels is None else {BODY: voxels}, arrays)

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return self.spec.name

    @property
    def scans(self) -> list[str]:
        """Names of the loaded states."""
        return [state.name for state in self.spec.states]

    @property
    def free(self) -> list[FreeConstant]:
        """The fitted constants; see `workers.organs.specimen.specimen_problem.free_constants`."""
        return free_constants(self.spec)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """Effects that the model of this experiment may lack."""
        spec = self.spec
        loaded = [f.region for load in (*spec.states, *spec.predict) for f in load.forces]
        return specimen_effects(
            spec.unit_down,
            self.body.base_mm,
            region_of(spec.regions[loaded[0]]) if loaded else None,
            weightless=spec.gravity == "not modelled",
            markers=spec.markers is not None and spec.body.sheet is None,
            clamped=any(is_wall(spec, h.region, self.body.wall_mm) for h in spec.holds),
            known_nu=all(isinstance(m.nu, float) for m in spec.materials.values()),
            can_stiffen=spec.can_stiffen,
            is_sheet=spec.body.sheet is not None,
            moved=bool(spec.moved_regions),
            cells=self.load_cells,
            most_n=max((abs(r.force_n) for s in spec.states for r in s.reactions), default=0.0),
        )

    @cached_property
    def load_cells(self) -> tuple[LoadCell, ...]:
        """Load cells of the experiment."""
        return load_cells(self.spec, self.observed.sd_mm)

    def findings(self) -> Iterator[Finding]:
        """Yield the reasons why the experiment cannot be diagnosed."""
        yield from findings(self.observed, self.spec, *self.body.box_mm)

    @property
    def caveats(self) -> tuple[str, ...]:
        """No caveats: doubts about the data are part of the summary."""
        return ()

    def inverse_problem(
        self, nodes: int, spacing_mm: float = 0.0, prepared: ReadPrepared | None = None
    ) -> InverseProblem:
        """See `Source.inverse_problem`; `spacing_mm` has no effect on markers."""
        model, observed = self.body.model(nodes), self.observed
        softer = self.part_of_compliance(nodes)
        cells, states = self.load_cells, self.spec.states
        own = self._compared_rows(self.body.at_points(model, observed.points_mm))
        points = with_load_cells(components(observed.points_mm, observed.measured), cells)
        problem = InverseProblem(
            model=model,
            frame=self.body.frame(model),
            points=points,
            at_points=at_points_with_forces(own, len(cells)),
            free=self.free,
            scans=[
                Scan(state.name, self.problem(state, softer), self._compared(moved, state))
                for state, moved in zip(states, observed.moved_mm, strict=True)
            ],
            noise=SegmentationNoise(observed.sd_mm, 1.0, 0.0, observed.sd_mm),
            covariance=covariance_with(observed.covariance, self.spec, cells),
            bias=np.zeros(len(states) * len(points)),
            arms=self._arms(model),
            is_segmented=False,
            forward=self.body.forward(cells),
        )
        return self._with_boundary_noise(problem)

    def finer(self, nodes: int, prepared: ReadPrepared | None = None) -> Model | None:
        """Return another mesh of the same body, to estimate the error of the mesh.

        None if the excess stiffness of the mesh is corrected, and for a sheet, whose mesh error
        is small.
        """
        is_known = self._is_made_good_for or self.spec.body.sheet is not None
        return None if is_known else self.body.model(nodes)

    def problem(
        self, loads: LoadsSpec, softer: float = 1.0
    ) -> Callable[[Mapping[str, float]], Problem]:
        """Return a function from the values of the free constants to the problem of one state.

        Parameters
        ----------
        loads : StateSpec or PredictSpec
        softer : float
            Factor by which the stiffness is multiplied; see `part_of_compliance`.
        """
        measured = self.observed.boundary_of(loads, self.spec) if loads.measured_moves else {}
        return partial(_problem, self.spec, loads, self.body.wall_mm, measured, softer)

    def predictions(self, inverse: InverseProblem, fit: Fit) -> tuple[PredictedState, ...]:
        """Return the predictions of a fit for the states under ``predict``.

        Parameters
        ----------
        inverse : InverseProblem
            Inverse problem of this source that was fitted.
        fit : Fit

        Raises
        ------
        InputError
            If a state cannot be simulated.
        """
        softer = self.part_of_compliance(len(inverse.model.finest.nodes))
        still = Components(np.zeros(len(inverse.points)))
        states = [Scan(s.name, self.problem(s, softer), still) for s in self.spec.predict]
        constants, ends = fit.unknowns.constants(fit.z), []
        for spec, state in zip(self.spec.predict, states, strict=True):
            variance = np.zeros(len(inverse.points))
            if spec.measured_moves:
                added = self._boundary_noise(inverse, [state.problem(constants)])
                variance = np.diag(added)
            ends.append(variance)
        noise = RecordingNoise(self.spec.stated_sd_mm, self.observed.recording_sd_mm)
        found = predict(inverse, fit, states, ends, noise)
        return predicted_states(self.observed, self.spec, self.load_cells, found)

    def describe(
        self,
        diagnosis: Diagnosis,
        displacements: Displacements,
        summary: Summary,
        prepared: ReadPrepared,
        each: Each = map,
    ) -> tuple[dict[str, NDArray[Any]], Summary]:
        """Add markers, confounded effects and predictions to the summary; draw the body's edges."""
        analysis, best = diagnosis.analysis, diagnosis.best
        fit = best.fit if best is not None else analysis.nominal
        model = analysis.inverse.model
        # Load cells are extra nodes after those of the mesh.
        own = {
            when: [u[: len(model.finest.nodes)] for u in moved]
            for when, moved in displacements.items()
        }
        drawn = edge_arrays(model.finest.nodes, self.body.edges(model), own)
        return drawn | {"marker_points": self.observed.points_mm}, replace(
            summary,
            doubts=(
                *confirmed_scatter(self.observed),
                *outside_intervals(self.spec, fit.unknowns.constants(fit.z)),
                *self._supported(
                    analysis.inverse, analysis.nominal.values(), displacements["before"]
                ),
            ),
            data_notes=self.observed.notes,
            where=tuple(region_rows(diagnosis)),
            surfaces=COMPONENTS,
            compared="the measured points",
            not_simulated=(
                *NOT_SIMULATED,
                *(() if self.spec.can_stiffen else (NO_STIFFENING,)),
                *(() if self.spec.body.sheet is None else (BENDING,)),
            ),
            markers=marker_states(self.observed, self.spec, self.load_cells, diagnosis),
            hidden=confounded_effects(diagnosis, self.effects),
            predictions=self.predictions(analysis.inverse, fit),
        )

    def part_of_compliance(self, nodes: int) -> float:
        """Return the correction for excess stiffness of the mesh; 1 if it does not apply.

        It does not apply to a body from a file, which has no lattice, or to one with moved
        regions, whose displacements are not inversely proportional to the stiffness. See
        `mesh_and_boundary_errors`.
        """
        box = self.spec.body.box_mm
        if box is None or not self._is_made_good_for:
            return 1.0
        if nodes not in self._softer:
            points = self.observed.points_mm
            self._softer[nodes] = part_of_compliance(box, nodes, points, self._heaviest())
        return self._softer[nodes]

    @property
    def _is_made_good_for(self) -> bool:
        return self.spec.body.box_mm is not None and not self.spec.moved_regions

    def _supported(
        self, inverse: InverseProblem, nominal: Mapping[str, float], moved_mm: Sequence[FloatArray]
    ) -> tuple[str, ...]:
        """Return warnings of `mesh_and_boundary_errors`; none for a sheet."""
        if self.spec.body.sheet is not None:
            return ()
        problems = [scan.problem(nominal) for scan in inverse.scans]
        return supported(inverse, problems, self.spec.states, moved_mm)

    def _arms(self, model: Any) -> csr_matrix | None:
        """Return `InverseProblem.arms`; None without markers, or on a sheet."""
        markers = self.spec.markers
        if markers is None or self.spec.body.sheet is not None:
            return None
        stated = [marker.outward for marker in markers.markers.values()]
        own = self._compared_rows(
            self.body.arms(model, self.observed.points_mm, stated, self.observed.names)
        )
        return at_points_with_forces(own, len(self.load_cells))

    def _heaviest(self) -> Problem:
        """Return the problem of the last state with self-weight, constants in mid-interval."""
        found = self.problem(self.spec.states[-1])(self._middle)
        return replace(found, gravity_g=self.spec.unit_down)

    @property
    def _middle(self) -> dict[str, float]:
        """Constants in the middle of their intervals."""
        return {free.name: float(np.exp(free.log_mean)) for free in self.free}

    def _compared(self, moved_mm: FloatArray, state: StateSpec) -> Components:
        """Return the observed components of a state: of its points, then of its load cells."""
        seen = moved_mm[self.observed.measured]
        return Components(np.append(seen, readings_mm(state, self.load_cells)))

    def _compared_rows(self, at_points: csr_matrix) -> csr_matrix:
        """Return a row for each compared component, from a matrix with a row for each point."""
        return csr_matrix(at_points)[np.nonzero(self.observed.measured)[0]]

    def _with_boundary_noise(self, problem: InverseProblem) -> InverseProblem:
        """Add the noise of measured boundaries; see `mesh_and_boundary_errors`."""
        if not self.spec.measured_moves:
            return problem
        problems = [self.problem(state)(self._middle) for state in self.spec.states]
        added = self._boundary_noise(problem, problems)
        return replace(problem, covariance=problem.covariance + added)

    def _boundary_noise(self, inverse: InverseProblem, problems: Sequence[Problem]) -> FloatArray:
        def compared(moved_mm: FloatArray) -> FloatArray:
            along = (inverse.at_points @ moved_mm) * inverse.points.normals
            return np.asarray(along.sum(axis=1))

        sd_mm = self.observed.sd_mm
        return boundary_covariance(inverse.forward, inverse.model, compared, problems, sd_mm)


def components(points_mm: FloatArray, measured: BoolArray) -> InterfacePoints:
    """Return each point once for every compared component; each axis is an interface.

    Parameters
    ----------
    points_mm : ndarray, shape (k, 3)
    measured : ndarray of bool, shape (k, 3)
    """
    point, axis = (index.astype(np.int32) for index in np.nonzero(measured))
    return InterfacePoints(points_mm[point], np.eye(3)[axis], axis, np.ones(len(axis)), axis)


def _problem(
    spec: SpecimenSpec,
    loads: LoadsSpec,
    wall_mm: float,
    measured: Mapping[str, DisplacementField],
    softer: float,
    values: Mapping[str, float],
) -> Problem:
    return problem_of(spec, loads, values, wall_mm, measured, softer)
