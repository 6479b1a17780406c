"""Settings of a cornea in a study file, and its nuisance parameters: the position of the eye."""

from palpate.workers.organs.cornea.parameters import CORNEA
from palpate.workers.organs.cornea.spec import CorneaCase, CorneaScore, CorneaTarget
from palpate.workers.organs.nuisances import Nuisance
from palpate.workers.organs.organ_spec import OrganSpec

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
