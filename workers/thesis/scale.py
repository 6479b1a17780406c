"""How large an experiment is run."""

from typing import Literal

from palpate.storage.errors import InputError

# A sketch takes a minute and shows what comes out; its numbers mean little.
Scale = Literal["sketch", "reduced", "full"]
SCALES: tuple[Scale, ...] = ("sketch", "reduced", "full")


def check_scale(scale: str) -> None:
    """Refuse what is no scale.

    Raises
    ------
    InputError
        If `scale` is none of `SCALES`.
    """
    if scale not in SCALES:
        raise InputError(f"The scale is 'sketch', 'reduced' or 'full', got {scale!r}.")
