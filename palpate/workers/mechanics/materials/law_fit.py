r"""Fits of laws to tables of stress and stretch from laboratory tests, and their comparison.

Tissue and rubber keep their volume in tests with homogeneous deformation, so the pressure follows
from the free face 3 of the specimen, ``sigma_33 = 0``, and not from a law. Along the load the
nominal stress (force per undeformed area) is

.. math:: P = P_{11} - P_{33} \lambda_3 / \lambda_1 .

Tables are read from CSV files. One column is the deformation: ``stretch`` (1 at rest), ``strain``
or ``strain_percent`` along the load, or ``shear``, the amount of simple shear. One is the nominal
stress, force per undeformed area: ``stress_kpa``, ``stress_mpa`` or ``stress_pa``. A column
``mode`` marks rows of tests that are not uniaxial: ``equibiaxial`` or ``planar``. Other columns
are ignored.

All tables have equal weight, whatever their number of points and size of stresses:
the residual of a point is divided by the root mean square of its table.

The search covers exponents and moduli together (trust region, with bounds). It starts
from the best of many given exponents, with their optimal moduli; a law without
exponents is fitted by linear least squares alone. Nothing is random: the same tables
give the same law.

Fits are ranked by the corrected Akaike information criterion of n points and k constants, one
of which is the variance of the points,

.. math:: \mathrm{AICc} = n \ln e^2 + 2 k + \frac{2 k (k + 1)}{n - k - 1} ,

with e the relative error of the fit. It assumes independent deviations of all points. Deviations
of a digitised or smoothed curve are not independent, and misfits common to all laws are not
noise: small differences then mean less than they seem to.

References
----------
R. W. Ogden, Proc. R. Soc. Lond. A 326 (1972) 565-584.
K. P. Burnham and D. R. Anderson, Model Selection and Multimodel Inference, Springer 2002,
sections 2.4 and 2.6.
"""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.input_files import read_text, reading
from palpate.workers.mechanics.materials.elastic_law import Isochoric, Law
from palpate.workers.mechanics.materials.law_plugins import LawFamily, LawPlugin


class DeformationMode(StrEnum):
    """Loading of a specimen, which defines the first column of its table."""

    UNIAXIAL = "uniaxial"  # stretch along the load, tension or compression
    EQUIBIAXIAL = "equibiaxial"  # stretch in both directions of the sheet
    PLANAR = "planar"  # stretch of a wide strip of constant width: pure shear
    SIMPLE_SHEAR = "simple shear"  # amount of shear, displacement over height


# Stretches of the three axes, as powers of the stretch along the load.
STRETCH_POWERS = {
    DeformationMode.UNIAXIAL: (1.0, -0.5, -0.5),
    DeformationMode.EQUIBIAXIAL: (1.0, 1.0, -2.0),
    DeformationMode.PLANAR: (1.0, 0.0, -1.0),
}


@dataclass(frozen=True, eq=False)
class StressTable:
    """One test of one material.

    Parameters
    ----------
    mode : Mode
    deformation : ndarray, shape (n,)
        Stretch along the load, > 0; in simple shear the amount of shear.
    stress_mpa : ndarray, shape (n,)
        Nominal stress along the load or the shear.

    Raises
    ------
    InputError
        If lengths differ, a number is not finite, a stretch is not positive or all
        stresses are zero.
    """

    mode: DeformationMode
    deformation: FloatArray
    stress_mpa: FloatArray

    def __post_init__(self) -> None:
        x, stress = np.asarray(self.deformation), np.asarray(self.stress_mpa)
        if x.ndim != 1 or x.shape != stress.shape:
            raise InputError(
                f"A {self.mode} table needs as many stresses as deformations, got shapes "
                f"{stress.shape} and {x.shape}."
            )
        if not (np.isfinite(x).all() and np.isfinite(stress).all() and stress.any()):
            raise InputError(
                f"A {self.mode} table needs finite numbers, and a stress other than zero."
            )
        if self.mode is not DeformationMode.SIMPLE_SHEAR and not (x > 0).all():
            raise InputError(
                f"A {self.mode} table needs stretches above zero, got {x.min():g}. Give the "
                "stretch, 1 at rest, and not the strain."
            )

    @property
    def rms_mpa(self) -> float:
        """Return the root mean square of the stresses."""
        return float(np.sqrt(np.mean(np.square(self.stress_mpa))))


