"""How a check says what is wrong."""

import pickle
from typing import Any


def claim(holds: object, text: str) -> None:
    """Raise an `AssertionError` with `text` unless something holds."""
    if not holds:
        raise AssertionError(text)


def check_pickles(value: Any, name: str) -> None:
    """Check that a value reaches workers: it is pickled and read back.

    Raises
    ------
    AssertionError
        If it cannot be, as is the case for a lambda.
    """
    try:
        pickle.loads(pickle.dumps(value))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise AssertionError(
            f"{name} cannot be pickled, so it does not reach workers: {error}. Use functions of a "
            "module instead of lambdas and inner functions."
        ) from error
