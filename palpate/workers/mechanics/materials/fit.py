"""Fits of the constants of a law to tables of stress and stretch.

All tables have equal weight, whatever their number of points and size of stresses:
the residual of a point is divided by the root mean square of its table.

The search covers exponents and moduli together (trust region, with bounds). It starts
from the best of many given exponents, with their optimal moduli; a law without
exponents is fitted by linear least squares alone. Nothing is random: the same tables
give the same law.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.base import Isochoric, Law
from palpate.workers.mechanics.materials.homogeneous_deformation import Table, nominal_stress_mpa
from palpate.workers.mechanics.materials.law_families import Family

POLISHED = 2  # starts that are refined
WORTHLESS = 0.999  # zero stress has an error of 1


class Candidate(NamedTuple):
    """Point of the search, with half of its squared residual."""

    cost: float
    moduli: FloatArray
    exponents: FloatArray


@dataclass(frozen=True, slots=True)
class Fit:
    """Fitted law and its errors.

    Parameters
    ----------
    law : Isochoric
    errors : tuple of float
        One per table: root mean square of (law - table), relative to that of the table's stress.
    exponents : tuple of float
        Exponents of the family.
    """

    law: Isochoric
    errors: tuple[float, ...]
    exponents: tuple[float, ...] = ()

    @property
    def error(self) -> float:
        """Return the root mean square of `errors`; 0.01 is one per cent of the stress."""
        return float(np.sqrt(np.mean(np.square(self.errors))))

    @property
    def coefficients(self) -> dict[str, Any]:
        """Return the constants of the law by name, with units in the names."""
        return asdict(self.law)  # type: ignore[call-overload]


def fit(family: Family, tables: Sequence[Table]) -> Fit:
    """Fit the constants of a law by least squares.

    Parameters
    ----------
    family : Family
    tables : sequence of Table
        Tests of one material; a mode may occur repeatedly.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        If there are fewer points than constants, or the best law has no stiffness at rest.
    """
    points = sum(np.count_nonzero(table.stress_mpa) for table in tables)
    if points < family.constants:
        raise InputError(
            f"{family.name} has {family.constants} constants, but the tables have {points} points "
            "with stress. Give more tests or choose a law with fewer constants."
        )
    best = _search(family, tables)
    try:
        law = family.build(best.moduli, best.exponents)
    except InputError as error:
        raise _without_stiffness(family) from error
    errors = tuple(relative_error(law, table) for table in tables)
    fitted = Fit(law, errors, tuple(best.exponents.tolist()))
    if fitted.error > WORTHLESS:
        raise _without_stiffness(family)
    return fitted


def _without_stiffness(family: Family) -> InputError:
    return InputError(
        f"{family.name} fits these tables best with zero stiffness at rest. Check that stress "
        "and stretch are not swapped and that compression is negative."
    )


def relative_error(law: Law, table: Table) -> float:
    """Return the root mean square of (law - table), relative to the table's stress."""
    residual = nominal_stress_mpa(law, table.mode, table.deformation) - table.stress_mpa
    return float(np.sqrt(np.mean(residual**2))) / table.rms_mpa


def _search(family: Family, tables: Sequence[Table]) -> Candidate:
    target = _weighted([table.stress_mpa for table in tables], tables)
    tried = (_best_moduli(family, np.array(start), tables, target) for start in family.starts)
    starts = sorted((start for start in tried if start is not None), key=_cost)
    if not starts:
        raise InputError(
            f"The deformations are too large for {family.name}: its stresses overflow. Give "
            "stretches, 1 at rest, not per cent."
        )
    if not family.starts[0]:
        return starts[0]
    return min((_polish(family, start, tables, target) for start in starts[:POLISHED]), key=_cost)


def _cost(candidate: Candidate) -> float:
    return candidate.cost


def _best_moduli(
    family: Family, exponents: FloatArray, tables: Sequence[Table], target: FloatArray
) -> Candidate | None:
    """Fit the moduli for given exponents by least squares; None if a stress overflows."""
    count = len(family.moduli_least)
    first, *others = np.eye(count)
    unit = _stresses(family, first, exponents, tables)
    columns = [unit, *(_stresses(family, first + k, exponents, tables) - unit for k in others)]
    A = np.stack(columns, axis=1)
    size = np.abs(A).max(axis=0)
    if not (np.isfinite(size).all() and size.all()):
        return None
    # Scale the columns: powers of stretches differ by twenty orders of magnitude.
    best = lsq_linear(A / size, target, (family.moduli_least, np.inf), method="bvls")
    return Candidate(float(best.cost), best.x / size, exponents)


def _polish(
    family: Family, start: Candidate, tables: Sequence[Table], target: FloatArray
) -> Candidate:
    """Refine moduli and exponents together."""
    count = len(start.moduli)
    least, most = family.exponent_range

    def residual(x: FloatArray) -> FloatArray:
        return _stresses(family, x[:count], x[count:], tables) - target

    best = least_squares(
        residual,
        np.concatenate([start.moduli, start.exponents]),
        bounds=(
            [*family.moduli_least, *np.broadcast_to(least, start.exponents.shape)],
            [*[np.inf] * count, *np.broadcast_to(most, start.exponents.shape)],
        ),
        x_scale="jac",
        ftol=1e-12,
        xtol=1e-12,
        gtol=1e-14,
        max_nfev=500,
    )
    return Candidate(float(best.cost), best.x[:count], best.x[count:])


def _stresses(
    family: Family, moduli: FloatArray, exponents: FloatArray, tables: Sequence[Table]
) -> FloatArray:
    law = family.build(moduli, exponents)
    with np.errstate(over="ignore", invalid="ignore"):
        stresses = [nominal_stress_mpa(law, t.mode, t.deformation) for t in tables]
        return _weighted(stresses, tables)


def _weighted(stresses: Sequence[FloatArray], tables: Sequence[Table]) -> FloatArray:
    weights = [1 / (t.rms_mpa * np.sqrt(len(t.stress_mpa) * len(tables))) for t in tables]
    return np.concatenate([w * stress for w, stress in zip(weights, stresses, strict=True)])
