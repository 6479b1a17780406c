"""A completed search of a cornea as a source of a diagnosis.

Points are on both surfaces of the undeformed section; a residual is the distance of such a
point, displaced by the model, from the same surface under the jet. In the terms of
`workers.diagnosis` the outer surface is the outline, and the inner one bounds the gland. The gap in
parts of the surfaces is shown as rows of a summary.

Errors of the first image cause errors of the simulated deformation. The mesh follows a segmented
section. Where that is too thick the cornea is too stiff, and the jet moves all of it less: an error
that is smooth and larger than its cause. 10 um of thickness change the displacement by 50 um.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, Volume
from palpate.workers.common_keys import validated
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise, covariance
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS, FieldSettings
from palpate.workers.diagnosis.linearisation import LinearFit
from palpate.workers.diagnosis.outcome.body_pictures import Displacements
from palpate.workers.diagnosis.outcome.diagnosis_source import SourceContent
from palpate.workers.diagnosis.outcome.diagnosis_summary import RegionGap, Summary
from palpate.workers.diagnosis.outcome.gap_and_shrinkage import region_gap
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant, InverseProblem, Scan
from palpate.workers.diagnosis.problem.planned_acquisition import Acquisition
from palpate.workers.diagnosis.problem.prepared_parts import ReadPrepared
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Frame
from palpate.workers.mechanics.model_parameters import KPA, NUMBER, Unit
from palpate.workers.organs.cornea.cornea_effects import CATALOGUE
from palpate.workers.organs.cornea.cornea_forward import CorneaForward, CorneaProblem
from palpate.workers.organs.cornea.cornea_keys import SPEC, CorneaCase, CorneaScore, CorneaTarget
from palpate.workers.organs.cornea.cornea_organ import ORGAN
from palpate.workers.organs.cornea.cornea_problem import Candidate, candidate_of, prepare
from palpate.workers.organs.cornea.prestressed_equilibrium import deeper
from palpate.workers.organs.cornea.section_comparison import ANTERIOR, POSTERIOR, SurfaceResidual
from palpate.workers.organs.cornea.section_mesh import T6Mesh
from palpate.workers.organs.cornea.section_outline import Section
from palpate.workers.organs.finished_study import (
    REFERENCE,
    TARGET,
    FinishedStudySource,
    SearchedStudy,
)

# Cosine modes of the thickness error along the section, starting with the constant one.
WAVES = 12
GEOMETRY_STEP_MM = 1e-4


def geometry_covariance(
    problem: CorneaProblem, noise: SegmentationNoise, at_points: csr_matrix, normals: FloatArray
) -> FloatArray:
    """Return the covariance of the residuals due to errors of the thickness, shape (k, k).

    Zero if the problem cannot be solved.

    Parameters
    ----------
    problem : CorneaProblem
        A problem with approximately the constants of the eye.
    noise : SegmentationNoise
        Its errors of both surfaces in the first image are used.
    at_points : csr_matrix, shape (k, n)
    normals : ndarray, shape (k, 3)
    """
    solver = CorneaForward()
    equilibrium = solver.equilibrium(None, problem)
    empty = np.zeros((len(normals), len(normals)))
    if noise.reference_sd_mm == 0 or not equilibrium.solution.outcome.converged:
        return empty
    columns, sd = [], []
    for wave, nodal in enumerate(solver.tangents(equilibrium, _changes(problem))):
        columns.append(((at_points @ nodal) * normals).sum(axis=1))
        sd.append(_sd_of_wave(problem.candidate, noise, wave))
    A = np.stack(columns, axis=1) * np.array(sd)
    return np.asarray(A @ A.T)


def _changes(problem: CorneaProblem) -> Sequence[Change]:
    changes = []
    for wave in range(WAVES):
        plus: Any = replace(problem, candidate=_waved(problem.candidate, wave, 1))
        minus: Any = replace(problem, candidate=_waved(problem.candidate, wave, -1))
        changes.append(Change(plus, minus, 2 * GEOMETRY_STEP_MM))
    return changes


def _waved(candidate: Candidate, wave: int, sign: int) -> Candidate:
    """Return a candidate that is thicker by a cosine along the section."""
    prepared = candidate.prepared
    x = prepared.mesh.nodes_mm
    moved = deeper(prepared.mesh, sign * GEOMETRY_STEP_MM) - x
    mesh = replace(prepared.mesh, nodes_mm=x + _cosine(x[:, 0], wave)[:, None] * moved)
    return replace(candidate, prepared=prepare(mesh, prepared.model))


def _cosine(x: FloatArray, wave: int) -> FloatArray:
    return np.asarray(np.cos(np.pi * wave * (x - x.min()) / np.ptp(x)))


def _sd_of_wave(candidate: Candidate, noise: SegmentationNoise, wave: int) -> float:
    """Return the standard deviation of the coefficient of a cosine in the thickness error.

    For an error with the correlation ``exp(-h^2 / 2 l^2)`` over a length L its spectrum gives
    ``sd^2 l sqrt(2 pi) / L exp(-(pi k l / L)^2 / 2)``, twice that for k > 0.
    """
    length = float(np.ptp(candidate.prepared.mesh.nodes_mm[:, 0]))
    scale = noise.correlation_mm
    power = (
        np.sqrt(2 * np.pi) * scale / length * np.exp(-0.5 * (np.pi * wave * scale / length) ** 2)
    )
    both = 2 * noise.reference_sd_mm**2 * power * (2 if wave else 1)
    return float(np.sqrt(both))


SURFACES = ("anterior surface", "posterior surface")


def region_rows(diagnosis: Diagnosis) -> Iterator[RegionGap]:
    """Yield the nominal model's gap on each surface: whole, left, middle and right."""
    inverse, fit = diagnosis.analysis.inverse, LinearFit(diagnosis.analysis.linear)
    x = inverse.frame.normalised(inverse.points.points)[:, 0]
    parts = {
        "all": np.ones(len(x), np.bool_),
        "left third": x < -1 / 3,
        "middle third": abs(x) <= 1 / 3,
        "right third": x > 1 / 3,
    }
    for number, surface in enumerate(SURFACES):
        for region, inside in parts.items():
            chosen = inside & (inverse.points.interface == number)
            if chosen.sum() >= SETTINGS.gap.fewest_residuals:
                yield region_gap(fit, chosen, inverse.scans[0].name, surface, region)


