"""Assertions of the plug-in checks."""

import pickle
from typing import Any


def claim(holds: object, text: str) -> None:
    """Raise an `AssertionError` with `text` unless a condition holds."""
    if not holds:
        raise AssertionError(text)


def check_pickles(value: Any, name: str) -> None:
    """Check that a value can be pickled and sent to workers.

    Raises
    ------
    AssertionError
        If it cannot; a lambda, for example.
    """
    try:
        pickle.loads(pickle.dumps(value))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise AssertionError(
            f"{name} cannot be pickled, so workers cannot use it: {error}. Use functions of a "
            "module instead of lambdas and inner functions."
        ) from error
