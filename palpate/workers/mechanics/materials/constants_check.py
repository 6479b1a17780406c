"""Checks common to the constants of all laws."""

import math
from collections.abc import Iterable, Mapping

from palpate.storage.errors import InputError


def require(
    name: str, law: object, positive: Mapping[str, float], finite: Iterable[float] = ()
) -> None:
    """Reject constants that do not describe an elastic body.

    Parameters
    ----------
    name : str
        Name of the law, as the beginning of a sentence.
    law : object
        Shown in the error message.
    positive : mapping of str to float
        Constants, or sums of them, that must be above zero.
    finite : iterable of float
        Constants that must be numbers.

    Raises
    ------
    InputError
        If a constant violates its condition.
    """
    if not all(math.isfinite(value) for value in (*positive.values(), *finite)):
        raise InputError(f"{name} needs constants that are finite numbers, got {law}.")
    if not all(value > 0 for value in positive.values()):
        values = ", ".join(f"{symbol} = {value:g}" for symbol, value in positive.items())
        raise InputError(
            f"{name} needs {' and '.join(positive)} above zero, got {values} from {law}. "
            "Check signs and units (MPa; 1 kPa is 0.001 MPa)."
        )
