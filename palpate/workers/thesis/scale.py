"""Scales at which an experiment is run."""

from typing import Literal

from palpate.storage.errors import InputError

# A sketch takes a minute and shows what the results look like; its numbers mean little.
Scale = Literal["sketch", "reduced", "full"]
SCALES: tuple[Scale, ...] = ("sketch", "reduced", "full")


def check_scale(scale: str) -> None:
    """Refuse an unknown scale.

    Raises
    ------
    InputError
        If `scale` is not in `SCALES`.
    """
    if scale not in SCALES:
        raise InputError(f"scale must be 'sketch', 'reduced' or 'full', got {scale!r}.")
