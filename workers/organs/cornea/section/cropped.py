"""The part of a section that lies between two vertical lines."""

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section.outline import Section


def cropped_section(section: Section, first_x_mm: float, last_x_mm: float) -> Section:
    """Return what a frame from one x to another shows of a section.

    A simulated section reaches from limbus to limbus, a frame less far: both are cropped to
    what they share before they are compared.

    Parameters
    ----------
    section : Section
        Its surfaces cross each of the two lines once.
    first_x_mm, last_x_mm : float
        Ascending; a line beyond an end of a surface leaves that end as it is.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If a surface lies outside the two lines, or crosses one of them more than once.
    """
    return Section(
        anterior_mm=_cropped(section.anterior_mm, first_x_mm, last_x_mm),
        posterior_mm=_cropped(section.posterior_mm, first_x_mm, last_x_mm),
    )


def _cropped(surface: FloatArray, first: float, last: float) -> FloatArray:
    x = surface[:, 0]
    inside = np.flatnonzero((x > first) & (x < last))
    if len(inside) < 2 or np.any(np.diff(inside) != 1):
        raise InputError(
            f"A surface from x = {x[0]:.3f} to {x[-1]:.3f} mm cannot be cropped to {first:.3f} to "
            f"{last:.3f} mm: it lies outside, or crosses a border more than once."
        )
    begin, end = inside[0], inside[-1]
    pieces = [surface[begin : end + 1]]
    if begin > 0:
        pieces.insert(0, _on_line(surface[begin - 1], surface[begin], first)[None])
    if end < len(x) - 1:
        pieces.append(_on_line(surface[end], surface[end + 1], last)[None])
    return np.concatenate(pieces)


def _on_line(a: FloatArray, b: FloatArray, x: float) -> FloatArray:
    """Return the point over x between two points."""
    return np.array([x, a[1] + (b[1] - a[1]) * (x - a[0]) / (b[0] - a[0])])
