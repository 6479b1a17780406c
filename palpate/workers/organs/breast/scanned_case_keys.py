"""Keys of a case to diagnose: scans, loads and the nominal model.

The keys are named as in a study and include their units; unknown keys are refused.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, field_validator, model_validator

from palpate.storage.values import Triple
from palpate.workers.common_keys import Door, Finite, NotNegative, Positive
from palpate.workers.file_keys import (
    SAME_FIBRES,
    Pairs,
    missing_key,
    with_current_names,
    with_recorded_names,
)
from palpate.workers.mechanics.model_parameters import KPA, Unit, unknown_name
from palpate.workers.organs.breast import breast_laws as physics
from palpate.workers.organs.breast.breast_keys import Axes, Labels, SpacingMm
from palpate.workers.organs.breast.breast_laws import TissueLaws, for_all_tissues, shape_constants

ALONG_X: Triple = (1.0, 0.0, 0.0)
ALONG_Y: Triple = (0.0, 1.0, 0.0)
AXES = {"x": ALONG_X, "y": ALONG_Y}
# Internal names of the constants of the model, by their keys.
CONSTANTS = {
    "E_fat_kpa": "E_fat",
    "E_glandular_kpa": "E_gl",
    "eta_fat_kpa": "eta_fat",
    "eta_glandular_kpa": "eta_glandular",
}
FIBRES = {"eta_fat_kpa", "eta_glandular_kpa"}
# Internal name of a fibre stiffness that both tissues share.
ONE_FIBRE = "eta"
NU = "nu"
NU_BELOW = 0.5
# Tolerance between the given plate positions and the given distance.
DISTANCE_SLACK_MM = 0.5


def _constant(given: Any) -> Any:
    """Convert a value to a float, an interval to two floats; keep the name of another constant."""
    if given in SAME_FIBRES.values():
        return given
    many = given if isinstance(given, list | tuple) else [given]
    numbers = [v for v in many if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(numbers) != len(many) or not all(math.isfinite(v) and v > 0 for v in numbers):
        raise ValueError(
            "expected a positive value to hold, such as 10, or an interval to search, "
            f"such as [7, 14]; found {given!r}"
        )
    if len(many) == 1 and many is not given:
        return float(numbers[0])
    if len(many) != 2 or not numbers[0] < numbers[1]:
        raise ValueError(f"expected an interval [lower, upper], lower < upper; found {given!r}")
    return float(numbers[0]), float(numbers[1])


def _axis(given: Any) -> Any:
    """Convert x and y to directions."""
    if isinstance(given, str):
        if given not in AXES:
            raise ValueError(f"expected x, y or a direction such as [1, 1, 0]; found {given!r}")
        return AXES[given]
    return given


def _law(given: Any) -> Any:
    """Apply a law given by name to all tissues."""
    return given if given in get_args(physics.Law) else for_all_tissues(given)


CASE_TISSUES = ("air", "fat", "glandular")
Constant = Annotated[
    float | tuple[float, float] | Literal["eta_fat_kpa"], BeforeValidator(_constant)
]
Axis = Annotated[
    tuple[Finite, Finite, Finite],
    BeforeValidator(
        _axis, json_schema_input_type=Literal["x", "y"] | tuple[Finite, Finite, Finite]
    ),
]


class CaseModel(Door):
    """The law of the tissue.

    Parameters
    ----------
    law : str or mapping
        A neo-Hookean solid, with or without fibres of stiffness eta. Another law, such as yeoh or
        {fat: yeoh, glandular: fung}, has fibres if constants give their stiffness, and shape
        constants, such as yeoh_c2_fat; `palpate parameters --law yeoh` lists them.
    fibres, fibre_invariant : str
        As in a study: whether fibres also resist compression, and whether their stretch is
        I4 or its isochoric part.
    fibre_direction : tuple of float
        Direction of the fibres throughout the body; z is from the chest wall to the nipple.
    """

    law: Annotated[
        Annotated[physics.Law, Tag("name")] | Annotated[TissueLaws, Tag("tissues")],
        Discriminator(lambda law: "name" if isinstance(law, str) else "tissues"),
        BeforeValidator(_law, json_schema_input_type=str | TissueLaws),
    ] = physics.LAW
    fibres: physics.Fibres = physics.FIBRES
    fibre_invariant: physics.FibreInvariant = physics.FIBRE_INVARIANT
    fibre_direction: tuple[Finite, Finite, Finite] = physics.FIBRE_DIRECTION

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if not any(self.fibre_direction):
            raise ValueError("fibre_direction must not be zero")
        given = {"fibres", "fibre_invariant", "fibre_direction"} & self.model_fields_set
        defaults = type(self).model_fields
        changed = [k for k in sorted(given) if getattr(self, k) != defaults[k].default]
        if self.law == "neo-hookean" and changed:
            raise ValueError(
                f"{', '.join(changed)} are for the law fibre-neo-hookean, found law: neo-hookean"
            )
        return self

    @property
    def laws(self) -> TissueLaws:
        """The laws of the tissues without their fibres."""
        return self.law if isinstance(self.law, TissueLaws) else TissueLaws()


class CaseWall(Door):
    """The chest wall: its position, and the support of the body along it.

    The body cannot leave the wall. Along it the body is held, or supported by springs (force per
    area and displacement); at zero stiffness it slides.

    Parameters
    ----------
    z_mm
        Position of the wall along z, in mm. Default: the lower face of the body at rest.
    held
        Whether the body is held along the wall.
    wall_hold_x_kpa_per_mm
        Stiffness of springs along x, in kPa per mm.
    wall_hold_y_kpa_per_mm
        Stiffness of springs along y, in kPa per mm.
    """

    z_mm: Finite | None = None
    held: bool = physics.WALL_HELD
    wall_hold_x_kpa_per_mm: NotNegative = physics.WALL_SPRING_KPA_PER_MM
    wall_hold_y_kpa_per_mm: NotNegative = physics.WALL_SPRING_KPA_PER_MM

    @model_validator(mode="after")
    def _held_or_sprung(self) -> Self:
        if self.held and (self.wall_hold_x_kpa_per_mm or self.wall_hold_y_kpa_per_mm):
            raise ValueError("a wall that is held has no springs: give held or wall_hold_...")
        return self


class CasePlates(Door):
    """Initial positions of the plates.

    Parameters
    ----------
    lower_mm
        Initial position of the lower plate along the direction of compression, in mm. Default: at
        the body.
    upper_mm
        Initial position of the upper plate, in mm. Default: at the body.
    """

    lower_mm: Finite | None = None
    upper_mm: Finite | None = None

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if self.lower_mm is None or self.upper_mm is None:
            return self
        if not self.lower_mm < self.upper_mm:
            raise ValueError(
                f"lower_mm ({self.lower_mm:g}) must be less than upper_mm ({self.upper_mm:g})"
            )
        return self


class CaseNoise(Door):
    """Segmentation noise: a smooth field of signed distances.

    Parameters
    ----------
    in_scans
        Scans with this error: ``all``, or only the ``loaded`` ones.
    """

    sd_mm: Positive = Field(description="standard deviation of a segmented boundary, in mm")
    correlation_mm: Positive = Field(description="correlation length of the errors, in mm")
    in_scans: Literal["all", "loaded"] = "all"


class CaseLoad(Door):
    """One loaded scan.

    With `force_n`, `lower_mm` and `upper_mm` are the initial positions of the plates along their
    axis; the default is `plates`, or else the body at rest. With `plate_distance_mm` they are the
    final positions; the default is the body in the scan.

    Parameters
    ----------
    axis
        Direction of compression: ``x``, ``y`` or another one perpendicular to z: ``[1, 1, 0]``.
    lower_mm
        Initial position of the lower plate for this load, in mm; with a distance, the final one.
    upper_mm
        Initial position of the upper plate for this load, in mm; with a distance, the final one.
    """

    exactly_one: ClassVar[Pairs] = (("force_n", "plate_distance_mm"),)

    volume: str = Field(description="the labels of the body under this load")
    force_n: Positive | None = Field(default=None, description="the force on the plates, in N")
    plate_distance_mm: Positive | None = Field(
        default=None, description="the distance between the plates, in mm"
    )
    axis: Axis = ALONG_Y
    lower_mm: Finite | None = None
    upper_mm: Finite | None = None

    @model_validator(mode="after")
    def _one_load(self) -> Self:
        if self.axis[2] or not any(self.axis):
            raise ValueError("axis must be perpendicular to z, such as x, y or [1, 1, 0]")
        if self.lower_mm is None or self.upper_mm is None:
            return self
        CasePlates(lower_mm=self.lower_mm, upper_mm=self.upper_mm)
        distance, apart = self.plate_distance_mm, self.upper_mm - self.lower_mm
        if distance is not None and abs(distance - apart) > DISTANCE_SLACK_MM:
            raise ValueError(
                f"lower_mm and upper_mm are {apart:g} mm apart, but plate_distance_mm is "
                f"{distance:g}: remove one of them"
            )
        return self

    @property
    def name(self) -> str:
        """Return the name of the scan in reports."""
        loaded = (
            f"{self.force_n:g} N" if self.force_n is not None else f"{self.plate_distance_mm:g} mm"
        )
        if self.axis == ALONG_Y:
            return loaded
        x, y, _ = self.axis
        known = {axis: name for name, axis in AXES.items()}
        along = known.get(self.axis, f"{np.degrees(np.arctan2(y, x)):.0f} degrees")
        return f"{loaded} along {along}"


class CaseScans(Door):
    """The scan at rest, a second segmentation of it, and the scans under load.

    All scans are files, or names of stored volumes; `labels`, `axes` and `spacing_mm` apply to
    files, as in a study. For ``align: rigid`` see
    `workers.organs.breast.scan_alignment`.

    Parameters
    ----------
    reference_repeat
        A second segmentation of the body at rest, from which the noise is measured.
    pose_sd_mm
        Standard deviation of the position of each scan, the one at rest included, from its header,
        along each axis, in mm. Default: 0.3.
    pose_sd_deg
        Standard deviation of its rotation about each axis, in degrees. Default: 0.3.
    align
        ``rigid``: each loaded scan is first moved into the frame of the scan at rest. Default: it
        already is in that frame.
    labels
        Tissue of each label of the scans; as in a study, required if the files do not name them.
    axes
        Axes of the scans in the frame of the body; as in a study.
    spacing_mm
        Size of a voxel along x, y and z, in mm, for formats that do not state it.
    """

    reference: str = Field(description="the labels of the body at rest")
    reference_repeat: str | None = None
    pose_sd_mm: NotNegative | None = None
    pose_sd_deg: NotNegative | None = None
    align: Literal["rigid"] | None = None
    labels: Labels = None
    axes: Axes | None = None
    spacing_mm: SpacingMm | None = None
    loads: Annotated[tuple[CaseLoad, ...], Field(min_length=1)] = Field(
        description="one entry for each loaded scan, with its volume and its force or distance"
    )

    @field_validator("labels")
    @classmethod
    def _known_tissues(cls, labels: Any) -> Any:
        for label, tissue in labels.items() if isinstance(labels, Mapping) else ():
            if tissue not in CASE_TISSUES:
                raise ValueError(
                    f"{label}: expected 'air', 'fat' or 'glandular', found {tissue!r}: a diagnosis "
                    "has no other tissues"
                )
        return labels


class CaseFile(Door):
    """A case to diagnose: a breast scanned at rest and under load.

    Parameters
    ----------
    organ
        Name of the organ.
    model
        The law of the tissue.
    wall
        The chest wall.
    plates
        Initial positions of the plates, for all loads. Default: at the body.
    noise
        Segmentation noise. Default: 0.5 voxels, correlated over 4 mm. The scans correct its size.
    """

    organ: Literal["breast"] = "breast"
    name: Annotated[str, Field(min_length=1)] = Field(description="a name for the report")
    model: CaseModel = CaseModel()
    wall: CaseWall = CaseWall()
    plates: CasePlates | None = None
    constants: dict[str, Constant] = Field(
        description="a value to hold, such as 10, or an interval to search, such as [5, 20]; "
        "eta_glandular_kpa: eta_fat_kpa gives all fibres one stiffness; nu can only be held"
    )
    noise: CaseNoise | None = None
    scans: CaseScans = Field(description="the scan at rest and the scans under load")

    @model_validator(mode="before")
    @classmethod
    def _known_constants(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        data = with_current_names(data)
        constants = data.get("constants")
        if isinstance(constants, Mapping):
            names = [str(name) for name in constants]
            known = [*CONSTANTS, NU, *shape_constants(names).door_names]
            wrong = [unknown_name("key", name, known) for name in names if name not in known]
            if wrong:
                raise ValueError(f"constants: {'; '.join(wrong)}")
        return data

    @model_validator(mode="after")
    def _complete(self) -> Self:
        self._check_constants()
        if not self.free:
            raise ValueError(
                "constants: all are held; give an interval to search, as in E_fat_kpa: [7, 14]"
            )
        return self

    def _check_constants(self) -> None:
        given, fibres = set(self.constants), set(self.constants) & FIBRES
        for name, value in self.constants.items():
            if name == NU and not (isinstance(value, float) and value < NU_BELOW):
                raise ValueError(
                    f"constants: {NU} must be held at a value less than {NU_BELOW:g}, found "
                    f"{value!r}; a diagnosis varies it by the effect compressibility"
                )
            if isinstance(value, str) and SAME_FIBRES.get(name) != value:
                raise ValueError(
                    f"constants: only eta_glandular_kpa can be set to {value}, found {name}"
                )
            if reason := self.model.laws.reason_against(name):
                raise ValueError(f"constants: {name} is not used: {reason}")
        if self.model.law == "neo-hookean" and fibres:
            raise ValueError(
                f"constants: {', '.join(sorted(fibres))} {'is' if len(fibres) == 1 else 'are'} "
                "for fibres, but model.law is neo-hookean"
            )
        wanted = {"E_fat_kpa", "E_glandular_kpa"}
        if self.model.law == "fibre-neo-hookean" or fibres:
            wanted |= FIBRES
        if lacking := sorted(wanted - given):
            raise missing_key(
                f"constants: no value for {', '.join(lacking)}: give a value to hold, as in "
                "E_fat_kpa: 10, or an interval to search, as in E_fat_kpa: [7, 14]"
            )

    @property
    def nu(self) -> float:
        """Poisson's ratio of all tissues."""
        nu = self.constants.get(NU, physics.NU)
        return nu if isinstance(nu, float) else physics.NU

    @property
    def record(self) -> dict[str, Any]:
        """Plain values under the names used by records in a store."""
        values = self.model_dump(mode="json")
        values["constants"].setdefault(NU, self.nu)
        return with_recorded_names(values)

    @property
    def has_fibres(self) -> bool:
        """Whether the constants give the stiffness of fibres."""
        return not self.constants.keys().isdisjoint(FIBRES)

    @property
    def names(self) -> dict[str, tuple[str, Unit]]:
        """Internal names and units of all constants of the model, by their keys."""
        stiffnesses = {key: (name, KPA) for key, name in CONSTANTS.items()}
        if self.constants.items() >= SAME_FIBRES.items():
            stiffnesses |= {"eta_fat_kpa": (ONE_FIBRE, KPA)}
            del stiffnesses["eta_glandular_kpa"]
        shape = {p.door_name: (p.name, p.unit) for p in self.model.laws.constants}
        return stiffnesses | shape

    @property
    def free(self) -> dict[str, tuple[float, float]]:
        """Searched intervals as given, by internal names, in a fixed order."""
        return {
            name: value
            for key, (name, _) in self.names.items()
            if isinstance(value := self.constants.get(key), tuple)
        }

    @property
    def held(self) -> dict[str, float]:
        """Held constants as given, by internal names."""
        return {
            name: value
            for key, (name, _) in self.names.items()
            if isinstance(value := self.constants.get(key), float)
        }
