"""The part of a section between two vertical lines."""

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section.outline import Section


def cropped_section(section: Section, first_x_mm: float, last_x_mm: float) -> Section:
    """Return the part of a section within a range of x, as shown by a frame.

    A simulated section extends from limbus to limbus, a frame does not: both are cropped to
    their common range before they are compared.

    Parameters
    ----------
    section : Section
        Each of its surfaces crosses each line once.
    first_x_mm, last_x_mm : float
        Ascending; a line beyond an end of a surface leaves that end unchanged.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If a surface is outside the two lines, or crosses one of them more than once.
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
            f"{last:.3f} mm: it is outside, or crosses a border more than once."
        )
    begin, end = inside[0], inside[-1]
    pieces = [surface[begin : end + 1]]
    if begin > 0:
        pieces.insert(0, _on_line(surface[begin - 1], surface[begin], first)[None])
    if end < len(x) - 1:
        pieces.append(_on_line(surface[end], surface[end + 1], last)[None])
    return np.concatenate(pieces)


def _on_line(a: FloatArray, b: FloatArray, x: float) -> FloatArray:
    """Return the point at x on the line through two points."""
    return np.array([x, a[1] + (b[1] - a[1]) * (x - a[0]) / (b[0] - a[0])])