# Lower end of the plausible interval, relative to the upper end, if the search starts near zero.
LEAST_PART = 0.1
# Spacing of points on a surface.
SPACING_MM = 0.15
# Errors of a segmented surface, and their correlation length;
# see `workers.organs.cornea.tonometer_frames`.
SEGMENTED = SegmentationNoise(0.010, 0.5, 0.010, 0.002)
# The same for a simulated section: resolution of the score's pixels of 2 um.
SIMULATED = SegmentationNoise(0.001, 0.5, 0.0, 0.0006)
# A misfit outside the catalogue: amplitude from the segmentation error to a tenth of the motion
# under a jet, correlation length from the thickness of the cornea to a third of its width.
SOMETHING_ELSE = FieldSettings(amplitudes_mm=(0.01, 0.03, 0.1), lengths_mm=(0.6, 1.5, 4.0))


CorneaStudy = SearchedStudy[CorneaCase, Section]
# Name of the part shown by the images, among the settings of a study.
WINDOW = "window_mm"


class CorneaStudySource(FinishedStudySource[CorneaCase, Section]):
    """See `workers.diagnosis.outcome.diagnosis_source.Source`."""

    kind = "cornea study"
    spec = SPEC
    needs = "a constant of the law, such as mu1_pa,"
    stored_reference: ClassVar[Mapping[str, Any]] = {"section": {}}

    @classmethod
    def completed(
        cls, study: CorneaStudy, target: CorneaTarget, score: Mapping[str, Any]
    ) -> CorneaStudy:
        """See `FinishedStudySource.completed`: the window."""
        keys = validated(CorneaScore, score, "The study's score")
        return replace(study, own=keys.model_dump(mode="json", include={WINDOW}))

    @property
    def stored_bodies(self) -> tuple[dict[str, Volume], dict[str, NDArray[Any]]]:
        """Both sections as arrays."""
        sections = {REFERENCE: self.study.reference, TARGET: self.study.target}
        anterior = {f"{name}_anterior": s.anterior_mm for name, s in sections.items()}
        return {}, anterior | {f"{name}_posterior": s.posterior_mm for name, s in sections.items()}

    @classmethod
    def bodies_of(cls, content: SourceContent) -> tuple[Section, Section]:
        """Return both sections."""

        def section(name: str) -> Section:
            return Section(content.arrays[f"{name}_anterior"], content.arrays[f"{name}_posterior"])

        return section(REFERENCE), section(TARGET)

    @property
    def usual_noise(self) -> SegmentationNoise:
        """See `FinishedStudySource.usual_noise`."""
        target = self.study.stated
        return SIMULATED if target is None or target.frame is None else SEGMENTED

    @property
    def scans(self) -> Sequence[str]:
        """Return the name of the only scan, the jet's pressure."""
        return [f"{1000 * self.study.case.load.jet.pressure_mpa:g} kPa"]

    @property
    def effects(self) -> Sequence[Effect]:
        """Return the candidate effects of a cornea, except those that were searched."""
        return [e for e in CATALOGUE.effects if not e.is_searched(self.study.bounds)]

    @cached_property
    def free(self) -> list[FreeConstant]:
        """Return the searched constants of the law."""
        bounds = self.study.bounds
        return [
            FreeConstant(name, max(low, LEAST_PART * high), high, _unit(name))
            for name, (low, high) in bounds.items()
            if name.startswith(("mu", "alpha"))
        ]

    def inverse_problem(
        self, nodes: int, spacing_mm: float, prepared: ReadPrepared | None = None
    ) -> InverseProblem:
        """Mesh the section as in the study and compare its surfaces with the image.

        Mesh and points (`SPACING_MM` apart) are independent of `nodes` and `spacing_mm`, which
        are for a body a hundred times larger.
        """
        study = self.study
        mesh = self._mesh
        points, chosen = surface_points(mesh, study.own[WINDOW])
        rows = np.arange(len(chosen)), chosen
        at_points = csr_matrix((np.ones(len(chosen)), rows), (len(chosen), len(mesh.nodes_mm)))
        model: Any = ORGAN.prepare(mesh)
        near = self.problem()({})
        drawn = geometry_covariance(near, self.noise, at_points, points.normals)
        return InverseProblem(
            model=model,
            frame=frame_of_section(mesh),
            points=points,
            at_points=at_points,
            free=self.free,
            scans=[Scan(self.scans[0], self.problem(), SurfaceResidual(study.target))],
            noise=self.noise,
            covariance=covariance(points, self.noise, 1) + drawn,
            bias=np.zeros(len(points)),
            forward=CorneaForward(),
            something_else=SOMETHING_ELSE,
            is_segmented=False,
        )

    def finer(self, nodes: int, prepared: ReadPrepared | None = None) -> None:
        """Return None: on a finer mesh no point moves by a tenth of a micrometre."""

    def describe(
        self,
        diagnosis: Diagnosis,
        displacements: Displacements,
        summary: Summary,
        prepared: ReadPrepared,
        each: Each = map,
    ) -> tuple[dict[str, NDArray[Any]], Summary]:
        """Return the summary with the surfaces and regions of a cornea."""
        named = replace(
            summary,
            where=tuple(region_rows(diagnosis)),
            surfaces=SURFACES,
            compared="the outer and the inner surface of the cornea",
            not_simulated=CATALOGUE.not_simulated,
        )
        return {}, named

    @property
    def acquisition(self) -> Acquisition:
        """Raise InputError: further images would show the same puff.

        Raises
        ------
        InputError
        """
        raise InputError(
            "Further frames of a cornea cannot be planned. The benefit of several pressures is "
            "among the findings of the study: `palpate report` shows it."
        )

    def problem(self) -> Callable[[Mapping[str, float]], Any]:
        """Return a function from the values of the free constants to the study's model."""
        study = self.study
        meshes, middle = ORGAN.prepare(self._mesh), ORGAN.landmarks(study.reference, study.case)

        def build(values: Mapping[str, float]) -> CorneaProblem:
            constants = study.case.complete(dict(study.best) | dict(values))
            return CorneaProblem(candidate_of(meshes, study.case, constants, middle))

        return build

    @cached_property
    def _mesh(self) -> T6Mesh:
        return ORGAN.make_mesh(self.study.reference, self.study.case)


