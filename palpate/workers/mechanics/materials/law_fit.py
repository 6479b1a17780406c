r"""Fits of the available laws to tables, and their comparison.

Fits are ranked by the corrected Akaike information criterion of n points and k constants, one
of which is the variance of the points,

.. math:: \mathrm{AICc} = n \ln e^2 + 2 k + \frac{2 k (k + 1)}{n - k - 1} ,

with e the relative error of the fit. It assumes independent deviations of all points. Deviations
of a digitised or smoothed curve are not independent, and misfits common to all laws are not
noise: small differences then mean less than they seem to.

References
----------
K. P. Burnham and D. R. Anderson, Model Selection and Multimodel Inference, Springer 2002,
sections 2.4 and 2.6.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.fit import Fit, fit
from palpate.workers.mechanics.materials.homogeneous_deformation import Table
from palpate.workers.mechanics.materials.law_families import Family
from palpate.workers.mechanics.materials.law_plugins import LawPlugin

# Laws within this of the best AICc are supported about as well (Burnham and Anderson, section 2.6).
EQUALLY_WELL = 2.0
# Relative error below which fits do not differ: the rounding of a table with three digits.
LEAST_ERROR = 1e-3
# Total number of starts for a law without a family.
STARTS = 64


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


def fit_law(plugin: LawPlugin, tables: Sequence[Table]) -> LawFit:
    """Fit a law to tables.

    Parameters
    ----------
    plugin : LawPlugin
    tables : sequence of Table
        Tests of one material.

    Raises
    ------
    InputError
        See `workers.mechanics.materials.fit.fit`; also if there are fewer points than constants.
    """
    points = sum(int(np.count_nonzero(table.stress_mpa)) for table in tables)
    constants = len(plugin.parameters) + 1
    if points < constants:
        raise InputError(
            f"The tables have {points} points under load, but {plugin.name} has {constants} "
            "constants. Add points, or choose a law with fewer."
        )
    fitted = fit(plugin.family or _family(plugin), tables)
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


def _family(plugin: LawPlugin) -> Family:
    """Return a family for any law: linear in its modulus, with a search over its shape."""
    names = [p.name for p in plugin.parameters]
    bounds = [p.bounds for p in plugin.parameters]
    each = max(2, int(STARTS ** (1 / max(len(names), 1))))
    starts = tuple(product(*(np.linspace(*ends, each + 2)[1:-1].tolist() for ends in bounds)))
    return Family(
        plugin.label,
        lambda moduli, shape: plugin.make(
            float(moduli[0]), dict(zip(names, shape.tolist(), strict=True))
        ),
        (0.0,),
        starts,
        ([low for low, _ in bounds], [high for _, high in bounds]),
    )
