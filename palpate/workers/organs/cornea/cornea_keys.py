"""Keys of a cornea in a study file: case, target, score, parameters and nuisance parameters.

Parameters are the constants of the law, pressures, and further effects. Those that the thesis holds
fixed have a neutral value, which changes nothing; the pressures and the jet default to the values
of the case. The nuisance parameters are the position of the eye, which may move as a whole between
two frames.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from palpate.storage.errors import InputError
from palpate.workers.common_keys import (
    CaseSpec,
    Door,
    Finite,
    Positive,
    ScoreSpec,
    TargetSpec,
    checked,
)
from palpate.workers.file_keys import Pairs
from palpate.workers.mechanics.model_parameters import (
    DEGREE,
    KPA,
    MM,
    MM_PER_KPA,
    MMHG,
    NUMBER,
    PA,
    Parameter,
    Unit,
    Vocabulary,
)
from palpate.workers.organs.cornea.corneal_model import (
    DEFAULT_BULK_MPA,
    MPA_PER_MMHG,
    Convention,
    JetProfile,
    Kind,
    PrestressMethod,
)
from palpate.workers.organs.cornea.section_outline import CAMERA_ANGLE_DEG, CORNEA_INDEX
from palpate.workers.organs.organ_protocol import Nuisance, OrganSpec

# Terms of the Ogden law that a study can name; the thesis has two.
TERMS = 3
# Intervals of a search: Table 5.2 of the thesis spans 3,731 to 39,721 Pa and 4.37 to 98.98.
MU_PA = (1.0, 40_000.0)
ALPHA = (0.1, 100.0)


def _term(number: int) -> tuple[Parameter, Parameter]:
    # Defaults are the means of Table 5.2; a third term is absent.
    mu_pa, alpha = ((26_034.0, 75.11), (22_962.0, 63.70), (0.0, 1.0))[number - 1]
    return (
        Parameter(
            f"mu{number}",
            PA,
            PA.to_inside(MU_PA[0]),
            PA.to_inside(MU_PA[1]),
            PA.to_inside(mu_pa),
            f"modulus of Ogden term {number}",
            open_lower=False,
        ),
        Parameter(f"alpha{number}", NUMBER, *ALPHA, alpha, f"exponent of Ogden term {number}"),
    )


def _from_zero(
    name: str, unit: Unit, upper: float, neutral: float, text: str, *, zero: bool = True
) -> Parameter:
    return Parameter(
        name,
        unit,
        unit.to_inside(0.01 * upper),
        unit.to_inside(upper),
        unit.to_inside(neutral),
        text,
        open_lower=not zero,
    )


def _either_sign(name: str, unit: Unit, reach: float, text: str) -> Parameter:
    return Parameter(
        name,
        unit,
        unit.to_inside(-reach),
        unit.to_inside(reach),
        0.0,
        text,
        admissible=(-math.inf, math.inf),
    )


CORNEA = Vocabulary(
    [
        *(parameter for number in range(1, TERMS + 1) for parameter in _term(number)),
        _from_zero("bulk", KPA, 1e5, 1e3 * DEFAULT_BULK_MPA, "bulk modulus K", zero=False),
        _from_zero("iop", MMHG, 40, 10.5, "intraocular pressure"),
        _from_zero("jet_pressure", KPA, 40, 15, "pressure of the air jet"),
        _either_sign("jet_centre", MM, 1, "position of the jet, from the middle of the section"),
        _from_zero("jet_width", NUMBER, 2, 1, "widening of the jet", zero=False),
        _from_zero("iop_rise", MMHG, 10, 0, "increase of the intraocular pressure by the jet"),
        _either_sign("eye_shift_x", MM, 0.5, "motion of the whole eye to the right"),
        _either_sign("eye_shift_y", MM, 0.5, "motion of the whole eye outwards"),
        _either_sign("eye_tilt", DEGREE, 3, "rotation of the whole eye, counter-clockwise"),
        _from_zero("limbus_compliance", MM_PER_KPA, 0.01, 0, "compliance of the limbus, per area"),
        _either_sign("depth_gradient", NUMBER, 1, "ln of posterior over anterior stiffness"),
        _either_sign("side_gradient", NUMBER, 1, "ln of right over left stiffness"),
    ]
)


DoorConstants = Annotated[dict[str, float], checked(CORNEA.from_door)]
Zero = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Interval = tuple[Finite, Finite]


class GeneratedSectionSpec(Door):
    """A generated section; see `workers.organs.cornea.section_outline`.

    Parameters
    ----------
    radius_mm
        Radius of the anterior surface, in mm.
    chord_mm
        Width of the section, in mm.
    central_mm
        Thickness in the middle, in mm.
    peripheral_mm
        Thickness at the limbus, in mm.
    asphericity
        Q of the anterior conic; 0 is a circle.
    """

    radius_mm: Positive = 7.8
    chord_mm: Positive = 11.7
    central_mm: Positive = 0.595
    peripheral_mm: Positive = 0.70
    asphericity: Finite = 0.0


class RefractionSpec(Door):
    """The camera's view of the posterior surface; see `workers.organs.cornea.section_outline`.

    Parameters
    ----------
    index
        Refractive index of the cornea.
    camera_angle_deg
        Angle between slit and camera, in degrees.
    """

    index: Annotated[float, Field(ge=1, allow_inf_nan=False)] = CORNEA_INDEX
    camera_angle_deg: Annotated[float, Field(gt=0, lt=80)] = CAMERA_ANGLE_DEG


class FrameSpec(Door):
    """An image of a section and its scale; see `workers.organs.cornea.tonometer_frames`.

    ``first_pixel`` is the column and row of its first pixel in the raster shared by both frames
    of a pair. ``refraction: null`` leaves the posterior surface where it appears.

    Parameters
    ----------
    first_pixel
        Column and row of the first pixel of the file in the raster shared by both frames of a
        pair.
    refraction
        Corrects the apparent posterior surface; null: no correction.
    """

    file: str = Field(description="the picture of the section")
    pixel_mm: tuple[Positive, Positive] = Field(
        description="width and height of a pixel in mm, such as [0.0156, 0.0165]"
    )
    first_pixel: Interval = (0.0, 0.0)
    refraction: RefractionSpec | None = RefractionSpec()


class CorneaReference(Door):
    """The undeformed section, under the intraocular pressure: generated, or an image."""

    exactly_one: ClassVar[Pairs] = (("section", "frame"),)

    section: GeneratedSectionSpec | None = Field(default=None, description="a generated section")
    frame: FrameSpec | None = Field(default=None, description="a picture of the section")


class MeshSpec(Door):
    """The size of the mesh.

    Parameters
    ----------
    elements
        Approximate number of 6-node triangles.
    """

    elements: Annotated[int, Field(ge=8, le=100_000)] = 960


class ModelSpec(Door):
    """The model of a section; see `workers.organs.cornea.corneal_model`.

    Swapping two terms of the law does not change the cornea. ``order_terms_by`` is the
    constant by which they are sorted, smallest first, before simulation and report.

    Parameters
    ----------
    kind
        Out-of-plane behaviour of the section.
    convention
        Role of mu and alpha in the energy of the Ogden law.
    prestress
        How the shape without pressure is taken into account.
    order_terms_by
        Constant by which the terms of the law are sorted, smallest first.
    """

    kind: Kind = "plane stress"
    convention: Convention = "mu/alpha"
    prestress: PrestressMethod = "additive"
    order_terms_by: Literal["alpha", "mu", "nothing"] = "alpha"


class JetProfileSpec(Door):
    """Pressure of the jet over the distance from its centre, relative to the full pressure.

    Parameters
    ----------
    r_mm
        Distances from the centre of the jet, in mm, ascending.
    fraction
        Pressure at these distances, relative to the full pressure.
    """

    r_mm: Annotated[tuple[Zero, ...], Field(min_length=1)]
    fraction: tuple[Zero, ...]

    @model_validator(mode="after")
    def _is_a_profile(self) -> Self:
        try:
            _ = self.profile
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def profile(self) -> JetProfile:
        """Return the profile as part of a load."""
        return JetProfile(self.r_mm, self.fraction)


class JetSpec(Door):
    """The air jet: its pressure and position.

    ``centre_mm`` is measured from the middle of the section. The default of 15 kPa is an
    interpretation of the thesis' "15 mmHg" at which its corneas become concave; see
    `workers.organs.cornea.corneal_model.CorneaLoad`.

    Parameters
    ----------
    pressure_kpa
        Pressure at its centre, in kPa.
    pressure_mmhg
        Pressure at its centre, in mmHg.
    diameter_mm
        Diameter of a jet of uniform pressure, in mm.
    centre_mm
        Position of its centre from the middle of the section, in mm.
    profile
        Pressure over the distance from the centre. Default: uniform.
    """

    exactly_one: ClassVar[Pairs] = (("pressure_kpa", "pressure_mmhg"),)

    pressure_kpa: Zero | None = None
    pressure_mmhg: Zero | None = None
    diameter_mm: Positive = 3.0
    centre_mm: Finite = 0.0
    profile: JetProfileSpec | None = None

    @property
    def pressure_mpa(self) -> float:
        """Return the pressure, whichever unit it is given in."""
        if self.pressure_kpa is not None:
            return self.pressure_kpa / 1000
        return MPA_PER_MMHG * (self.pressure_mmhg or 0.0)

    @property
    def reach_mm(self) -> float:
        """Return the radius within which the jet acts."""
        return self.diameter_mm / 2 if self.profile is None else self.profile.r_mm[-1]


class LoadSpec(Door):
    """The intraocular pressure and the air jet.

    Parameters
    ----------
    iop_mmhg
        Intraocular pressure, in mmHg.
    jet
        The air jet.
    """

    iop_mmhg: Zero = 10.5
    jet: JetSpec = JetSpec(pressure_kpa=15)


class FindingsSpec(Door):
    """Findings about the fitted eye; see `workers.organs.cornea.cornea_findings`.

    ``profiles`` takes about a minute. ``jet_fractions`` are the pressures, relative to the full
    one, of a hypothetical series of images. ``not_measured`` lists assumed quantities.

    Parameters
    ----------
    profiles
        Whether profiles of the constants are computed, which takes about a minute.
    jet_fractions
        Pressures, relative to the full one, of a hypothetical series of images.
    not_measured
        Quantities that were assumed, not measured.
    """

    profiles: bool = False
    jet_fractions: Annotated[tuple[Positive, ...], Field(min_length=1)] = (0.25, 0.5, 0.75, 1.0)
    not_measured: tuple[Literal["iop", "pachymetry", "jet_pressure"], ...] = ()


class CorneaCase(CaseSpec):
    """A section of a cornea, its mesh, its model and its load.

    Parameters
    ----------
    organ
        Name of the organ.
    mesh
        Size of the mesh.
    model
        Model of the section.
    load
        Intraocular pressure and air jet.
    findings
        Findings in the report.
    """

    organ: Literal["cornea"]
    reference: CorneaReference = CorneaReference(section=GeneratedSectionSpec())
    mesh: MeshSpec = MeshSpec()
    model: ModelSpec = ModelSpec()
    load: LoadSpec = LoadSpec()
    constants: DoorConstants = Field(default_factory=dict, description="a value that is held")
    findings: FindingsSpec = FindingsSpec()

    @property
    def parameters(self) -> Vocabulary:
        """See `CaseSpec.parameters`."""
        return CORNEA

    def unstated_load(self, searched: Collection[str]) -> str:
        """See `CaseSpec.unstated_load`."""
        stated = self.load.model_fields_set if "load" in self.model_fields_set else set()
        found = {"iop_mmhg": "iop_mmhg", "jet": "jet_pressure_kpa"}
        keys = [key for key, name in found.items() if key not in stated and name not in searched]
        return " and ".join(f"case.load.{key}" for key in keys)

    def complete(self, constants: Mapping[str, float] | None = None) -> dict[str, float]:
        """See `CaseSpec.complete`; pressures and jet are taken from the load.

        The terms of the law are in the model's order. If some constants of the law are given
        here and others are held, only terms given here in full are swapped: a name then refers
        to the same constant throughout a search.
        """
        jet = self.load.jet
        stated = {
            "iop": MPA_PER_MMHG * self.load.iop_mmhg,
            "jet_pressure": jet.pressure_mpa,
            "jet_centre": jet.centre_mm,
        }
        values = CORNEA.complete(stated, CORNEA.from_door(self.constants), constants or {})
        given = {name for pair in _pairs("mu{}", "alpha{}") for name in pair} & set(constants or {})
        return self._ordered(values, given or set(values), _pairs("mu{}", "alpha{}"))

    def canonical(self, genes: Mapping[str, float]) -> dict[str, float]:
        """See `CaseSpec.canonical`: the terms are in the model's order."""
        return self._ordered(dict(genes), set(genes), _pairs("mu{}_pa", "alpha{}"))

    def _ordered(
        self, values: dict[str, float], movable: Collection[str], pairs: Sequence[tuple[str, str]]
    ) -> dict[str, float]:
        """Sort the terms whose names are all movable."""
        if self.model.order_terms_by == "nothing":
            return values
        present = [p for p in pairs if set(p) <= set(movable) and values[p[0]] > 0]
        key = 0 if self.model.order_terms_by == "mu" else 1
        terms = [tuple(values[name] for name in pair) for pair in present]
        terms.sort(key=lambda term: (term[key], term[1 - key]))
        for pair, term in zip(present, terms, strict=True):
            values |= dict(zip(pair, term, strict=True))
        return values


