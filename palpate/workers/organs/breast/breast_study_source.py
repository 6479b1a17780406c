"""A study as the source of a diagnosis.

The diagnosis uses the model of the study. The searched parameters are its unknown constants, with
the searched intervals as the plausible ones; a parameter that may be zero or negative has no
logarithm and is held at the value found by the search.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

from palpate.storage.values import Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, mesh_whole_body
from palpate.workers.comparison.observation.isosurface import smooth_outline
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.outcome.segmented_scans import SegmentedScans
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant, Values
from palpate.workers.diagnosis.problem.planned_acquisition import Acquisition, ProblemBuilder
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from palpate.workers.mechanics.model_parameters import Bounds, Parameter
from palpate.workers.organs.breast.breast_keys import SPEC, BreastCase, BreastTarget
from palpate.workers.organs.breast.breast_problem import (
    extent_of,
    materials_of,
    pressed_by,
    problem_of,
)
from palpate.workers.organs.breast.scan_facts import in_air, study_noise
from palpate.workers.organs.finished_study import TARGET, FinishedStudySource, SearchedStudy

BreastStudy = SearchedStudy[BreastCase, Volume]
# Name of the mesh of a simulated target among the settings of a study.
TARGET_MESH = "target_mesh"
# Lower end of the plausible interval of a stiffness or a shape constant that was searched from
# zero, relative to its upper end.
LEAST_PART = 0.02


class BreastStudySource(FinishedStudySource[BreastCase, Volume], SegmentedScans):
    """A breast study as a `workers.diagnosis.outcome.diagnosis_source.Source`.

    Its own setting is the mesh of a simulated target; None for an image. Noise by default: half a
    voxel over 4 mm for images, and the voxel error of an interface for a simulated target.
    """

    kind = "breast study"
    spec = SPEC
    needs = "a positive constant, such as E_fat_kpa,"

    @classmethod
    def completed(
        cls, study: BreastStudy, target: BreastTarget, score: Mapping[str, Any]
    ) -> BreastStudy:
        """See `FinishedStudySource.completed`: bodies in air, and the mesh of the target."""
        mesh = None if target.is_image else target.mesh or study.case.mesh
        return replace(
            study,
            reference=in_air(study.reference),
            target=in_air(study.target),
            own={TARGET_MESH: None if mesh is None else mesh.model_dump(mode="json")},
            stated=BreastTarget(volume=TARGET, align=target.align) if target.is_image else None,
        )

    @property
    def scans(self) -> Sequence[str]:
        """The name of the single load."""
        load = self.study.case.load
        if load.force_n is not None:
            return [f"{load.force_n:g} N"]
        distance = load.plate_distance_mm
        known = distance is not None and distance.final is not None
        return [f"{distance.final:g} mm" if distance is not None and known else "plates in place"]

    @property
    def pressed(self) -> Mapping[str, Pressed]:
        """Compression by the plates under the single load."""
        return dict.fromkeys(self.scans, pressed_by(self.study.case.load))

    @property
    def effects(self) -> Sequence[Effect]:
        """The catalogue of the breast without the searched effects."""
        free = {f.name for f in self.free}
        return [e for e in self.study.case.model.law.suspects if not e.is_searched(free)]

    @cached_property
    def free(self) -> list[FreeConstant]:
        """The searched parameters that are positive."""
        case, bounds = self.study.case, self.study.bounds
        shape = case.model.law.constants.names
        found = [_free(case.vocabulary[name], ends, shape) for name, ends in bounds.items()]
        return [f for f in found if f is not None]

    @property
    def loaded(self) -> Sequence[Volume]:
        """The target."""
        return [self.study.target]

    @property
    def not_simulated(self) -> tuple[tuple[str, str], ...] | None:
        """See `TissueLaws.not_simulated`."""
        return self.study.case.model.law.not_simulated

    @property
    def acquisition(self) -> Acquisition:
        """The acquisition before the target was scanned."""
        return Acquisition(
            name=self.name,
            reference=self.study.reference,
            body=self._body,
            mesh=self._mesh,
            noise=self.noise,
            free=self.free,
            loads=list(self.scans),
            problem=self.problem,
            effects=self.effects,
        )

    def problem(self, number: int, frame: Frame) -> ProblemBuilder:
        """Return a builder of the study's problem from values of the free constants."""
        case, imaged = self.study.case, self._target_mesh is None
        oblique = case.load.oblique_deg
        body = extent_of(self.study.reference, oblique)
        target = extent_of(self.study.target, oblique) if imaged else None
        held = {n: v for n, v in self.study.best.items() if n not in {f.name for f in self.free}}

        def build(values: Values) -> Problem:
            constants = case.complete(held | dict(values))
            return problem_of(case.model, case.load, constants, body, target, frame)

        return build

    @property
    def _shares_mesh(self) -> bool:
        """Whether the target was simulated on the mesh of the candidates."""
        return self._target_mesh == self.study.case.mesh.model_dump(mode="json")

    @property
    def _target_mesh(self) -> Mapping[str, Any] | None:
        return self.study.own[TARGET_MESH]

    def _body(self) -> Volume:
        """Return the volume to be meshed, smoothed if its segmentation is rough."""
        body = materials_of(self.study.reference, self.study.case.model)
        if self._shares_mesh or not self.noise.reference_sd_mm:
            return body
        return smooth_outline(body, self.noise.correlation_mm)

    def _mesh(self, body: Volume, nodes: int) -> Hierarchy:
        """Mesh the body, like the candidates if their mesh was used to simulate the target."""
        if not self._shares_mesh:
            return mesh_whole_body(body, nodes=nodes)
        mesh = self.study.case.mesh
        return mesh_whole_body(body, element_size_mm=mesh.element_size_mm, nodes=mesh.nodes)

    @property
    def usual_noise(self) -> SegmentationNoise:
        """See `FinishedStudySource.usual_noise`."""
        imaged = self._target_mesh is None
        return study_noise(self.study.reference, self.study.target, imaged=imaged)


def _free(p: Parameter, bounds: Bounds, shape: Collection[str]) -> FreeConstant | None:
    lower, upper = bounds
    if lower == 0 < upper and (p.name in shape or p.name.startswith(("E_", "eta_"))):
        lower = LEAST_PART * upper
    return FreeConstant(p.name, lower, upper, p.unit) if lower > 0 else None
