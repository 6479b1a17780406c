"""How large an experiment is run."""

from typing import Literal

from storage.errors import InputError

Scale = Literal["reduced", "full"]
SCALES: tuple[Scale, ...] = ("reduced", "full")


def check_scale(scale: str) -> None:
    """Refuse what is neither the reduced nor the full scale.

    Raises
    ------
    InputError
        If `scale` is neither.
    """
    if scale not in SCALES:
        raise InputError(f"The scale is 'reduced' or 'full', got {scale!r}.")
