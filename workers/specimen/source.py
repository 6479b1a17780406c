"""A bench experiment as something that can be diagnosed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from storage.errors import InputError
from storage.values import FloatArray, TetMesh
from workers.diagnosis.diagnosis import Diagnosis
from workers.diagnosis.fit import Fit
from workers.diagnosis.subject import Free, Scan, Subject
from workers.effects.base import Effect
from workers.effects.specimen import specimen_effects
from workers.fem.fields import frame_of
from workers.fem.model import Model, prepare
from workers.fem.problem import Problem
from workers.observation.interface import InterfacePoints
from workers.observation.locate import interpolation
from workers.observation.noise import SegmentationNoise
from workers.organs.specimen import bounds_mpa, is_wall, problem_of, region_of
from workers.specimen.body import FARTHEST_MM, Body, arms
from workers.specimen.hidden import hidden
from workers.specimen.locking import part_of_compliance
from workers.specimen.observed import Observed, observed
from workers.specimen.predict import predict
from workers.specimen.rows import marker_rows, prediction_rows
from workers.specimen.spec import LoadsSpec, SpecimenSpec, read_spec


@dataclass(frozen=True, eq=False)
class Components:
    """Differences between model and observation along x, y and z, point after point.

    Parameters
    ----------
    seen_mm : ndarray, shape (k, 3)
        Observed displacements of k points.
    """

    seen_mm: FloatArray

    def __call__(
        self, points: FloatArray, reference: InterfacePoints
    ) -> tuple[FloatArray, FloatArray]:
        """See `Scan.look`."""
        moved = ((points - reference.points) * reference.normals).sum(axis=1)
        return moved - self.seen_mm.ravel(), reference.normals


class SpecimenSource:
    """The experiment that a YAML file describes; see `workers.cases.source.Source`.

    Parameters
    ----------
    path : Path
        The file; what it names lies relative to its folder.

    Raises
    ------
    InputError
        If the file does not make sense.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.spec: SpecimenSpec = read_spec(path)
        self.body = Body(self.spec, path.parent)
        self._softer: dict[int, float] = {}

    @property
    def name(self) -> str:
        """Of the experiment."""
        return self.spec.name

    @property
    def scans(self) -> list[str]:
        """Names of the loaded states."""
        return [state.name for state in self.spec.states]

    @property
    def files(self) -> list[Path]:
        """The file itself, the mesh and the recordings."""
        folder, mesh = self.path.parent, self.spec.body.mesh
        found = [folder / file for state in self.spec.states for file in state.files]
        return [self.path, *([folder / mesh] if mesh else []), *dict.fromkeys(found)]

    @property
    def free(self) -> list[Free]:
        """Young's modulus of each material."""
        return [Free(name, *bounds) for name, bounds in bounds_mpa(self.spec).items()]

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """What the model of this experiment may lack."""
        spec = self.spec
        loaded = [f.region for load in (*spec.states, *spec.predict) for f in load.forces]
        return specimen_effects(
            spec.unit_down,
            self.body.base_mm,
            region_of(spec.regions[loaded[0]]) if loaded else None,
            weightless=spec.gravity == "not modelled",
            markers=spec.markers is not None,
            clamped=any(is_wall(spec, h.region, self.body.wall_mm) for h in spec.holds),
        )

    @cached_property
    def observed(self) -> Observed:
        """What the recordings show."""
        return observed(self.spec, self.path.parent)

    def check(self) -> None:
        """See whether files, markers and body go together.

        Raises
        ------
        InputError
            Saying what does not.
        """
        for file in self.files:
            if not file.is_file():
                raise InputError(
                    f"{self.path} names {file.name}, which is not at {file.parent}. Give paths "
                    "relative to the file that names them."
                )
        _ = self.observed

    def subject(self, nodes: int, spacing_mm: float = 0.0) -> Subject:
        """See `Source.subject`; markers are where they are, so no spacing counts."""
        hierarchy = self.body.mesh(nodes)
        model, seen = prepare(hierarchy), self.observed
        mesh, softer = hierarchy.finest.mesh, self.part_of_compliance(nodes)
        at = interpolation(mesh, seen.points_mm, FARTHEST_MM)
        return Subject(
            model=model,
            frame=frame_of(mesh.nodes),
            points=components(seen.points_mm),
            at_points=_thrice(at),
            free=self.free,
            scans=[
                Scan(state.name, self.problem(state, softer), Components(moved))
                for state, moved in zip(self.spec.states, seen.moved_mm, strict=True)
            ],
            noise=SegmentationNoise(seen.sd_mm, 1.0, 0.0, seen.sd_mm),
            covariance=seen.covariance,
            bias=np.zeros(len(seen.covariance)),
            arms=self._arms(mesh),
        )

    def finer(self, nodes: int) -> Model | None:
        """Another mesh of the same body, to see what the mesh adds.

        None for a block, whose mesh is known to be too stiff and made good for.
        """
        return prepare(self.body.mesh(nodes)) if self.spec.body.box_mm is None else None

    def problem(
        self, loads: LoadsSpec, softer: float = 1.0
    ) -> Callable[[Mapping[str, float]], Problem]:
        """The nominal model of one state, from the values of the free constants.

        Parameters
        ----------
        loads : StateSpec or PredictSpec
        softer : float
            By which the stiffness is multiplied; see `part_of_compliance`.
        """
        return partial(_problem, self.spec, loads, self.body.wall_mm, softer)

    def predictions(self, subject: Subject, fit: Fit) -> list[dict[str, Any]]:
        """What the fit expects of the states under ``predict``, as plain numbers.

        Parameters
        ----------
        subject : Subject
            Of this source, as the fit had it.
        fit : Fit

        Returns
        -------
        list of dict
            ``state``, and for each point its ``name``, ``displacement_mm`` and ``sd_mm``
            along x, y and z of the body.

        Raises
        ------
        InputError
            If such a state cannot be simulated.
        """
        softer = self.part_of_compliance(len(subject.model.finest.nodes))
        still = Components(np.zeros_like(self.observed.points_mm))
        states = [Scan(s.name, self.problem(s, softer), still) for s in self.spec.predict]
        return prediction_rows(self.observed, predict(subject, fit, states))

    def pictures(
        self, found: Diagnosis, moved: Mapping[str, Sequence[FloatArray]]
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """No pictures: numbers of the markers, of what hides, and of states to come.

        Returns
        -------
        dict
            Empty.
        dict
            ``markers``, see `marker_rows`; ``hidden``, see `workers.specimen.hidden.hidden`;
            ``predictions``.
        """
        subject = found.look.subject
        best = found.best.fit if found.best is not None else found.look.nominal
        return {}, {
            "markers": marker_rows(self.observed, self.scans, found),
            "hidden": hidden(found, self.effects),
            "predictions": self.predictions(subject, best),
        }

    def part_of_compliance(self, nodes: int) -> float:
        """See `workers.specimen.locking`; 1 for a body that comes from a file."""
        box = self.spec.body.box_mm
        if box is None:
            return 1.0
        if nodes not in self._softer:
            points = self.observed.points_mm
            self._softer[nodes] = part_of_compliance(box, nodes, points, self._heaviest())
        return self._softer[nodes]

    def _arms(self, mesh: TetMesh) -> csr_matrix | None:
        """See `Subject.arms`; None where no markers were seen."""
        markers = self.spec.markers
        if markers is None:
            return None
        stated = [marker.outward for marker in markers.markers.values()]
        return _thrice(arms(mesh, self.observed.points_mm, stated, self.observed.names))

    def _heaviest(self) -> Problem:
        """The last state with its weight, of a material in the middle of what is plausible."""
        middle = {free.name: float(np.exp(free.log_mean)) for free in self.free}
        found = self.problem(self.spec.states[-1])(middle)
        return replace(found, gravity_g=self.spec.unit_down)


def components(points_mm: FloatArray) -> InterfacePoints:
    """Each point three times, along x, y and z; each axis is an interface of its own."""
    k = len(points_mm)
    axis = np.tile(np.arange(3, dtype=np.int32), k)
    return InterfacePoints(
        np.repeat(points_mm, 3, axis=0), np.eye(3)[axis], axis, np.ones(3 * k), axis
    )


def _thrice(matrix: csr_matrix) -> csr_matrix:
    """Each row three times."""
    return csr_matrix(matrix)[np.repeat(np.arange(matrix.shape[0]), 3)]


def _problem(
    spec: SpecimenSpec, loads: LoadsSpec, wall_mm: float, softer: float,
    values: Mapping[str, float],
) -> Problem:  # fmt: skip
    return problem_of(spec, loads, {name: softer * E for name, E in values.items()}, wall_mm)