def deformation_gradient(mode: DeformationMode, deformation: FloatArray) -> FloatArray:
    """Return the deformation gradient of a specimen that keeps its volume.

    Parameters
    ----------
    mode : Mode
    deformation : ndarray, shape (...)
        As in `StressTable`.

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    x = np.asarray(deformation, dtype=np.float64)
    F = np.zeros((*x.shape, 3, 3))
    for axis, power in enumerate(STRETCH_POWERS.get(mode, (0.0, 0.0, 0.0))):
        F[..., axis, axis] = x**power
    if mode is DeformationMode.SIMPLE_SHEAR:
        F[..., 0, 1] = x
    return F


def nominal_stress_mpa(law: Law, mode: DeformationMode, deformation: FloatArray) -> FloatArray:
    """Return the stress of a law in a test.

    Parameters
    ----------
    law : Law
        Isotropic, or with fibres along the axes.
    mode : Mode
    deformation : ndarray, shape (...)
        As in `StressTable`.

    Returns
    -------
    ndarray, shape (...)
        Force per undeformed area in MPa.

    Examples
    --------
    >>> from palpate.workers.mechanics.materials.polynomial_laws import NeoHookean
    >>> pulled = nominal_stress_mpa(NeoHookean(1.0), DeformationMode.UNIAXIAL, np.array([1.0, 2.0]))
    >>> pulled.round(12).tolist()  # mu (l - 1/l^2)
    [0.0, 1.75]
    """
    F = deformation_gradient(mode, deformation)
    P = law.stress(F)
    if mode is DeformationMode.SIMPLE_SHEAR:
        return P[..., 0, 1]  # the pressure acts on the diagonal and on P_21 only
    return P[..., 0, 0] - P[..., 2, 2] * F[..., 2, 2] / F[..., 0, 0]


DEFORMATION_COLUMNS: Mapping[str, Callable[[float], float]] = {
    "stretch": lambda x: x,
    "strain": lambda x: 1 + x,
    "strain_percent": lambda x: 1 + x / 100,
    "shear": lambda x: x,
}
STRESS_COLUMNS_MPA = {"stress_kpa": 1e-3, "stress_mpa": 1.0, "stress_pa": 1e-6}


def read_tables(path: Path) -> list[StressTable]:
    """Read the tables of a file, one for each mode.

    Raises
    ------
    InputError
        If the file cannot be read or a column or a number is missing.
    """
    with reading(path, "a table of stress and stretch"):
        return _tables_of_file(path)


def _tables_of_file(path: Path) -> list[StressTable]:
    try:
        lines = read_text(path).splitlines()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text: {error}. Save it as CSV.") from error
    kept = [
        (n, line) for n, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != "#"
    ]
    rows = list(csv.reader((line for _, line in kept), delimiter=_delimiter(kept)))
    heading = [cell.strip().lower() for cell in rows[0]] if rows else []
    deformation = _column(path, heading, DEFORMATION_COLUMNS, "the deformation")
    stress = _column(path, heading, STRESS_COLUMNS_MPA, "the nominal stress")
    points: dict[DeformationMode, list[tuple[float, float]]] = {}
    for (number, _), row in zip(kept[1:], rows[1:], strict=True):
        where = f"{path}, line {number}"
        cells = dict(zip(heading, (cell.strip() for cell in row), strict=False))
        mode = _stated_mode(where, deformation, cells.get("mode", ""))
        x, y = (
            _number_in_table(where, name, cells.get(name, "")) for name in (deformation, stress)
        )
        points.setdefault(mode, []).append(
            (DEFORMATION_COLUMNS[deformation](x), y * STRESS_COLUMNS_MPA[stress])
        )
    if not points:
        raise InputError(f"{path} has no rows below its heading.")
    try:
        return [StressTable(mode, *np.array(pairs).T) for mode, pairs in points.items()]
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _delimiter(lines: Sequence[tuple[int, str]]) -> str:
    heading = lines[0][1] if lines else ""
    return next((mark for mark in ",;\t" if mark in heading), ",")


def _column(path: Path, heading: Sequence[str], known: Mapping[str, object], of: str) -> str:
    found = [name for name in heading if name in known]
    if len(found) != 1:
        raise InputError(
            f"{path} needs one column of {of}: {', '.join(known)}; found the columns "
            f"{', '.join(heading) or 'none'}."
        )
    return found[0]


def _stated_mode(where: str, deformation: str, stated: str) -> DeformationMode:
    if deformation == "shear":
        return DeformationMode.SIMPLE_SHEAR
    try:
        mode = DeformationMode(stated.lower() or DeformationMode.UNIAXIAL)
    except ValueError:
        mode = DeformationMode.SIMPLE_SHEAR
    if mode not in STRETCH_POWERS:
        raise InputError(
            f"{where}: mode must be one of {', '.join(STRETCH_POWERS)}; found {stated!r}."
        )
    return mode


def _number_in_table(where: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} is not a number, found {text!r}.")
    return value


POLISHED_STARTS = 2  # starts that are refined
WORTHLESS_ERROR = 0.999  # zero stress has an error of 1


class FitCandidate(NamedTuple):
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


def fit(family: LawFamily, tables: Sequence[StressTable]) -> Fit:
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
    if fitted.error > WORTHLESS_ERROR:
        raise _without_stiffness(family)
    return fitted


def _without_stiffness(family: LawFamily) -> InputError:
    return InputError(
        f"{family.name} fits these tables best with zero stiffness at rest. Check that stress "
        "and stretch are not swapped and that compression is negative."
    )


def relative_error(law: Law, table: StressTable) -> float:
    """Return the root mean square of (law - table), relative to the table's stress."""
    residual = nominal_stress_mpa(law, table.mode, table.deformation) - table.stress_mpa
    return float(np.sqrt(np.mean(residual**2))) / table.rms_mpa


