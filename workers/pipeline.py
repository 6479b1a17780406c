"""The way of a candidate, on one page: phantom > mesh > solve > deform > score.

Values in, values out. Nothing here knows a store or a cluster; `workers.tasks`
does, and calls these in order.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from storage.values import FloatArray, TetMesh, Tissue, Volume
from workers.fem.fields import frame_of
from workers.fem.model import Model
from workers.fem.outcome import Solution
from workers.fem.solve import solve
from workers.images.labels import (
    crop_to_body,
    default_map,
    label_counts,
    relabel,
    resample_labels,
)
from workers.images.read import read_volume
from workers.imaging.warp import warp_labels
from workers.mesh.hierarchy import Hierarchy, build_hierarchy
from workers.organs.breast import Extent, materials_of, problem_of
from workers.phantom.breast import generate_breast
from workers.similarity.score import Scorer, Surface, score_labels
from workers.spec import CaseSpec, ImageSpec, MeshSpec, ModelSpec, PhantomSpec, ScoreSpec

OUTLINE = "outline"


class Watch:
    """Seconds spent in each stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what happens inside."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            self.seconds[name] = self.seconds.get(name, 0.0) + spent


def phantom(spec: PhantomSpec) -> Volume:
    """Tissue labels of a generated breast."""
    return generate_breast(spec.settings, spec.seed).labels


def image(path: Path, spec: ImageSpec) -> Volume:
    """Tissue labels of an image file or folder, cropped to the body."""
    return as_tissues(read_volume(path, spacing_mm=spec.spacing_mm, axes=spec.axes), spec)


def as_tissues(volume: Volume, spec: ImageSpec) -> Volume:
    """A label map of any meaning, as tissues, cropped to the body.

    Without a map, labels must be the numbers of `storage.values.Tissue`.
    """
    names = default_map(volume) if spec.labels is None else spec.labels
    return crop_to_body(relabel(volume, names))


def mesh(labels: Volume, spec: MeshSpec, model: ModelSpec) -> Hierarchy:
    """Tetrahedra of the body, coarse to fine; see `workers.organs.breast.materials_of`."""
    return build_hierarchy(
        materials_of(labels, model), element_size_mm=spec.element_size_mm, nodes=spec.nodes
    )


def simulate(
    model: Model, case: CaseSpec, constants: Mapping[str, float], body: Extent,
    target: Extent | None = None,
) -> Solution:  # fmt: skip
    """Press the body of `model` as the case says; see `workers.organs.breast.problem_of`."""
    frame = frame_of(model.finest.nodes)
    return solve(model, problem_of(case.model, case.load, constants, body, target, frame))


def deform(
    reference: Volume, body: TetMesh, displacement_mm: FloatArray, lattice: Volume | None = None
) -> Volume:
    """The deformed body as labels, on the lattice of the target where there is one."""
    return warp_labels(reference, body, displacement_mm, lattice)


def scorer(target: Volume, spec: ScoreSpec) -> Scorer:
    """What compares candidates, on the lattice of the target (`on_lattice`), with it."""
    return Scorer(target, labels=spec.tissues, surface=spec.surface)


def score_by_tissue(
    target: Volume, candidate: Volume, surface: Surface = "boundary"
) -> dict[str, dict[str, float]]:
    """The score of each tissue of the target on its own, by name, and of the whole `OUTLINE`."""
    body = on_lattice(candidate, target)
    solid = [Tissue(label) for label in label_counts(target) if label != Tissue.AIR]
    alone = score_labels(target, body, solid, surface)
    scores = {tissue.name.lower(): score.as_dict() for tissue, score in alone.items()}
    whole = tuple(tissue for tissue in Tissue if tissue != Tissue.AIR)
    return scores | {OUTLINE: Scorer(target, whole, surface).score(body).as_dict()}


def on_lattice(volume: Volume, lattice: Volume) -> Volume:
    """`volume` on the voxels of `lattice`: itself, or its nearest-neighbour image.

    The box is that of `volume`, not that of `lattice`: nothing is cut off.
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
