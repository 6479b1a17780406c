"""The cornea as an organ of a study: sections, 6-node triangles, an air jet.

A section is generated, or read from an image file, segmented and corrected for refraction. For
display it is drawn as labelled pixels.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from skimage.draw import polygon2mask

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, FreeParameter, Volume
from palpate.workers.common_keys import Door
from palpate.workers.organs.cornea.cornea_keys import (
    CorneaCase,
    CorneaReference,
    CorneaScore,
    CorneaTarget,
    FrameSpec,
    GeneratedSectionSpec,
    MeshSpec,
)
from palpate.workers.organs.cornea.cornea_problem import (
    Candidate,
    MeshForModels,
    candidate_of,
    jet_nodes_x_mm,
    middle_of,
)
from palpate.workers.organs.cornea.corneal_model import PRESSED_CENTRAL_MM, WIDTH_MM
from palpate.workers.organs.cornea.frame_segmentation import segment_frame
from palpate.workers.organs.cornea.prestressed_equilibrium import CorneaOutcome, solve_prepared
from palpate.workers.organs.cornea.section_comparison import (
    FittedCornea,
    SectionScorer,
    SurfaceObservation,
    fit_surfaces,
    observe_surfaces,
)
from palpate.workers.organs.cornea.section_measures import check_section, distances, shape_of
from palpate.workers.organs.cornea.section_mesh import (
    T6Mesh,
    deformed_section,
    mesh_section,
    t6_quality,
)
from palpate.workers.organs.cornea.section_outline import (
    Section,
    corrected_posterior,
    generated_section,
)
from palpate.workers.organs.cornea.tonometer_frames import (
    Frame,
    likely_causes,
    read_frame,
    read_picture,
)
from palpate.workers.organs.organ_protocol import Arrays, Facts, Organ

CORNEA_LABEL = 5
PIXEL_MM = 0.01
MARGIN_PIXELS = 4


def section_image(section: Section, pixel_mm: float = PIXEL_MM) -> Volume:
    """Return a section as a volume of one slice, z = 0.

    Pixel centres are at integer multiples of the pixel size, so the images of two sections
    share one lattice.

    Parameters
    ----------
    section : Section
    pixel_mm : float
        > 0.

    Returns
    -------
    Volume
        `CORNEA_LABEL` where the centre of a pixel is inside the section, else 0.
    """
    outline = section.outline_mm / pixel_mm
    first = np.floor(outline.min(axis=0)).astype(int) - MARGIN_PIXELS
    columns, rows = np.ceil(outline.max(axis=0)).astype(int) + MARGIN_PIXELS - first + 1
    inside = polygon2mask((int(rows), int(columns)), (outline - first)[:, ::-1])
    x, y = (pixel_mm * first).tolist()
    return Volume(
        (CORNEA_LABEL * inside[None]).astype(np.uint8), (pixel_mm, pixel_mm, pixel_mm), (x, y, 0.0)
    )


# Scales that are tried on a picture in which no cornea is found.
EXPORTED = (2, 3, 4)


def imaged_section(spec: FrameSpec) -> Section:
    """Return the section in an image, in the coordinates of the frame (x from its left edge).

    Raises
    ------
    InputError
        If the file is not an image, no cornea is found in it, or its surfaces cross; with the
        file's name and likely causes in the picture.
    """
    path = Path(spec.file)
    frame = read_frame(path, spec.pixel_mm, spec.first_pixel)
    try:
        section = _section(frame, spec)
        check_section(section)
    except InputError as error:
        causes = likely_causes(read_picture(path)) + _remedy(frame, spec)
        raise InputError(f"{path}: {error}{causes}") from error
    return section


def _section(frame: Frame, spec: FrameSpec) -> Section:
    segmented = segment_frame(frame)
    anterior, posterior = segmented.anterior_mm, segmented.posterior_mm
    if spec.refraction is not None:
        posterior = corrected_posterior(
            anterior, posterior, spec.refraction.index, spec.refraction.camera_angle_deg
        )
    return Section(anterior_mm=anterior, posterior_mm=posterior)


def _remedy(frame: Frame, spec: FrameSpec) -> str:
    """Return advice if a cornea is found in the rotated picture, or with smaller pixels."""
    across, down = frame.spacing_mm
    if _shows_cornea(Frame(np.rot90(frame.grey), (down, across)), spec):
        return " A cornea is found if the picture is rotated by 90 degrees: rotate the file."
    for times in EXPORTED:
        size = (across / times, down / times)
        if _shows_cornea(Frame(frame.grey, size), spec):
            return (
                f" A cornea is found if the picture was exported at {times} times its size: set "
                f"pixel_mm to [{size[0]:.6g}, {size[1]:.6g}], or give the original picture."
            )
    return ""


def _shows_cornea(frame: Frame, spec: FrameSpec) -> bool:
    try:
        shape = shape_of(_section(frame, spec))
    except InputError:
        return False
    return shape.central_thickness_mm in PRESSED_CENTRAL_MM and shape.width_mm in WIDTH_MM


# Approximate element count of the coarse mesh for a first fit.
FEWEST_ELEMENTS = 60
_MESH_ARRAYS = ("nodes_mm", "triangles", "anterior", "posterior", "left", "right")


class Cornea(Organ[Section, T6Mesh, MeshForModels]):
    """The cornea, whose bodies are sections."""

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
        """See `Organ.coarse_case`: there are about two nodes per element."""
        mesh = MeshSpec(elements=max(FEWEST_ELEMENTS, nodes // 2))
        return case.model_copy(update={"mesh": mesh})

    def observation(
        self, body: Section, mesh: T6Mesh, target: Section, imaged: bool
    ) -> SurfaceObservation:
        """See `Organ.observation`."""
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
        """See `Organ.fit`."""

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
