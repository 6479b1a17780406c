"""Check what the constants of every law must satisfy."""

import math
from collections.abc import Iterable, Mapping

from palpate.storage.errors import InputError


def require(
    name: str, law: object, positive: Mapping[str, float], finite: Iterable[float] = ()
) -> None:
    """Refuse constants that make no elastic body.

    Parameters
    ----------
    name : str
        Of the law, as a sentence begins.
    law : object
        Its representation shows what was found.
    positive : mapping of str to float
        Constants, or sums of them, that must be above zero.
    finite : iterable of float
        Constants that must be numbers.

    Raises
    ------
    InputError
        If one is not.
    """
    if not all(math.isfinite(value) for value in (*positive.values(), *finite)):
        raise InputError(f"{name} needs constants that are finite numbers, got {law}.")
    if not all(value > 0 for value in positive.values()):
        values = ", ".join(f"{symbol} = {value:g}" for symbol, value in positive.items())
        raise InputError(
            f"{name} needs {' and '.join(positive)} above zero, got {values} from {law}. "
            "Check signs and units (MPa; 1 kPa is 0.001 MPa)."
        )
