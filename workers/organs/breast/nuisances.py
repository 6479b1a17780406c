"""Nuisance parameters of a breast study: place and scale of the scan, load, law of the tissue."""

from palpate.workers.organs.breast.effects import NUISANCES
from palpate.workers.organs.breast.spec import LoadSpec
from palpate.workers.organs.nuisances import Nuisance


def nuisances(load: LoadSpec, imaged: bool) -> tuple[Nuisance, ...]:
    """Return the nuisance parameters of a target under a load; see `Organ.nuisances`."""
    present = {"model"}
    if imaged:
        present |= {"image"} if load.force_n is None else {"image", "force"}
    return tuple(n for one in NUISANCES if one.of in present for n in one.parameters)
