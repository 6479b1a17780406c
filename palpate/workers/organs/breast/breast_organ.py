"""The breast as an organ of a study: label volumes, tetrahedra, two plates."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, FreeParameter, Tissue, Volume
from palpate.workers.body.images.image_formats import LabelImage
from palpate.workers.body.images.named_labels import label_tissues, read_tissues
from palpate.workers.body.images.tissue_labels import (
    crop_to_body,
    default_map,
    label_counts,
    relabel,
    resample_labels,
)
from palpate.workers.body.mesh.mesh_hierarchy import (
    Hierarchy,
    from_arrays,
    mesh_whole_body,
    to_arrays,
)
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.common_keys import Door
from palpate.workers.comparison.similarity_score import Scorer, Surface, score_labels
from palpate.workers.comparison.surface_layer import warp_with_skin
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Problem, Solution, frame_of
from palpate.workers.mechanics.fem.discretisation import Model, prepare
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from palpate.workers.organs.breast.breast_keys import (
    BreastCase,
    BreastScore,
    ImageSpec,
    MeshSpec,
    PhantomSpec,
    ReferenceSpec,
)
from palpate.workers.organs.breast.breast_problem import (
    Extent,
    check_skin_layer,
    extent_of,
    materials_of,
    pressed_by,
    problem_of,
)
from palpate.workers.organs.breast.interface_fit import (
    BreastObservation,
    FittedBreast,
    fit_interfaces,
    observe_target,
)
from palpate.workers.organs.breast.scan_alignment import aligned, study_load
from palpate.workers.organs.breast.scan_facts import in_coarser_voxels
from palpate.workers.organs.organ_protocol import Arrays, Facts, Organ, Scores

OUTLINE = "outline"


class Breast(Organ[Volume, Hierarchy, Model]):
    """The breast, whose bodies are volumes of `Tissue` labels."""

    name = "breast"
    picture_labels: Mapping[int, str] = {int(t): t.name.lower() for t in Tissue if t}

    def body_files(self, spec: Door) -> Sequence[Path]:
        """See `Organ.body_files`."""
        if _phantom_of(spec):
            return []
        image = _image_of(spec)
        named_by = [image.labels] if isinstance(image.labels, str) else []
        return [Path(str(given)) for given in (image.volume, *named_by)]

    def body_settings(self, spec: Door) -> Facts:
        """See `Organ.body_settings`."""
        phantom = _phantom_of(spec)
        if phantom is not None:
            return asdict(phantom.settings) | {"seed": phantom.seed}
        image = _image_of(spec)
        how = image.model_dump(mode="json", include={"labels", "spacing_mm", "axes"})
        return how | {"suffix": Path(str(image.volume)).suffix}

    def make_body(self, spec: Door) -> Volume:
        """See `Organ.make_body`."""
        phantom = _phantom_of(spec)
        if phantom is not None:
            return generate_breast(phantom.settings, phantom.seed).labels
        return read_image(_image_of(spec))

    def stored_name(self, spec: Door) -> str | None:
        """See `Organ.stored_name`."""
        if _phantom_of(spec):
            return None
        given = str(_image_of(spec).volume)
        return None if Path(given).exists() else given

    def adapt_stored(self, body: Volume, spec: Door) -> Volume | None:
        """See `Organ.adapt_stored`."""
        image = _image_of(spec)
        if image.spacing_mm is not None or image.axes is not None:
            raise InputError(
                f"{image.volume} is in the store with its own spacing and axes: remove spacing_mm "
                "and axes, or name the file."
            )
        if image.labels is None:
            default_map(body)
            return None
        return as_tissues(body, image)

    def aligned(self, target: Volume, reference: Volume, case: BreastCase) -> tuple[Volume, Facts]:
        """See `Organ.aligned`."""
        labels, motion = aligned(reference, target, study_load(case))
        facts = {
            "shift_mm": list(motion.shift_mm),
            "turn_deg": list(motion.turn_deg),
            "words": motion.words,
        }
        return labels, facts

    def mesh_settings(self, case: BreastCase) -> Facts:
        """See `Organ.mesh_settings`."""
        return {"mesh": case.mesh.model_dump(mode="json"), "layer": case.model.skin == "layer"}

    def make_mesh(self, body: Volume, case: BreastCase) -> Hierarchy:
        """See `Organ.make_mesh` and `workers.organs.breast.breast_problem.materials_of`."""
        return mesh_whole_body(
            materials_of(body, case.model),
            element_size_mm=case.mesh.element_size_mm,
            nodes=case.mesh.nodes,
        )

    def mesh_to_arrays(self, mesh: Hierarchy) -> Arrays:
        """See `Organ.mesh_to_arrays`."""
        return to_arrays(mesh)

    def mesh_from_arrays(self, arrays: Arrays) -> Hierarchy:
        """See `Organ.mesh_from_arrays`."""
        return from_arrays(arrays)

    def facts(self, body: Volume, mesh: Hierarchy) -> Facts:
        """See `Organ.facts`."""
        count = {Tissue(t): n for t, n in label_counts(body).items() if t != Tissue.AIR}
        ml = {t.name.lower(): n * body.voxel_mm3 / 1000 for t, n in count.items()}
        inside = sum(n for t, n in count.items() if t != Tissue.SKIN)
        finest = mesh.finest
        return {
            "voxels": sum(count.values()),
            "spacing_mm": list(body.spacing_mm),
            "body_y_mm": list(extent_of(body)),
            "volume_ml": sum(ml.values()),
            "tissue_ml": ml,
            "glandular_fraction": count.get(Tissue.GLANDULAR, 0) / max(inside, 1),
            "nodes": len(finest.mesh.nodes),
            "tets": len(finest.mesh.tets),
            "levels": [len(level.mesh.nodes) for level in mesh.levels],
            "element_size_mm": mesh.element_size_mm,
        }

    def check(self, case: BreastCase, body: Volume, mesh_facts: Mapping[str, Any]) -> None:
        """See `Organ.check`."""
        if case.model.skin == "layer":
            check_skin_layer(body, mesh_facts["element_size_mm"])

    def prepare(self, mesh: Hierarchy) -> Model:
        """See `Organ.prepare`."""
        return prepare(mesh)

    def landmarks(self, body: Volume, case: BreastCase) -> Extent:
        """Return the extent of the body along the axis of compression, in mm."""
        return extent_of(body, case.load.oblique_deg)

    def problem(
        self,
        model: Model,
        case: BreastCase,
        constants: Mapping[str, float],
        landmarks: Extent,
        target_landmarks: Extent | None = None,
    ) -> Problem:
        """See `Organ.problem` and `workers.organs.breast.breast_problem.problem_of`."""
        frame = frame_of(model.finest.nodes)
        return problem_of(case.model, case.load, constants, landmarks, target_landmarks, frame)

    def solve(self, model: Model, problem: Problem) -> Solution:
        """See `Organ.solve`."""
        return solve(model, problem)

    def coarse(self, body: Volume, spacing_mm: float) -> Volume:
        """See `Organ.coarse`."""
        return in_coarser_voxels(body, spacing_mm)

    def coarse_case(self, case: BreastCase, nodes: int) -> BreastCase:
        """See `Organ.coarse_case`."""
        return case.model_copy(update={"mesh": MeshSpec(nodes=nodes)})

    def observation(
        self, body: Volume, mesh: Hierarchy, target: Volume, imaged: bool
    ) -> BreastObservation:
        """See `Organ.observation`."""
        return observe_target(body, mesh, target, imaged)

    def fit(
        self,
        model: Model,
        case: BreastCase,
        constants: Mapping[str, float],
        free: Sequence[FreeParameter],
        landmarks: Extent,
        target_landmarks: Extent | None,
        observation: BreastObservation,
    ) -> FittedBreast:
        """See `Organ.fit`."""

        def problem_of(values: Mapping[str, float]) -> Problem:
            return self.problem(model, case, values, landmarks, target_landmarks)

        return fit_interfaces(model, problem_of, constants, free, observation)

    def deform(
        self,
        body: Volume,
        mesh: Hierarchy,
        displacement_mm: FloatArray,
        target: Volume | None = None,
    ) -> Volume:
        """See `Organ.deform`."""
        return warp_with_skin(body, mesh.finest.mesh, displacement_mm, target)

    def scorer(self, target: Volume, spec: BreastScore) -> Scorer:
        """See `Organ.scorer`; candidates are on the lattice of the target, see `on_lattice`."""
        return Scorer(target, labels=spec.tissues, surface=spec.surface)

    def pressed(self, case: BreastCase) -> Pressed:
        """Return the compression by the plates; see `Organ.pressed`."""
        return pressed_by(case.load)

    def scores_by_part(
        self, target: Volume, candidate: Volume, spec: BreastScore
    ) -> dict[str, Scores]:
        """See `Organ.scores_by_part`: each tissue of the target, and the whole `OUTLINE`."""
        return score_by_tissue(target, candidate, spec.surface)


ORGAN = Breast()


def read_image(spec: ImageSpec) -> Volume:
    """Read an image file or folder as tissue labels, cropped to the body.

    Raises
    ------
    InputError
        If the image cannot be read or its labels have no known meaning.
    """
    path = Path(str(spec.volume))
    return read_tissues(path, spec.labels, spacing_mm=spec.spacing_mm, axes=spec.axes).volume


def as_tissues(volume: Volume, spec: ImageSpec) -> Volume:
    """Return a stored volume with its labels as tissues, cropped to the body."""
    image = LabelImage(volume, {}, str(spec.volume), anatomical=False)
    return crop_to_body(relabel(volume, label_tissues(image, spec.labels), image.where))


def score_by_tissue(
    target: Volume, candidate: Volume, surface: Surface = "boundary"
) -> dict[str, Scores]:
    """Return the score of each tissue of the target by name, and of `OUTLINE`."""
    body = on_lattice(candidate, target)
    solid = [Tissue(label) for label in label_counts(target) if label != Tissue.AIR]
    alone = score_labels(target, body, solid, surface)
    scores: dict[str, Scores] = {
        tissue.name.lower(): score.as_dict() for tissue, score in alone.items()
    }
    whole = tuple(tissue for tissue in Tissue if tissue != Tissue.AIR)
    return scores | {OUTLINE: Scorer(target, whole, surface).score(body).as_dict()}


def on_lattice(volume: Volume, lattice: Volume) -> Volume:
    """Return `volume` on the voxels of `lattice`: itself, or its nearest-neighbour image.

    The result covers the box of `volume`, so nothing is cut off.
    """
    if volume.on_lattice_of(lattice):
        return volume
    spacing = np.asarray(lattice.spacing_mm)
    count = np.asarray(volume.shape_xyz)
    half = np.asarray(volume.spacing_mm) / 2
    lower = np.asarray(volume.origin_mm) - half
    upper = lower + 2 * half * count
    first = np.floor((lower - lattice.origin_mm) / spacing)
    last = np.ceil((upper - lattice.origin_mm) / spacing)
    nx, ny, nz = (int(n) for n in last - first + 1)
    ox, oy, oz = (float(o) for o in lattice.origin_mm + first * spacing)
    empty = Volume(np.empty((nz, ny, nx), np.uint8), lattice.spacing_mm, (ox, oy, oz))
    return resample_labels(volume, empty)


def _image_of(spec: Door) -> ImageSpec:
    if not isinstance(spec, ImageSpec):
        raise TypeError(f"a breast is described by an ImageSpec, found {type(spec).__name__}")
    return spec


def _phantom_of(spec: Door) -> PhantomSpec | None:
    return spec.phantom if isinstance(spec, ReferenceSpec) else None
