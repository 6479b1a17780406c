"""A case to be diagnosed, as a folder: case.json, the scan at rest and the scans under load.

::

    case.json           loads, nominal physics, noise: all that may be known
    reference.nrrd      labels of the body at rest; a second segmentation of it, if there is
                        one, measures the noise
    deformed_40N.nrrd   labels between the plates, one file for each load and direction

The nominal physics are read from the words of case.json where it has no numbers of
their own. Plates press with a known force, or stand at a known distance.
"""

import json
import re
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from storage.errors import InputError
from storage.values import Tissue, Triple, Volume
from workers.diagnosis.subject import Free, Values
from workers.fem.fields import FibreField, Frame
from workers.fem.loads import Device, DistanceControl, ForceControl, Load, Wall
from workers.fem.problem import Constants, Problem
from workers.images.labels import relabel
from workers.images.one_body import in_air, one_body
from workers.images.read import read_volume
from workers.observation.noise import SegmentationNoise
from workers.observation.repeat import from_repeat
from workers.spec import validated
from workers.units import KPA, KPA_PER_MM

# What voxels leave of an interface, see `workers.observation.noise`.
NUGGET_VOXELS = 0.08
# Points this near to the chest wall sit where the image was cut.
WALL_MARGIN_MM = 4.0
LABELS = {0: "air", 1: "fat", 2: "glandular"}
# First words of the labels of case.json. Skin in a scan is counted as the fat under it.
MEANINGS = {
    "air": "air", "background": "air", "fat": "fat", "adipose": "fat", "skin": "fat",
    "glandular": "glandular", "gland": "glandular", "fibroglandular": "glandular",
}  # fmt: skip
ALONG_Y = (0.0, 1.0, 0.0)
AXES = {(1.0, 0.0, 0.0): "x", ALONG_Y: "y"}