def surface_points(
    mesh: T6Mesh, window_mm: tuple[float, float] | None
) -> tuple[InterfacePoints, NDArray[np.intp]]:
    """Return nodes of both surfaces inside the window as points, and their indices."""
    nodes, normals, interfaces, lengths = [], [], [], []
    for number, surface in ((ANTERIOR, mesh.anterior), (POSTERIOR, mesh.posterior)):
        line = mesh.nodes_mm[surface]
        kept = _spread(line, window_mm)
        tangent = np.gradient(line, axis=0)[kept]
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        upward = np.stack([-tangent[:, 1], tangent[:, 0], np.zeros(len(tangent))], axis=1)
        nodes.append(surface[kept])
        normals.append(upward if number == ANTERIOR else -upward)
        interfaces.append(np.full(len(tangent), number, np.int32))
        lengths.append(np.full(len(tangent), SPACING_MM))
    chosen = np.concatenate(nodes)
    places = np.pad(mesh.nodes_mm[chosen], ((0, 0), (0, 1)))
    own = np.concatenate(interfaces)
    points = InterfacePoints(places, np.concatenate(normals), own, np.concatenate(lengths), own)
    return points, chosen.astype(np.intp)


def _unit(constant: str) -> Unit:
    return KPA if constant.startswith("mu") else NUMBER


def frame_of_section(mesh: T6Mesh) -> Frame:
    """Return the bounding box of a section, 2 mm thick."""
    low, high = mesh.nodes_mm.min(axis=0), mesh.nodes_mm.max(axis=0)
    (x, y), (half_x, half_y) = ((low + high) / 2).tolist(), ((high - low) / 2).tolist()
    return Frame((x, y, 0.0), (half_x, half_y, 1.0))


def _spread(line: FloatArray, window_mm: tuple[float, float] | None) -> BoolArray:
    """Return a mask of the surface nodes used as points: `SPACING_MM` apart, none at the ends."""
    step = np.linalg.norm(np.diff(line, axis=0), axis=1).mean()
    kept = np.zeros(len(line), np.bool_)
    kept[1 : -1 : max(1, round(SPACING_MM / float(step)))] = True
    if window_mm is not None:
        kept &= (line[:, 0] > window_mm[0]) & (line[:, 0] < window_mm[1])
    return kept
