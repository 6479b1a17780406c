"""The cornea as an organ of a study: sections, 6-node triangles, an air jet."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from palpate.storage.records.tasks import FreeParameter
from palpate.storage.values import FloatArray, Volume
from palpate.workers.organs.cornea.comparison.section_scorer import SectionScorer
from palpate.workers.organs.cornea.comparison.surface_fit import (
    FittedCornea,
    SurfaceObservation,
    fit_surfaces,
    observe_surfaces,
)
from palpate.workers.organs.cornea.frames.imaged_section import imaged_section
from palpate.workers.organs.cornea.mesh.deformed_section import deformed_section
from palpate.workers.organs.cornea.mesh.quality import t6_quality
from palpate.workers.organs.cornea.mesh.section_mesh import mesh_section
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.problem import candidate_of, jet_nodes_x_mm, middle_of
from palpate.workers.organs.cornea.section.contour_distance import distances
from palpate.workers.organs.cornea.section.generated import generated_section
from palpate.workers.organs.cornea.section.image import CORNEA_LABEL, section_image
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.solver.candidate import Candidate
from palpate.workers.organs.cornea.solver.model_cache import MeshForModels
from palpate.workers.organs.cornea.solver.outcome import CorneaOutcome
from palpate.workers.organs.cornea.solver.solve import solve_prepared
from palpate.workers.organs.cornea.spec import (
    CorneaCase,
    CorneaReference,
    CorneaScore,
    CorneaTarget,
    FrameSpec,
    GeneratedSectionSpec,
    MeshSpec,
)
from palpate.workers.organs.organ import Arrays, Facts
from palpate.workers.spec import Door

# Approximate element count of the coarse mesh for a first fit.
FEWEST_ELEMENTS = 60
_MESH_ARRAYS = ("nodes_mm", "triangles", "anterior", "posterior", "left", "right")


class Cornea:
    """See `workers.organs.organ.Organ`; a body is a `Section`."""

    name = "cornea"
    picture_labels: Mapping[int, str] = {CORNEA_LABEL: "cornea"}

    def body_files(self, spec: Door) -> Sequence[Path]:
        """See `Organ.body_files`."""
        frame = _frame_of(spec)
        return [] if frame is None else [Path(frame.file)]

    def body_settings(self, spec: Door) -> Facts:
        """See `Organ.body_settings`."""
        frame = _frame_of(spec)
        if frame is None:
            return _section_of(spec).model_dump(mode="json")
        return frame.model_dump(mode="json", exclude={"file"})

    def make_body(self, spec: Door) -> Section:
        """See `Organ.make_body`."""
        frame = _frame_of(spec)
        if frame is not None:
            return imaged_section(frame)
        section = _section_of(spec)
        return generated_section(
            anterior_radius_mm=section.radius_mm,
            diameter_mm=section.chord_mm,
            central_thickness_mm=section.central_mm,
            peripheral_thickness_mm=section.peripheral_mm,
            asphericity=section.asphericity,
        )

    def body_to_arrays(self, body: Section) -> Arrays:
        """See `Organ.body_to_arrays`."""
        return {"anterior_mm": body.anterior_mm, "posterior_mm": body.posterior_mm}

    def body_from_arrays(self, arrays: Arrays | Volume) -> Section:
        """See `Organ.body_from_arrays`."""
        if isinstance(arrays, Volume):
            raise TypeError("the body of a cornea is stored as two surfaces")
        return Section(anterior_mm=arrays["anterior_mm"], posterior_mm=arrays["posterior_mm"])

    def simulated_case(self, case: CorneaCase, target: CorneaTarget) -> CorneaCase:
        """See `Organ.simulated_case`."""
        return case if target.mesh is None else case.model_copy(update={"mesh": target.mesh})

    def mesh_settings(self, case: CorneaCase) -> Facts:
        """See `Organ.mesh_settings`: the mesh has nodes at the edges of the jet."""
        jet = case.load.jet
        where = {"centre_mm": jet.centre_mm, "reach_mm": jet.reach_mm}
        return {"mesh": case.mesh.model_dump(mode="json"), "jet": where}

    def make_mesh(self, body: Section, case: CorneaCase) -> T6Mesh:
        """See `Organ.make_mesh`."""
        return mesh_section(body, case.mesh.elements, jet_nodes_x_mm(body, case))

    def mesh_to_arrays(self, mesh: T6Mesh) -> Arrays:
        """See `Organ.mesh_to_arrays`."""
        return {name: getattr(mesh, name) for name in _MESH_ARRAYS}

    def mesh_from_arrays(self, arrays: Arrays) -> T6Mesh:
        """See `Organ.mesh_from_arrays`."""
        return T6Mesh(**{name: arrays[name] for name in _MESH_ARRAYS})

    def facts(self, body: Section, mesh: T6Mesh) -> Facts:
        """See `Organ.facts`."""
        anterior = body.anterior_mm
        thickness = distances(anterior, body.posterior_mm)
        middle = int(np.argmin(np.abs(anterior[:, 0] - middle_of(body))))
        quality = t6_quality(mesh)
        return {
            "chord_mm": float(np.linalg.norm(anterior[-1] - anterior[0])),
            "central_thickness_um": 1000 * float(thickness[middle]),
            "thinnest_um": 1000 * float(thickness.min()),
            "nodes": len(mesh.nodes_mm),
            "triangles": len(mesh.triangles),
            "smallest_shape": quality.smallest_shape,
            "smallest_jacobian": quality.smallest_jacobian,
        }

    def prepare(self, mesh: T6Mesh) -> MeshForModels:
        """See `Organ.prepare`."""
        return MeshForModels(mesh)

    def landmarks(self, body: Section, case: CorneaCase) -> float:
        """Return the x of the middle of the section, in mm."""
        return middle_of(body)

    def problem(
        self,
        model: MeshForModels,
        case: CorneaCase,
        constants: Mapping[str, float],
        landmarks: float,
        target_landmarks: float | None = None,
    ) -> Candidate:
        """See `Organ.problem`."""
        return candidate_of(model, case, constants, landmarks)

    def solve(self, model: MeshForModels, problem: Candidate) -> CorneaOutcome:
        """See `Organ.solve`."""
        return CorneaOutcome(solve_prepared(problem.prepared, problem.constants, problem.load))

    def coarse_case(self, case: CorneaCase, nodes: int) -> CorneaCase:
        """See `DifferentiableOrgan.coarse_case`: there are about two nodes per element."""
        mesh = MeshSpec(elements=max(FEWEST_ELEMENTS, nodes // 2))
        return case.model_copy(update={"mesh": mesh})

    def observation(
        self, body: Section, mesh: T6Mesh, target: Section, imaged: bool
    ) -> SurfaceObservation:
        """See `DifferentiableOrgan.observation`."""
        return observe_surfaces(mesh, target, imaged)

    def fit(
        self,
        model: MeshForModels,
        case: CorneaCase,
        constants: Mapping[str, float],
        free: Sequence[FreeParameter],
        landmarks: float,
        target_landmarks: float | None,
        observation: SurfaceObservation,
    ) -> FittedCornea:
        """See `DifferentiableOrgan.fit`."""

        def candidate_at(values: Mapping[str, float]) -> Candidate:
            return candidate_of(model, case, values, landmarks)

        return fit_surfaces(candidate_at, constants, free, observation)

    def deform(
        self,
        body: Section,
        mesh: T6Mesh,
        displacement_mm: FloatArray,
        target: Section | None = None,
    ) -> Section:
        """See `Organ.deform`."""
        return deformed_section(body, mesh, displacement_mm)

    def scorer(self, target: Section, spec: CorneaScore) -> SectionScorer:
        """See `Organ.scorer`."""
        return SectionScorer(target, spec)

    def picture(self, body: Section) -> Volume:
        """See `Organ.picture`."""
        return section_image(body)


ORGAN = Cornea()


def _frame_of(spec: Door) -> FrameSpec | None:
    if not isinstance(spec, CorneaReference | CorneaTarget):
        raise TypeError(f"a cornea has its own settings, found {type(spec).__name__}")
    return spec.frame


def _section_of(spec: Door) -> GeneratedSectionSpec:
    if not isinstance(spec, CorneaReference) or spec.section is None:
        raise TypeError("a section is generated from the geometry of a reference")
    return spec.section