def _pairs(mu: str, alpha: str) -> list[tuple[str, str]]:
    return [(mu.format(n), alpha.format(n)) for n in range(1, TERMS + 1)]


class CorneaTarget(TargetSpec):
    """The deformed section to be explained: simulated with hidden constants, or an image.

    Parameters
    ----------
    mesh
        A separate mesh for a simulated target, such as a finer one.
    """

    exactly_one: ClassVar[Pairs] = (("constants", "frame"),)

    constants: DoorConstants | None = Field(
        default=None, description="the hidden value with which the target is simulated"
    )
    frame: FrameSpec | None = Field(
        default=None, description="a picture of the section under the jet"
    )
    mesh: MeshSpec | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.frame is not None and self.mesh is not None:
            raise ValueError("a mesh is for a simulated target, but a frame is given: remove it")
        return self


class CorneaScore(ScoreSpec):
    """Comparison of two sections: in pixels of this size, between two vertical lines.

    ``window_mm`` crops both sections; an image shows less of a cornea than is simulated.

    Parameters
    ----------
    pixel_um
        Size of the pixels in which sections are compared, in um.
    window_mm
        Left and right end of the compared part, in mm from the middle.
    """

    pixel_um: Positive = 2.0
    window_mm: Interval | None = None

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if self.window_mm is not None and not self.window_mm[0] < self.window_mm[1]:
            raise ValueError(f"window_mm: give [left, right], found {list(self.window_mm)}")
        return self

    @property
    def parts(self) -> tuple[str, ...]:
        """See `ScoreSpec.parts`."""
        return ("cornea",)

    @property
    def compared(self) -> str:
        """See `ScoreSpec.compared`."""
        return "the corneal sections"


# Under a jet the eye moves by tenths of a millimetre and turns by degrees.
_MOTION = "the position of the eye, which moves as a whole"
EYE_MOTION = (
    Nuisance("eye_shift_x", _MOTION, 0.1, -0.5, 0.5),
    Nuisance("eye_shift_y", _MOTION, 0.2, -0.5, 0.5),
    Nuisance("eye_tilt", _MOTION, 1.0, -3.0, 3.0),
)


def nuisances(case: CorneaCase, imaged: bool) -> tuple[Nuisance, ...]:
    """Return the nuisance parameters: the whole eye may move between two frames."""
    return EYE_MOTION if imaged else ()


SPEC = OrganSpec(CorneaCase, CorneaTarget, CorneaScore, CORNEA, nuisances)
