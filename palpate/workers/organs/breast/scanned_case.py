"""A case to diagnose: its settings, the scan at rest and the scans under load.

Either the force on the plates or their distance is known. `acquisition_of` states the case's body,
loads and noise; `aligned_case` moves the loaded scans rigidly onto the scan at rest.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy, mesh_whole_body
from palpate.workers.comparison.observation.isosurface import smooth_outline
from palpate.workers.comparison.observation.segmentation_noise import (
    SegmentationNoise,
    noise_from_repeat,
)
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant, Values
from palpate.workers.diagnosis.problem.planned_acquisition import Acquisition
from palpate.workers.mechanics.fem.boundary_value_problem import (
    Constants,
    FibreField,
    Frame,
    Problem,
)
from palpate.workers.mechanics.fem.loads_and_regions import (
    Device,
    DistanceControl,
    ForceControl,
    Load,
    Wall,
)
from palpate.workers.mechanics.model_parameters import KPA_PER_MM
from palpate.workers.organs.breast.scan_alignment import aligned
from palpate.workers.organs.breast.scan_facts import (
    NUGGET_VOXELS,
    EnclosedAir,
    PlateLoad,
    extent_mm,
    in_air,
    study_noise,
    unit_axis,
)
from palpate.workers.organs.breast.scanned_case_keys import CaseFile, CaseLoad, CasePlates, CaseWall

# Points this close to the chest wall are on the cut of the image.
WALL_MARGIN_MM = 4.0


class ScannedCase:
    """A case with its scans.

    Parameters
    ----------
    file : CaseFile
        Settings of the case.
    reference : Volume
        `Tissue` labels of the body at rest, in air and above the chest wall.
    repeat : Volume or None
        A second segmentation of the body at rest.
    loaded : sequence of Volume
        Labels under each load, including tissue below the wall. Empty before the scans are made:
        the body at rest is then used instead, and plates at a given distance close around its
        middle.
    where : str
        Path of the file, for messages.
    motions : sequence of str
        Descriptions of the motions that aligned the loaded scans; empty without alignment.
    cut_cm2 : mapping of str to mapping, optional
        Section of the body on each face of its image that cuts it, by the name of the image; see
        `scan_border.cut_cm2`. The scans themselves are in air.
    air : mapping of str to EnclosedAir, optional
        Air that was filled in the scans, by the name of the image.
    """

    def __init__(
        self,
        file: CaseFile,
        reference: Volume,
        repeat: Volume | None,
        loaded: Sequence[Volume],
        where: str = "the case",
        motions: Sequence[str] = (),
        cut_cm2: Mapping[str, Mapping[str, float]] | None = None,
        air: Mapping[str, EnclosedAir | None] | None = None,
    ) -> None:
        self.file = file
        self.reference = reference
        self.repeat = repeat
        self.where = where
        self.motions = tuple(motions)
        self.cut_cm2 = cut_cm2 or {}
        self.air = air or {}
        self.loads = list(file.scans.loads)
        self.is_scanned = bool(loaded)
        self.deformed = list(loaded) if loaded else [reference] * len(self.loads)

    @property
    def names(self) -> list[str]:
        """Names of the loaded scans."""
        return [load.name for load in self.loads]

    @property
    def free(self) -> list[FreeConstant]:
        """The unknown constants with their plausible intervals."""
        units = dict(self.file.names.values())
        return [
            FreeConstant(name, units[name].to_inside(low), units[name].to_inside(high), units[name])
            for name, (low, high) in self.file.free.items()
        ]

    @cached_property
    def noise(self) -> SegmentationNoise:
        """Noise of the segmentation: from a repeat, as given in the file, or as in a study."""
        if self.repeat is not None:
            return noise_from_repeat(self.reference, self.repeat, wall_margin_mm=WALL_MARGIN_MM)
        stated = self.file.noise
        if stated is None:
            return study_noise(self.reference, *self.deformed, imaged=True)
        of_reference = stated.sd_mm if stated.in_scans == "all" else 0.0
        nugget = NUGGET_VOXELS * max(self.reference.spacing_mm)
        return SegmentationNoise(stated.sd_mm, stated.correlation_mm, of_reference, nugget)

    @property
    def pose_sd(self) -> tuple[float, float]:
        """Standard deviations of the pose of a scan from its header, in mm and in degrees."""
        shift_mm, turn_deg = self.file.scans.pose_sd_mm, self.file.scans.pose_sd_deg
        return (
            SETTINGS.pose.shift_sd_mm if shift_mm is None else shift_mm,
            SETTINGS.pose.turn_sd_deg if turn_deg is None else turn_deg,
        )

    def above_wall(self, labels: Volume) -> Volume:
        """Return the part of a loaded scan above the chest wall; see `above_wall`."""
        return above_wall(labels, self.wall_mm)

    def problem(self, number: int, frame: Frame) -> Callable[[Values], Problem]:
        """Return a function from the free constants to the nominal problem of one loaded scan."""
        model, nu = self.file.model, self.file.nu
        has_fibres = self.file.has_fibres
        load = self._load(number, frame)
        wall = _wall(self.file.wall)
        laws, units = model.laws, dict(self.file.names.values())
        held = {name: units[name].to_inside(value) for name, value in self.file.held.items()}

        def build(values: Values) -> Problem:
            known = held | dict(values)
            fat = _constants(known, "E_fat", "eta_fat", nu)
            gland = _constants(known, "E_gl", "eta_glandular", nu)
            return Problem(
                {
                    Tissue.FAT: laws.applied("fat", fat, known),
                    Tissue.GLANDULAR: laws.applied("glandular", gland, known),
                },
                load,
                fibres=FibreField(axis=model.fibre_direction),
                isochoric_fibre=has_fibres and model.fibre_invariant == "isochoric",
                literal_fibre=not has_fibres or model.fibres == "literal",
                wall=wall,
            )

        return build

    def _load(self, number: int, frame: Frame) -> Load:
        stated = self.loads[number]
        device = Device(stated.axis, frame.centre_mm)
        if stated.force_n is not None:
            return ForceControl(stated.force_n, *self.plate_starts_mm(stated), device)
        lower, upper = extent_mm(self.above_wall(self.deformed[number]), stated.axis)
        if stated.plate_distance_mm is not None:
            spare = (upper - lower - stated.plate_distance_mm) / 2
            lower, upper = lower + spare, upper - spare
        return DistanceControl(
            lower if stated.lower_mm is None else stated.lower_mm,
            upper if stated.upper_mm is None else stated.upper_mm,
            device,
        )

    def plate_starts_mm(self, load: CaseLoad) -> tuple[float, float]:
        """Return the initial positions of the plates of a force; by default at the body at rest."""
        lower, upper = stated_starts_mm(self.file, load)
        body = extent_mm(self.reference, load.axis)
        return body[0] if lower is None else lower, body[1] if upper is None else upper

    @property
    def wall_mm(self) -> float:
        """Position of the chest wall along z; by default the lower face of the body at rest."""
        stated = self.file.wall.z_mm
        return lower_face_mm(self.reference) if stated is None else stated


def stated_starts_mm(file: CaseFile, load: CaseLoad) -> tuple[float | None, float | None]:
    """Return the plate positions of a load; unless both are given, those in `plates`."""
    if load.lower_mm is not None and load.upper_mm is not None:
        return load.lower_mm, load.upper_mm
    plates = file.plates or CasePlates()
    return plates.lower_mm, plates.upper_mm


def lower_face_mm(labels: Volume) -> float:
    """Return the z of the lower face of the first slice of a body."""
    first = int((labels.values != Tissue.AIR).any(axis=(1, 2)).argmax())
    return float(labels.origin_mm[2] + (first - 0.5) * labels.spacing_mm[2])


def above_wall(labels: Volume, wall_mm: float) -> Volume:
    """Return the slices with centres above the chest wall; segmentations may extend below it."""
    z = labels.origin_mm[2] + labels.spacing_mm[2] * np.arange(labels.values.shape[0])
    first = int(np.searchsorted(z, wall_mm + 1e-6))
    x0, y0, _ = labels.origin_mm
    return replace(labels, values=labels.values[first:], origin_mm=(x0, y0, float(z[first])))


def _constants(values: Values, young: str, fibre: str, poisson: float) -> Constants:
    fibre_mpa = values.get(fibre, values.get("eta", 0.0))
    return Constants(values[young], poisson, fibre_mpa=fibre_mpa)


def _wall(stated: CaseWall) -> Wall:
    if stated.held:
        return Wall((True, True, True))
    x, y = map(KPA_PER_MM.to_inside, (stated.wall_hold_x_kpa_per_mm, stated.wall_hold_y_kpa_per_mm))
    return Wall((False, False, True), (x, y, 0.0))


def acquisition_of(case: ScannedCase) -> Acquisition:
    """Return the acquisition of a case, without its loaded scans.

    Raises
    ------
    InputError
        If the case lacks the noise of the segmentation.
    """
    return Acquisition(
        name=case.file.name,
        reference=case.reference,
        body=lambda: body_of(case),
        mesh=mesh_of,
        noise=case.noise,
        free=case.free,
        loads=case.names,
        problem=case.problem,
        effects=case.file.model.laws.suspects,
        pose_sd=case.pose_sd,
    )


def mesh_of(body: Volume, nodes: int) -> Hierarchy:
    """Mesh a body with approximately the given number of nodes."""
    return mesh_whole_body(body, nodes=nodes)


def body_of(case: ScannedCase) -> Volume:
    """Return the volume to be meshed: the reference scan, smoothed if its segmentation is rough."""
    if not case.noise.reference_sd_mm:
        return case.reference
    return smooth_outline(case.reference, case.noise.correlation_mm)


def aligned_case(case: ScannedCase) -> ScannedCase:
    """Return a case whose loaded scans are in the frame of the scan at rest."""
    loaded, words = [], []
    for number, (load, scan) in enumerate(zip(case.loads, case.deformed, strict=True)):
        labels, motion = aligned(case.reference, scan, case_load(case, number))
        loaded.append(in_air(labels))
        words.append(
            f"{load.volume} was aligned with {case.file.scans.reference}: moved by {motion.words}."
        )
    repeat, cut = case.repeat, case.cut_cm2
    return ScannedCase(case.file, case.reference, repeat, loaded, case.where, words, cut, case.air)


def case_load(case: ScannedCase, number: int) -> PlateLoad:
    """Return one load of a case in the form used by the checks."""
    stated, where = case.loads[number], f"scans.loads, {case.loads[number].volume}"
    axis = unit_axis(stated.axis)
    if stated.force_n is not None:
        return PlateLoad(where, axis, force_n=stated.force_n, starts_mm=_starts(case, stated))
    ends = None
    if stated.lower_mm is not None and stated.upper_mm is not None:
        ends = stated.lower_mm, stated.upper_mm
    distance = None if ends is not None else stated.plate_distance_mm
    return PlateLoad(f"{where}, plate_distance_mm", axis, distance_mm=distance, ends_mm=ends)


def _starts(case: ScannedCase, load: CaseLoad) -> tuple[str, float, float] | None:
    """Return the initial positions of the plates of a force; None if the file gives none."""
    if stated_starts_mm(case.file, load) == (None, None):
        return None
    own = load.lower_mm is not None and load.upper_mm is not None
    where = f"scans.loads, {load.volume}" if own else "plates"
    low, high = case.plate_starts_mm(load)
    return where, low, high
