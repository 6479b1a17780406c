"""Parameters of a corneal model: constants, pressures, and further effects.

Parameters that the thesis holds fixed have a neutral value, which changes nothing; the
pressures and the jet default to the values of the case.
"""

import math

from palpate.workers.mechanics.parameters import Parameter, Vocabulary
from palpate.workers.organs.cornea.material.constants import DEFAULT_BULK_MPA
from palpate.workers.units import DEGREE, KPA, MM, MM_PER_KPA, MMHG, NUMBER, PA, Unit

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
