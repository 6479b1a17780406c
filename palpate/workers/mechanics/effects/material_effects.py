"""Effects of the material law, uniform or by tissue."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from palpate.storage.values import FloatArray, Tissue, Triple
from palpate.workers.mechanics.effects.effect import (
    ANY,
    Effect,
    Values,
    from_zero,
    renamed,
    two_sided,
    with_constants,
)
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Frame, Membrane, Problem
from palpate.workers.mechanics.materials.elastic_law import Isochoric
from palpate.workers.mechanics.model_parameters import (
    DEGREE,
    KPA,
    N_PER_M,
    NUMBER,
    Parameter,
    Reading,
    percent,
    poisson,
    ratio,
)

# --- compressibility
# Make tissue more, or less, compressible than assumed.


COMPRESSIBILITY_NAME = "ln_compressibility"


def _compressibility(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply 1 - 2 nu of all tissues, keeping Young's modulus.

    The bulk modulus E / 3(1 - 2 nu) falls by the same factor; the shear modulus
    E / 2(1 + nu) changes a little.
    """
    factor = math.exp(values[COMPRESSIBILITY_NAME])

    def changed(c: Constants) -> Constants:
        return replace(c, poisson=(1 - (1 - 2 * c.poisson) * factor) / 2)

    return with_constants(problem, changed)


# From nu = 0.499 to nu = 0.45 where the model has 0.49.
COMPRESSIBILITY = Effect(
    name="compressibility",
    family="global material",
    summary="The tissue is more or less compressible than assumed.",
    parameters=(
        Parameter(
            COMPRESSIBILITY_NAME,
            NUMBER,
            math.log(0.1),
            math.log(5.0),
            0.0,
            "ln of the ratio of 1 - 2 nu to the model's, at the same Young's modulus",
            admissible=ANY,
            reading=poisson(),
        ),
    ),
    prior_sd=(0.5,),
    steps=(1e-4,),
    transform=_compressibility,
    references=("C. Tanner et al., Med. Phys. 33 (2006) 1758",),
)


# --- compressibility contrast
# Let glandular tissue be more, or less, compressible than fat.


COMPRESSIBILITY_CONTRAST_NAME = "ln_compressibility_contrast"