class _Record(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Deformed(_Record):
    """One loaded scan.

    Plates start at `lower_mm` and `upper_mm` along their axis if the force is known. With
    `plate_distance_mm` they end there; by default where the body in the scan does.
    """

    file: str
    plate_force_n: float | None = Field(default=None, gt=0, alias="plate_force_N")
    plate_distance_mm: float | None = Field(default=None, gt=0)
    compression_axis: Triple = ALONG_Y
    lower_mm: float | None = None
    upper_mm: float | None = None

    @model_validator(mode="after")
    def _one_load(self) -> Self:
        if (self.plate_force_n is None) == (self.plate_distance_mm is None):
            raise ValueError("give plate_force_N or plate_distance_mm, one of them")
        if self.compression_axis[2] or not any(self.compression_axis):
            raise ValueError("compression_axis must lie across z, such as [0, 1, 0] or [1, 0, 0]")
        return self

    @property
    def name(self) -> str:
        """In the words of a report."""
        loaded = (
            f"{self.plate_force_n:g} N" if self.plate_force_n is not None
            else f"{self.plate_distance_mm:g} mm"
        )  # fmt: skip
        if self.compression_axis == ALONG_Y:
            return loaded
        x, y, _ = self.compression_axis
        along = AXES.get(self.compression_axis, f"{np.degrees(np.arctan2(y, x)):.0f} degrees")
        return f"{loaded} along {along}"


class _Scans(_Record):
    reference: str
    reference_repeat: str | None = None
    deformed: tuple[Deformed, ...] = Field(min_length=1)


class _Nominal(_Record):
    energy: str
    nu: float = Field(gt=0, lt=0.5)
    fibre_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    unknown_constants: tuple[str, ...]
    plausible_kpa: dict[str, tuple[float, float]] = Field(alias="plausible_kPa")
    held_kpa: dict[str, float] = Field(default_factory=dict, alias="held_kPa")
    chest_wall: str
    plates: str


class CaseFile(_Record):
    """What case.json says."""

    id: str
    labels: dict[int, str] = Field(default_factory=lambda: dict(LABELS))
    nominal: _Nominal
    segmentation: str = ""
    scans: _Scans


class ImagedCase:
    """A case with its scans.

    Parameters
    ----------
    folder : Path

    Raises
    ------
    InputError
        If a file is missing, or case.json lacks something or makes no sense.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = _read(folder / "case.json")
        scans = self.file.scans
        self.reference = self._scan(scans.reference)
        self.repeat = self._scan(scans.reference_repeat) if scans.reference_repeat else None
        self.loads = list(scans.deformed)
        self.deformed = [self._scan(load.file) for load in self.loads]

    @property
    def names(self) -> list[str]:
        """Of the loaded scans."""
        return [load.name for load in self.loads]

    @property
    def free(self) -> list[Free]:
        """The unknown constants with their plausible intervals."""
        nominal = self.file.nominal
        missing = set(nominal.unknown_constants) - set(nominal.plausible_kpa)
        if missing:
            raise InputError(
                f"{self.folder / 'case.json'}: nominal.plausible_kPa lacks an interval for "
                f"{', '.join(sorted(missing))}."
            )
        loose = {"E_fat", "E_gl"} - set(nominal.unknown_constants) - set(nominal.held_kpa)
        if loose:
            raise InputError(
                f"{self.folder / 'case.json'} gives no value of {', '.join(sorted(loose))}: name "
                "it in nominal.unknown_constants, or hold it in nominal.held_kPa."
            )
        return [
            Free(name, *(KPA.to_inside(v) for v in nominal.plausible_kpa[name]))
            for name in nominal.unknown_constants
        ]

    @cached_property
    def noise(self) -> SegmentationNoise:
        """Of the segmentation, every scan alike: as two of one image differ, or as stated."""
        if self.repeat is not None:
            return from_repeat(self.reference, self.repeat, wall_margin_mm=WALL_MARGIN_MM)
        sd = self._number(self.file.segmentation, r"sd\s*([\d.]+)\s*mm", "segmentation: sd .. mm")
        length = self._number(
            self.file.segmentation,
            r"correlation length[^\d]*([\d.]+)\s*mm",
            "segmentation: correlation length .. mm",
        )
        on_reference = "reference" in self.file.segmentation
        nugget = NUGGET_VOXELS * max(self.reference.spacing_mm)
        return SegmentationNoise(sd, length, sd if on_reference else 0.0, nugget)

    def problem(self, number: int, frame: Frame) -> Callable[[Values], Problem]:
        """The nominal model of one loaded scan, from the values of the free constants."""
        nominal = self.file.nominal
        load = self._load(number, frame)
        wall = Wall((False, False, True), (self._spring("kx"), self._spring("ky"), 0.0))
        held = {name: KPA.to_inside(value) for name, value in nominal.held_kpa.items()}

        def build(values: Values) -> Problem:
            known = held | dict(values)
            return Problem(
                {
                    Tissue.FAT: _constants(known, "E_fat", nominal.nu),
                    Tissue.GLANDULAR: _constants(known, "E_gl", nominal.nu),
                },
                load,
                fibres=FibreField(axis=nominal.fibre_direction),
                isochoric_fibre="I4bar" in nominal.energy,
                literal_fibre="tension only" not in nominal.energy,
                wall=wall,
            )

        return build

    def _load(self, number: int, frame: Frame) -> Load:
        said = self.loads[number]
        device = Device(said.compression_axis, frame.centre_mm)
        if said.plate_force_n is not None:
            lower, upper = said.lower_mm, said.upper_mm
            if lower is None or upper is None:
                lower, upper = self._plates()
            return ForceControl(said.plate_force_n, lower, upper, device)
        lower, upper = extent_mm(self.deformed[number], said.compression_axis)
        if said.plate_distance_mm is not None:
            spare = (upper - lower - said.plate_distance_mm) / 2
            lower, upper = lower + spare, upper - spare
        return DistanceControl(
            lower if said.lower_mm is None else said.lower_mm,
            upper if said.upper_mm is None else said.upper_mm,
            device,
        )

    def _plates(self) -> tuple[float, float]:
        text = self.file.nominal.plates
        lower = self._number(text, r"lower[^;]*?y\s*=\s*([+-]?[\d.]+)", "plates: lower .. y=..")
        found = re.search(r"upper[^;]*?y\s*=\s*([+-]?[\d.]+)", text)
        return lower, float(found.group(1)) if found else -lower

    def _spring(self, name: str) -> float:
        found = re.search(rf"{name}\s*=\s*([\d.eE+-]+)\s*kPa/mm", self.file.nominal.chest_wall)
        return KPA_PER_MM.to_inside(float(found.group(1))) if found else 0.0

    def _number(self, text: str, pattern: str, what: str) -> float:
        found = re.search(pattern, text)
        if not found:
            raise InputError(f"{self.folder / 'case.json'} does not say {what}: found {text!r}.")
        return float(found.group(1))

    def _scan(self, name: str) -> Volume:
        path = self.folder / name
        if not path.is_file():
            raise InputError(
                f"{self.folder / 'case.json'} names {name}, which is not in the folder."
            )
        volume = read_volume(path)
        meant = self._labels()
        found = {int(label) for label in np.unique(volume.values)}
        if not found <= set(meant) or {meant[label] for label in found} != set(LABELS.values()):
            raise InputError(
                f"{path} has the labels {sorted(found)}; a case has 0 background, 1 fat and "
                "2 glandular, all of them, or what its case.json says under labels. Relabel the "
                "scan, or segment what is missing."
            )
        named = {label: meant[label] for label in found}
        body = one_body(above_wall(relabel(volume, named), self.wall_mm))
        return in_air(body)

    def _labels(self) -> dict[int, str]:
        meant = {}
        for label, words in self.file.labels.items():
            first = re.split(r"[^a-z]", words.strip().lower())[0]
            if first not in MEANINGS:
                raise InputError(
                    f"{self.folder / 'case.json'}: labels: {label} is {words!r}, expected one of "
                    f"{', '.join(MEANINGS)} as its first word."
                )
            meant[label] = MEANINGS[first]
        return meant

    @property
    def wall_mm(self) -> float:
        """The z of the chest wall."""
        text = self.file.nominal.chest_wall
        return self._number(text, r"z\s*=\s*([+-]?[\d.]+)", "chest_wall: .. z=..")


def above_wall(labels: Volume, wall_mm: float) -> Volume:
    """The slices whose centres lie above the chest wall; segmentation may spill below it."""
    z = labels.origin_mm[2] + labels.spacing_mm[2] * np.arange(labels.values.shape[0])
    first = int(np.searchsorted(z, wall_mm + 1e-6))
    x0, y0, _ = labels.origin_mm
    return Volume(labels.values[first:], labels.spacing_mm, (x0, y0, float(z[first])))


def extent_mm(labels: Volume, axis: Triple) -> tuple[float, float]:
    """From where to where the body reaches along an axis across z: faces of its voxels."""
    along = np.asarray(axis[:2]) / np.linalg.norm(axis)
    _, y, x = np.nonzero(labels.values != Tissue.AIR)
    spacing = np.asarray(labels.spacing_mm[:2])
    places = np.asarray(labels.origin_mm[:2]) + spacing * np.column_stack([x, y])
    heights = places @ along
    half = float(np.abs(along) @ spacing) / 2
    return float(heights.min()) - half, float(heights.max()) + half


def _constants(values: Values, young: str, poisson: float) -> Constants:
    return Constants(values[young], poisson, fibre_mpa=values.get("eta", 0.0))


def _read(path: Path) -> CaseFile:
    if not path.is_file():
        raise InputError(f"{path.parent} is no case: it has no {path.name}.")
    try:
        data: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise InputError(f"{path} is no JSON: {error}.") from error
    return validated(CaseFile, data, str(path))
