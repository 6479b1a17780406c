"""Specification of a breast study, with its nuisance parameters: scan, load and law."""

from palpate.workers.organs.breast.effects import BREAST_MODEL, NUISANCES
from palpate.workers.organs.breast.spec import BreastCase, BreastScore, BreastTarget
from palpate.workers.organs.nuisances import Nuisance
from palpate.workers.organs.organ_spec import OrganSpec


def nuisances(case: BreastCase, imaged: bool) -> tuple[Nuisance, ...]:
    """Return the nuisance parameters of a case that its laws do not replace; see `OrganSpec`."""
    present = {"model"}
    if imaged:
        present |= {"image"} if case.load.force_n is None else {"image", "force"}
    found = (n for one in NUISANCES if one.of in present for n in one.parameters)
    return tuple(n for n in found if not case.unused_parameter(n.name))


SPEC = OrganSpec(BreastCase, BreastTarget, BreastScore, BREAST_MODEL, nuisances)
