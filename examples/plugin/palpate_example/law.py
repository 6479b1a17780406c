"""A law: Gent's, which stiffens without bound at a limiting stretch."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.elastic_law import (
    Isochoric,
    shape_of,
    stress,
    tangent_of_first,
)
from palpate.workers.mechanics.materials.law_plugins import LawPlugin
from palpate.workers.mechanics.model_parameters import NUMBER, Parameter


@dataclass(frozen=True, slots=True)
class Gent:
    r"""Gent's law (A. N. Gent, Rubber Chem. Technol. 69 (1996) 59).

    .. math:: W = -\frac{\mu}{2 l} \ln(1 - l x), \quad x = \bar I_1 - 3

    Parameters
    ----------
    mu_mpa : float
        Shear modulus at rest.
    lock : float
        l, the inverse of Gent's J_m; at zero the law is neo-Hookean. Beyond x = 1/l there is no
        energy: nan.
    """

    mu_mpa: float
    lock: float

    @property
    def shear_modulus_mpa(self) -> float:
        """The shear modulus at rest."""
        return self.mu_mpa

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `palpate.workers.mechanics.materials.elastic_law.Law.energy`."""
        x = shape_of(F).I1 - 3
        if self.lock == 0:
            return self.mu_mpa / 2 * x
        return -self.mu_mpa / (2 * self.lock) * np.log(self._left(x))

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the first Piola-Kirchhoff stress."""
        shape = shape_of(F)
        return stress(shape, self.mu_mpa / 2 / self._left(shape.I1 - 3))

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the derivative of the stress."""
        shape = shape_of(F)
        left = self._left(shape.I1 - 3)
        slope = self.mu_mpa / 2 / left
        return tangent_of_first(shape, slope, slope * self.lock / left)

    def _left(self, x: FloatArray) -> FloatArray:
        left = 1 - self.lock * x
        return np.where(left > 0, left, np.nan)


def make(shear_modulus_mpa: float, shape: Mapping[str, float]) -> Isochoric:
    """Return the law of these constants."""
    return Gent(shear_modulus_mpa, max(0.0, shape["lock"]))


GENT = LawPlugin(
    name="gent",
    label="Gent",
    parameters=(
        Parameter("lock", NUMBER, 0.0, 0.2, 0.0, "inverse of Gent's J_m", open_lower=False),
    ),
    make=make,
)
