"""A case to be diagnosed, as a folder: case.json, the scan at rest and the scans under load.

::

    case.json           forces, nominal physics, noise: all that may be known
    reference.nrrd      labels of the body at rest
    deformed_40N.nrrd   labels between the plates, one file for each load

The nominal physics are read from the words of case.json where it has no numbers of
their own.
"""

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from storage.errors import InputError
from storage.values import Tissue, Volume
from workers.diagnosis.subject import Free, Values
from workers.fem.fields import FibreField, Frame
from workers.fem.loads import Device, ForceControl, Wall
from workers.fem.problem import Constants, Problem
from workers.images.labels import crop_to_body, relabel
from workers.images.read import read_volume
from workers.observation.noise import SegmentationNoise
from workers.spec import validated
from workers.units import KPA, KPA_PER_MM

# What voxels leave of an interface, see `workers.observation.noise`.
NUGGET_VOXELS = 0.08
LABELS = {0: "air", 1: "fat", 2: "glandular"}


class _Record(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class _Deformed(_Record):
    file: str
    plate_force_n: float = Field(gt=0, alias="plate_force_N")


class _Scans(_Record):
    reference: str
    deformed: tuple[_Deformed, ...] = Field(min_length=1)


class _Nominal(_Record):
    energy: str
    nu: float = Field(gt=0, lt=0.5)
    fibre_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    unknown_constants: tuple[str, ...]
    plausible_kpa: dict[str, tuple[float, float]] = Field(alias="plausible_kPa")
    chest_wall: str
    plates: str


class CaseFile(_Record):
    """What case.json says."""

    id: str
    nominal: _Nominal
    segmentation: str
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
        self.reference = self._scan(self.file.scans.reference)
        self.deformed = [self._scan(d.file) for d in self.file.scans.deformed]
        self.forces_n = [d.plate_force_n for d in self.file.scans.deformed]

    @property
    def names(self) -> list[str]:
        """Of the loaded scans."""
        return [f"{force:g} N" for force in self.forces_n]

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
        return [
            Free(name, *(KPA.to_inside(v) for v in nominal.plausible_kpa[name]))
            for name in nominal.unknown_constants
        ]

    @property
    def noise(self) -> SegmentationNoise:
        """Of the segmentation, every scan alike."""
        sd = self._number(self.file.segmentation, r"sd\s*([\d.]+)\s*mm", "segmentation: sd .. mm")
        length = self._number(
            self.file.segmentation,
            r"correlation length[^\d]*([\d.]+)\s*mm",
            "segmentation: correlation length .. mm",
        )
        on_reference = "reference" in self.file.segmentation
        nugget = NUGGET_VOXELS * max(self.reference.spacing_mm)
        return SegmentationNoise(sd, length, sd if on_reference else 0.0, nugget)

    def problem(self, force_n: float, frame: Frame) -> Callable[[Values], Problem]:
        """The nominal model of one load, from the values of the free constants."""
        nominal = self.file.nominal
        lower, upper = self._plates()
        device = Device(pivot_mm=frame.centre_mm)
        load = ForceControl(force_n, lower, upper, device)
        wall = Wall((False, False, True), (self._spring("kx"), self._spring("ky"), 0.0))

        def build(values: Values) -> Problem:
            return Problem(
                {
                    Tissue.FAT: _constants(values, "E_fat", nominal.nu),
                    Tissue.GLANDULAR: _constants(values, "E_gl", nominal.nu),
                },
                load,
                fibres=FibreField(axis=nominal.fibre_direction),
                isochoric_fibre="I4bar" in nominal.energy,
                literal_fibre="tension only" not in nominal.energy,
                wall=wall,
            )

        return build

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
        found = {int(label) for label in np.unique(volume.values)}
        if not found <= set(LABELS) or not {1, 2} <= found:
            raise InputError(
                f"{path} has the labels {sorted(found)}; a case has 0 background, 1 fat and "
                "2 glandular, all of them. Relabel the scan, or segment what is missing."
            )
        return crop_to_body(above_wall(relabel(volume, LABELS), self._wall_mm()))

    def _wall_mm(self) -> float:
        text = self.file.nominal.chest_wall
        return self._number(text, r"z\s*=\s*([+-]?[\d.]+)", "chest_wall: .. z=..")


def above_wall(labels: Volume, wall_mm: float) -> Volume:
    """The slices whose centres lie above the chest wall; segmentation may spill below it."""
    z = labels.origin_mm[2] + labels.spacing_mm[2] * np.arange(labels.values.shape[0])
    first = int(np.searchsorted(z, wall_mm + 1e-6))
    x0, y0, _ = labels.origin_mm
    return Volume(labels.values[first:], labels.spacing_mm, (x0, y0, float(z[first])))


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