def _compressibility_contrast(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply 1 - 2 nu of glandular tissue, keeping its Young's modulus."""
    gland = problem.constants.get(Tissue.GLANDULAR)
    if gland is None:
        return problem
    factor = math.exp(values[COMPRESSIBILITY_CONTRAST_NAME])
    changed = replace(gland, poisson=(1 - (1 - 2 * gland.poisson) * factor) / 2)
    return replace(problem, constants={**problem.constants, Tissue.GLANDULAR: changed})


COMPRESSIBILITY_CONTRAST = Effect(
    name="compressibility_contrast",
    family="global material",
    summary="Glandular tissue and fat differ in compressibility.",
    parameters=(
        Parameter(
            COMPRESSIBILITY_CONTRAST_NAME,
            NUMBER,
            math.log(0.1),
            math.log(5.0),
            0.0,
            "ln of the ratio of glandular tissue's 1 - 2 nu to the model's",
            admissible=ANY,
            reading=poisson("nu of glandular tissue"),
        ),
    ),
    prior_sd=(0.5,),
    steps=(1e-4,),
    transform=_compressibility_contrast,
    references=("C. Tanner et al., Med. Phys. 33 (2006) 1758",),
)


# --- creep
# Let tissue relax under the plates by the time it is imaged.


CREEP_NAME = "creep"


@dataclass(frozen=True, slots=True)
class ScaledLaw:
    """Law scaled by a factor.

    Parameters
    ----------
    law : Isochoric
    left : float
        Factor on its energy, > 0.
    """

    law: Isochoric
    left: float

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus, see `Isochoric.shear_modulus_mpa`."""
        return self.left * self.law.shear_modulus_mpa

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `workers.mechanics.materials.elastic_law.Law.energy`."""
        return self.left * self.law.energy(F)

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the stress, see `workers.mechanics.materials.elastic_law.Law.stress`."""
        return self.left * self.law.stress(F)

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the tangent, see `workers.mechanics.materials.elastic_law.Law.tangent`."""
        return self.left * self.law.tangent(F)


def _creep(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Reduce the moduli of all tissues, fibres and the skin by the same fraction."""
    left = 1 - values[CREEP_NAME]

    def changed(c: Constants) -> Constants:
        return replace(
            c,
            young_mpa=left * c.young_mpa,
            fibre_mpa=left * c.fibre_mpa,
            second_fibre_mpa=left * c.second_fibre_mpa,
            law=ScaledLaw(c.law, left) if c.law else None,
        )

    skin = problem.membrane
    return replace(
        with_constants(problem, changed),
        membrane=replace(skin, young_mpa=left * skin.young_mpa) if skin else None,
    )


CREEP = Effect(
    name="creep",
    family="global material",
    summary="The tissue has relaxed under the plates and is softer than assumed.",
    parameters=(
        from_zero(
            CREEP_NAME,
            NUMBER,
            0.5,
            "fraction of all moduli that the tissue has lost",
            limit=1.0,
            reading=percent("% of the stiffness lost"),
        ),
    ),
    prior_sd=(0.2,),
    steps=(1e-3,),
    transform=_creep,
    references=(
        "Y. C. Fung, Biomechanics: Mechanical Properties of Living Tissues, Springer 1993, "
        "section 7.6",
        "J. L. Calvo-Gallego et al., J. Mech. Behav. Biomed. Mater. 80 (2018) 293",
    ),
)


# --- fibre contrast
# Let glandular fibres be stiffer, or softer, than fibres of fat.


FIBRE_CONTRAST_NAME = "ln_fibre_contrast"


def _fibre_contrast(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the stiffness of both families of fibres in glandular tissue."""
    factor = math.exp(values[FIBRE_CONTRAST_NAME])
    gland = problem.constants.get(Tissue.GLANDULAR)
    if gland is None:
        return problem
    changed = replace(
        gland, fibre_mpa=factor * gland.fibre_mpa, second_fibre_mpa=factor * gland.second_fibre_mpa
    )
    return replace(problem, constants={**problem.constants, Tissue.GLANDULAR: changed})


def _true_fibre_contrast(given: Mapping[str, Any]) -> dict[str, float]:
    """Return ln of the ratio in the middle of the body."""
    return {FIBRE_CONTRAST_NAME: math.log(given["ratio"])}


FIBRE_CONTRAST = Effect(
    name="fibre_contrast",
    family="global material",
    summary="Fibres of glandular tissue and of fat are not equally stiff.",
    parameters=(
        two_sided(
            FIBRE_CONTRAST_NAME,
            NUMBER,
            2.0,
            "ln of the ratio of glandular fibre stiffness to the model's",
            reading=ratio("times as stiff as the model's fibres"),
        ),
    ),
    prior_sd=(0.7,),
    steps=(1e-4,),
    transform=_fibre_contrast,
    references=("M. A. Lago, PhD thesis, 2014, section 4.5.1",),
    truth=_true_fibre_contrast,
)


# --- fibre fan
# Let fibres spread out instead of running parallel.


FIBRE_FAN_NAMES = ("fibre_fan_x", "fibre_fan_y")


def _fibre_fan(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Turn fibres in proportion to their distance from the middle.

    Fibres that already spread keep their frame.
    """
    fibres = problem.fibres
    x, y = fibres.fan_deg
    spread = (x + values[FIBRE_FAN_NAMES[0]], y + values[FIBRE_FAN_NAMES[1]])
    where = fibres.frame if x or y else frame
    return replace(problem, fibres=replace(fibres, fan_deg=spread, frame=where))


FIBRE_FAN = Effect(
    name="fibre_fan",
    family="global material",
    summary="The ligaments spread out, or run together, towards the chest wall.",
    parameters=tuple(
        two_sided(
            name,
            DEGREE,
            30.0,
            f"rotation of the fibres towards {name[-1]} from the middle to the end of {name[-1]}",
        )
        for name in FIBRE_FAN_NAMES
    ),
    prior_sd=(12.0, 12.0),
    steps=(1e-3, 1e-3),
    transform=_fibre_fan,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.5.7",
        "C. Tanner et al., Med. Phys. 38 (2011) 682",
    ),
)


# --- fibre rotation
# Turn fibres away from the direction between chest wall and nipple.


FIBRE_ROTATION_NAMES = ("fibre_turn_x", "fibre_turn_y")


def _fibre_rotation(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Turn all fibres towards x and y."""
    x, y = problem.fibres.turn_deg
    turned = (x + values[FIBRE_ROTATION_NAMES[0]], y + values[FIBRE_ROTATION_NAMES[1]])
    return replace(problem, fibres=replace(problem.fibres, turn_deg=turned))


def _true_fibre_rotation(given: Mapping[str, Any]) -> dict[str, float]:
    """Convert an angle and its direction to rotations towards x and y, in degrees."""
    turn, azimuth = given["turn_deg"], math.radians(given["azimuth_deg"])
    return {
        "fibre_turn_x_deg": turn * math.cos(azimuth),
        "fibre_turn_y_deg": turn * math.sin(azimuth),
    }


FIBRE_ROTATION = Effect(
    name="fibre_rotation",
    family="global material",
    summary="The ligaments do not run from the chest wall to the nipple.",
    parameters=tuple(
        two_sided(name, DEGREE, 30.0, f"rotation of the fibres towards {name[-1]}")
        for name in FIBRE_ROTATION_NAMES
    ),
    prior_sd=(12.0, 12.0),
    steps=(1e-3, 1e-3),
    transform=_fibre_rotation,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.5.7",
        "C. Tanner et al., Med. Phys. 38 (2011) 682",
    ),
    truth=_true_fibre_rotation,
)


# --- second fibres
# Add a second family of fibres.


SECOND_FIBRES_NAME = "second_fibres"


def _second_fibres(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add fibres normal to the compression and to the first family.

    Along the compression they would be slack, because fibres act in tension only. A
    problem that already has a second family keeps its direction.
    """
    there = any(c.second_fibre_mpa for c in problem.constants.values())
    fibres = problem.fibres

    def changed(c: Constants) -> Constants:
        return replace(c, second_fibre_mpa=c.second_fibre_mpa + values[SECOND_FIBRES_NAME])

    axis = fibres.second_axis if there else _across(problem.load.device.axis)
    return replace(with_constants(problem, changed), fibres=replace(fibres, second_axis=axis))


def _across(axis: Triple) -> Triple:
    x, y, _ = axis
    return -y, x, 0.0


SECOND_FIBRES = Effect(
    name="second_fibres",
    family="global material",
    summary="Ligaments also run across the breast, between the plates.",
    parameters=(
        from_zero(
            SECOND_FIBRES_NAME, KPA, KPA.to_inside(100.0), "stiffness of fibres that run across"
        ),
    ),
    prior_sd=(KPA.to_inside(30.0),),
    steps=(KPA.to_inside(0.1),),
    transform=_second_fibres,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.5.7",
        "C. Tanner et al., Med. Phys. 38 (2011) 682",
    ),
)


# --- skin
# Add missing skin, or correct skin that is too thin or too soft.


ADDED, FACTOR = "skin_added", "ln_skin"
# Only E t matters for a sheet; this is how it is split where there is none yet.
THICKNESS_MM = 1.5


def add(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Increase the stiffness E t of the membrane, adding a membrane where there is none."""
    if not values[ADDED]:
        return problem
    skin = problem.membrane
    if skin is None:
        thicker = Membrane(values[ADDED] / THICKNESS_MM, THICKNESS_MM)
    else:
        thicker = replace(skin, young_mpa=skin.young_mpa + values[ADDED] / skin.thickness_mm)
    return replace(problem, membrane=thicker)


def scale(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the stiffness of the membrane, where there is one."""
    skin = problem.membrane
    if skin is None:
        return problem
    return replace(
        problem, membrane=replace(skin, young_mpa=skin.young_mpa * math.exp(values[FACTOR]))
    )


REFERENCES = (
    "M. A. Lago, PhD thesis, 2014, section 4.5.7",
    "J. A. Solves Llorens et al., Sci. World J. 2012, 876489",
)

SKIN_ADDED = Effect(
    name="skin_added",
    family="global material",
    summary="The skin adds a stiffness that the model lacks.",
    parameters=(
        from_zero(
            ADDED, N_PER_M, N_PER_M.to_inside(5000.0), "E t of the skin in addition to the model's"
        ),
    ),
    prior_sd=(N_PER_M.to_inside(1000.0),),
    steps=(N_PER_M.to_inside(10.0),),
    transform=add,
    references=REFERENCES,
    truth=renamed(skin_added_n_per_m="stiffness_n_per_m"),
)

SKIN_SCALED = Effect(
    name="skin_scaled",
    family="global material",
    summary="The skin of the model is too stiff or too soft, too thick or too thin.",
    parameters=(
        two_sided(
            FACTOR,
            NUMBER,
            1.5,
            "ln of the ratio of the skin's E t to the model's",
            reading=ratio("times as stiff as the model's skin"),
        ),
    ),
    prior_sd=(0.5,),
    steps=(1e-4,),
    transform=scale,
    references=REFERENCES,
)


# --- strain stiffening
# Let tissue stiffen as it is strained.


STRAIN_STIFFENING_NAME = "stiffening"


def _strain_stiffening(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Increase c2/mu of all tissues except those with a law of their own."""

    def changed(c: Constants) -> Constants:
        return c if c.law else replace(c, stiffening=c.stiffening + values[STRAIN_STIFFENING_NAME])

    return with_constants(problem, changed)


def _true_stiffening(given: Mapping[str, Any]) -> dict[str, float]:
    """Return c2 / mu = b / 4.

    Fung's law mu / (2 b) (exp(b (I1 - 3)) - 1) has the second term mu b / 4 (I1 - 3)^2.
    """
    return {STRAIN_STIFFENING_NAME: given["exponent"] / 4}


STIFFENING = Effect(
    name="strain_stiffening",
    family="global material",
    summary="The tissue stiffens as it is strained, more than a neo-Hookean body does.",
    parameters=(
        from_zero(
            STRAIN_STIFFENING_NAME,
            NUMBER,
            5.0,
            "c2/mu of Yeoh's law in all tissues",
            reading=Reading(name="c2/mu"),
        ),
    ),
    prior_sd=(1.5,),
    steps=(1e-2,),
    transform=_strain_stiffening,
    references=(
        "A. Mira et al., Clin. Biomech. 60 (2018) 191",
        "P. S. Wellman, PhD thesis, Harvard University, 1999",
    ),
    is_in_law=True,
    truth=_true_stiffening,
)
