"""A study, a search for constants, as the source of a diagnosis.

The model is that of the study. Parameters that were searched are the unknown constants,
their intervals the plausible ones; a parameter that may be zero or negative has no
logarithm and is held where the search has ended.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from storage.errors import InputError
from storage.values import Volume
from workers.diagnosis.diagnosis import Diagnosis
from workers.diagnosis.subject import Free, Scan, Subject, Values
from workers.effects.base import Effect
from workers.effects.catalogue import BREAST_EFFECTS
from workers.fem.fields import Frame
from workers.fem.model import Model, prepare
from workers.fem.problem import Problem
from workers.mesh.hierarchy import Hierarchy, build_hierarchy
from workers.observation.noise import SegmentationNoise
from workers.observation.residual import observe, residual
from workers.observation.smooth_outline import smooth_outline
from workers.organs.breast import extent_of, materials_of, problem_of
from workers.parameters import Bounds
from workers.pictures.of_scans import Moved, pictures_of_scans
from workers.planning.foreseen import INTERFACES, ground_of
from workers.planning.prospect import Builder, Prospect
from workers.spec import CaseSpec, MeshSpec

# What an image that somebody has drawn is taken to err by, in voxels, and over which length.
DRAWN_VOXELS, DRAWN_LENGTH_MM = 0.5, 4.0
# The same of labels that the model has moved: their voxels, and what its mesh cuts off the
# body's rim (0.07 mm of a body of 1 mm voxels and 1,500 nodes).
MOVED_VOXELS, MOVED_LENGTH_VOXELS = 0.25, 2.0
NUGGET_VOXELS = 0.08
# A stiffness that was searched from zero is plausible from this part of its upper end.
LEAST_PART = 0.02


@dataclass(frozen=True, eq=False)
class StudyPieces:
    """What a study says and has in its store.

    Parameters
    ----------
    name : str
    case : CaseSpec
    bounds : mapping of str to (float, float)
        Searched intervals, inside names and units.
    best : mapping of str to float
        The searched parameters of the best candidate; empty if there is none.
    reference, target : Volume
        `Tissue` labels at rest and under the load.
    target_mesh : MeshSpec or None
        Of a target that was simulated; None for an image.
    files : sequence of Path
        All that this depends on.
    """

    name: str
    case: CaseSpec
    bounds: Mapping[str, Bounds]
    best: Mapping[str, float]
    reference: Volume
    target: Volume
    target_mesh: MeshSpec | None
    files: Sequence[Path]


class StudySource:
    """See `workers.cases.source.Source`.

    Parameters
    ----------
    pieces : StudyPieces
    noise : SegmentationNoise, optional
        Of both segmentations. Default: half a voxel over 4 mm for images, and what voxels
        leave of an interface for a simulated target.
    """

    def __init__(self, pieces: StudyPieces, noise: SegmentationNoise | None = None) -> None:
        self.pieces = pieces
        self.noise = noise or self._usual_noise()

    @property
    def name(self) -> str:
        """The study's."""
        return self.pieces.name

    @property
    def scans(self) -> Sequence[str]:
        """The one load."""
        load = self.pieces.case.load
        if load.force_n is not None:
            return [f"{load.force_n:g} N"]
        distance = load.plate_distance_mm
        known = distance is not None and distance.final is not None
        return [f"{distance.final:g} mm" if distance is not None and known else "plates in place"]

    @property
    def files(self) -> Sequence[Path]:
        """The study and its volumes."""
        return self.pieces.files

    @property
    def effects(self) -> Sequence[Effect]:
        """What may be missing from the model of a breast, less what was searched."""
        free = {f.name for f in self.free}
        return [e for e in BREAST_EFFECTS if not free & set(e.names)]

    @cached_property
    def free(self) -> list[Free]:
        """The searched parameters that are positive."""
        found = [_free(name, bounds) for name, bounds in self.pieces.bounds.items()]
        return [f for f in found if f is not None]

    @property
    def start(self) -> Values:
        """The free parameters of the best candidate; empty if there is none."""
        return {f.name: self.pieces.best[f.name] for f in self.free if f.name in self.pieces.best}

    def check(self) -> None:
        """Refuse a study that left nothing to fit."""
        if not self.free:
            raise InputError(
                f"The study {self.name} has searched {', '.join(self.pieces.bounds) or 'nothing'}; "
                "a diagnosis needs a constant that is positive, such as E_fat_kpa, under "
                "search.parameters."
            )

    def subject(self, nodes: int, spacing_mm: float) -> Subject:
        """Mesh, points on the interfaces and distance maps."""
        ground = ground_of(self.prospect, nodes, spacing_mm)
        look = partial(residual, observed=observe(self.pieces.target, INTERFACES))
        scan = Scan(self.scans[0], self.problem(0, ground.frame), look)
        return replace(ground, scans=[scan])

    def finer(self, nodes: int) -> Model:
        """Of the same body; that of the study where target and candidates share it."""
        return prepare(self._mesh(nodes))

    def pictures(self, found: Diagnosis, moved: Moved) -> tuple[dict[str, NDArray[Any]], Any]:
        """Bodies, maps and overlaps."""
        return pictures_of_scans(
            found, moved, self.pieces.reference, [self.pieces.target], lambda v: v
        )

    @property
    def prospect(self) -> Prospect:
        """What was known before the target was scanned."""
        return Prospect(
            name=self.name,
            reference=self.pieces.reference,
            mesh=self._mesh,
            noise=self.noise,
            free=self.free,
            loads=list(self.scans),
            problem=self.problem,
            effects=self.effects,
            files=self.files,
        )

    def problem(self, number: int, frame: Frame) -> Builder:
        """The study's model under its load, from the values of the free constants."""
        case, imaged = self.pieces.case, self.pieces.target_mesh is None
        oblique = case.load.oblique_deg
        body = extent_of(self.pieces.reference, oblique)
        target = extent_of(self.pieces.target, oblique) if imaged else None
        held = {n: v for n, v in self.pieces.best.items() if n not in {f.name for f in self.free}}

        def build(values: Values) -> Problem:
            constants = case.complete(held | dict(values))
            return problem_of(case.model, case.load, constants, body, target, frame)

        return build

    def _mesh(self, nodes: int) -> Hierarchy:
        """A target that candidates' own mesh has made errs as they do: only that mesh fits it."""
        case = self.pieces.case
        body = materials_of(self.pieces.reference, case.model)
        if self.pieces.target_mesh == case.mesh:
            size, count = case.mesh.element_size_mm, case.mesh.nodes
            return build_hierarchy(body, element_size_mm=size, nodes=count)
        if self.noise.reference_sd_mm:
            body = smooth_outline(body, self.noise.correlation_mm)
        return build_hierarchy(body, nodes=nodes)

    def _usual_noise(self) -> SegmentationNoise:
        voxel = max(*self.pieces.reference.spacing_mm, *self.pieces.target.spacing_mm)
        nugget = NUGGET_VOXELS * voxel
        if self.pieces.target_mesh is None:
            drawn = DRAWN_VOXELS * voxel
            return SegmentationNoise(drawn, DRAWN_LENGTH_MM, drawn, nugget)
        return SegmentationNoise(MOVED_VOXELS * voxel, MOVED_LENGTH_VOXELS * voxel, 0.0, nugget)


def _free(name: str, bounds: Bounds) -> Free | None:
    lower, upper = bounds
    if lower == 0 < upper and name.startswith(("E_", "eta_")):
        lower = LEAST_PART * upper
    return Free(name, lower, upper) if lower > 0 else None