def _search(family: LawFamily, tables: Sequence[StressTable]) -> FitCandidate:
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
    return min(
        (_polish(family, start, tables, target) for start in starts[:POLISHED_STARTS]), key=_cost
    )


def _cost(candidate: FitCandidate) -> float:
    return candidate.cost


def _best_moduli(
    family: LawFamily, exponents: FloatArray, tables: Sequence[StressTable], target: FloatArray
) -> FitCandidate | None:
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
    return FitCandidate(float(best.cost), best.x / size, exponents)


def _polish(
    family: LawFamily, start: FitCandidate, tables: Sequence[StressTable], target: FloatArray
) -> FitCandidate:
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
    return FitCandidate(float(best.cost), best.x[:count], best.x[count:])


def _stresses(
    family: LawFamily, moduli: FloatArray, exponents: FloatArray, tables: Sequence[StressTable]
) -> FloatArray:
    law = family.build(moduli, exponents)
    with np.errstate(over="ignore", invalid="ignore"):
        stresses = [nominal_stress_mpa(law, t.mode, t.deformation) for t in tables]
        return _weighted(stresses, tables)


def _weighted(stresses: Sequence[FloatArray], tables: Sequence[StressTable]) -> FloatArray:
    weights = [1 / (t.rms_mpa * np.sqrt(len(t.stress_mpa) * len(tables))) for t in tables]
    return np.concatenate([w * stress for w, stress in zip(weights, stresses, strict=True)])


# Laws within this of the best AICc are supported about as well (Burnham and Anderson, section 2.6).
EQUALLY_WELL = 2.0
# Relative error below which fits do not differ: the rounding of a table with three digits.
LEAST_ERROR = 1e-3
# Total number of starts for a law without a family.
STARTS_WITHOUT_FAMILY = 64


@dataclass(frozen=True, slots=True, eq=False)
class LawFit:
    """Law fitted to tables.

    Parameters
    ----------
    plugin : LawPlugin
    shear_modulus_mpa : float
        Shear modulus at rest.
    shape : mapping of str to float
        Shape constants by their names in the plug-in, in internal units.
    fit : Fit
    aicc : float
        See above; infinite if there are too few points to compare laws.
    """

    plugin: LawPlugin
    shear_modulus_mpa: float
    shape: dict[str, float]
    fit: Fit
    aicc: float

    @property
    def constants(self) -> dict[str, float]:
        """Shape constants under their names and units in a file, without a tissue."""
        return {
            long.door_name: long.unit.to_door(self.shape[p.name])
            for p, long in zip(self.plugin.parameters, self.plugin.constants(), strict=True)
        }


def fit_law(plugin: LawPlugin, tables: Sequence[StressTable]) -> LawFit:
    """Fit a law to tables.

    Parameters
    ----------
    plugin : LawPlugin
    tables : sequence of Table
        Tests of one material.

    Raises
    ------
    InputError
        See `fit`; also if there are fewer points than constants.
    """
    points = sum(int(np.count_nonzero(table.stress_mpa)) for table in tables)
    constants = len(plugin.parameters) + 1
    if points < constants:
        raise InputError(
            f"The tables have {points} points under load, but {plugin.name} has {constants} "
            "constants. Add points, or choose a law with fewer."
        )
    fitted = fit(plugin.family or _family_of_plugin(plugin), tables)
    if plugin.family is None:
        shape = dict(zip((p.name for p in plugin.parameters), fitted.exponents, strict=True))
    else:
        shape = {name: float(value) for name, value in plugin.shape(fitted.law).items()}
    aicc = _aicc(fitted.error, points, constants)
    return LawFit(plugin, fitted.law.shear_modulus_mpa, shape, fitted, aicc)


def equally_good(fits: Sequence[LawFit]) -> list[LawFit]:
    """Return the fits that the tables support about as well as the best one, best first."""
    ranked = sorted(fits, key=lambda one: one.aicc)
    return [one for one in ranked if one.aicc <= ranked[0].aicc + EQUALLY_WELL]


def _aicc(error: float, points: int, constants: int) -> float:
    k = constants + 1
    if points - k - 1 <= 0:
        return math.inf
    spread = 2 * points * math.log(max(error, LEAST_ERROR))
    return spread + 2 * k + 2 * k * (k + 1) / (points - k - 1)


def _family_of_plugin(plugin: LawPlugin) -> LawFamily:
    """Return a family for any law: linear in its modulus, with a search over its shape."""
    names = [p.name for p in plugin.parameters]
    bounds = [p.bounds for p in plugin.parameters]
    each = max(2, int(STARTS_WITHOUT_FAMILY ** (1 / max(len(names), 1))))
    starts = tuple(product(*(np.linspace(*ends, each + 2)[1:-1].tolist() for ends in bounds)))
    return LawFamily(
        plugin.label,
        lambda moduli, shape: plugin.make(
            float(moduli[0]), dict(zip(names, shape.tolist(), strict=True))
        ),
        (0.0,),
        starts,
        ([low for low, _ in bounds], [high for _, high in bounds]),
    )
