"""Dependence of a fitted modulus on the range of its tables: on parts of it, and on a slack start.

A law is a smooth curve through all points, and its slope at rest depends on where the points are.
It is therefore fitted again to parts of each table, and to tables whose strain is counted from an
offset. A grip that slips into place and fibres that straighten look alike in a table, so the offset
is shown and not subtracted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.law_fit import (
    DeformationMode,
    LawFit,
    StressTable,
    fit_law,
)
from palpate.workers.mechanics.materials.law_plugins import LawPlugin

# Parts of the range of deformation, as fractions of its largest distance from rest.
PARTS = ((0.0, 0.5), (0.0, 0.75), (0.125, 1.0), (0.25, 1.0))
# Largest part of the largest stress that a slack start carries, and the number of offsets tried.
LITTLE, OFFSETS = 0.1, 6
# Improvement of AICc from which an offset is shown; below 10 the law without it has some support
# (Burnham and Anderson, section 2.6).
BETTER = 10.0
AICC_OF_OFFSET = 2.0
# An offset is a constant more; laws with more shape constants than this follow a slack start.
MOST_SHAPES = 2


@dataclass(frozen=True, slots=True, eq=False)
class TableSlack:
    """Start of a table that carries little stress.

    Parameters
    ----------
    table : int
        Its place among the tables.
    offset : float
        Strain, or amount of shear, from which the law starts.
    fit : LawFit
        Law fitted to this table alone, with the strain counted from the offset.
    """

    table: int
    offset: float
    fit: LawFit


def moduli_of_parts(law_fit: LawFit, tables: Sequence[StressTable]) -> tuple[float, float] | None:
    """Return the least and the largest shear modulus in MPa, over the whole and parts of tables.

    Parts with too few points, or which the law cannot follow, are left out; None if all are.
    """
    moduli = []
    for low, high in PARTS:
        parts = [part for table in tables if (part := _part(table, low, high)) is not None]
        if _points(parts) == _points(tables):
            continue
        try:
            moduli.append(fit_law(law_fit.plugin, parts).shear_modulus_mpa)
        except InputError:
            continue
    if not moduli:
        return None
    moduli.append(law_fit.shear_modulus_mpa)
    return min(moduli), max(moduli)


def _points(tables: Sequence[StressTable]) -> int:
    return sum(len(table.deformation) for table in tables)


def _strain(table: StressTable) -> FloatArray:
    """Return the deformation relative to rest."""
    rest = 0.0 if table.mode is DeformationMode.SIMPLE_SHEAR else 1.0
    return np.asarray(table.deformation - rest)


def _part(table: StressTable, low: float, high: float) -> StressTable | None:
    away = np.abs(_strain(table))
    kept = (away >= low * away.max()) & (away <= high * away.max())
    if not table.stress_mpa[kept].any():
        return None
    return StressTable(table.mode, table.deformation[kept], table.stress_mpa[kept])


def slack_of(plugins: Sequence[LawPlugin], tables: Sequence[StressTable]) -> Iterator[TableSlack]:
    """Yield the tables that some law follows much better from an offset than any law from zero.

    Each table is examined alone: in a joint fit, an offset makes up for what the law misses in
    the others.
    """
    for number, table in enumerate(tables):
        strain = _strain(table)
        if strain.min() < 0 < strain.max():  # strains of both signs show where rest is
            continue
        fits = [one for plugin in plugins if (one := _fitted(plugin, table, 0.0))]
        few = [plugin for plugin in plugins if len(plugin.parameters) <= MOST_SHAPES]
        found = [slack for plugin in few if (slack := _best_offset(plugin, table, number))]
        if not (fits and found):
            continue
        best = min(found, key=lambda slack: slack.fit.aicc)
        if best.fit.aicc + AICC_OF_OFFSET < min(one.aicc for one in fits) - BETTER:
            yield best


def _fitted(plugin: LawPlugin, table: StressTable, offset: float) -> LawFit | None:
    try:
        return fit_law(plugin, [from_offset(table, offset)])
    except InputError:
        return None


def _best_offset(plugin: LawPlugin, table: StressTable, number: int) -> TableSlack | None:
    """Return the offset of a table that a law follows best, within its start of little stress."""
    away, stress = np.abs(_strain(table)), np.abs(table.stress_mpa)
    largest = float(away[stress > LITTLE * stress.max()].min())

    def error(offset: float) -> float:
        law_fit = _fitted(plugin, table, offset)
        return np.inf if law_fit is None else law_fit.fit.error

    grid = np.linspace(0, largest, OFFSETS)
    place = int(np.argmin([error(offset) for offset in grid]))
    ends = grid[max(place - 1, 0)], grid[min(place + 1, OFFSETS - 1)]
    refined = minimize_scalar(error, bounds=ends, method="bounded", options={"maxiter": 12})
    law_fit = _fitted(plugin, table, float(refined.x))
    return None if law_fit is None else TableSlack(number, float(refined.x), law_fit)


def from_offset(table: StressTable, offset: float) -> StressTable:
    """Return a table whose strain is counted from an offset; before it, the specimen is at rest."""
    strain = _strain(table)
    beyond = np.sign(strain) * np.maximum(np.abs(strain) - offset, 0.0)
    if table.mode is DeformationMode.SIMPLE_SHEAR:
        return replace(table, deformation=beyond)
    longer = 1 + np.sign(strain.sum()) * offset
    return replace(table, deformation=1 + beyond / longer)
