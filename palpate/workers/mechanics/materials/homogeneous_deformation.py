r"""Laboratory tests with homogeneous deformation.

Tissue and rubber keep their volume in such tests, so the pressure follows from the
free face 3 of the specimen, ``sigma_33 = 0``, and not from a law. Along the load the
nominal stress (force per undeformed area) is

.. math:: P = P_{11} - P_{33} \lambda_3 / \lambda_1 .

References
----------
R. W. Ogden, Proc. R. Soc. Lond. A 326 (1972) 565-584.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.base import Law


class Mode(StrEnum):
    """Loading of a specimen, which defines the first column of its table."""

    UNIAXIAL = "uniaxial"  # stretch along the load, tension or compression
    EQUIBIAXIAL = "equibiaxial"  # stretch in both directions of the sheet
    PLANAR = "planar"  # stretch of a wide strip of constant width: pure shear
    SIMPLE_SHEAR = "simple shear"  # amount of shear, displacement over height


# Stretches of the three axes, as powers of the stretch along the load.
POWERS = {
    Mode.UNIAXIAL: (1.0, -0.5, -0.5),
    Mode.EQUIBIAXIAL: (1.0, 1.0, -2.0),
    Mode.PLANAR: (1.0, 0.0, -1.0),
}


@dataclass(frozen=True, eq=False)
class Table:
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

    mode: Mode
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
        if self.mode is not Mode.SIMPLE_SHEAR and not (x > 0).all():
            raise InputError(
                f"A {self.mode} table needs stretches above zero, got {x.min():g}. Give the "
                "stretch, 1 at rest, and not the strain."
            )

    @property
    def rms_mpa(self) -> float:
        """Return the root mean square of the stresses."""
        return float(np.sqrt(np.mean(np.square(self.stress_mpa))))


def deformation_gradient(mode: Mode, deformation: FloatArray) -> FloatArray:
    """Return the deformation gradient of a specimen that keeps its volume.

    Parameters
    ----------
    mode : Mode
    deformation : ndarray, shape (...)
        As in `Table`.

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    x = np.asarray(deformation, dtype=np.float64)
    F = np.zeros((*x.shape, 3, 3))
    for axis, power in enumerate(POWERS.get(mode, (0.0, 0.0, 0.0))):
        F[..., axis, axis] = x**power
    if mode is Mode.SIMPLE_SHEAR:
        F[..., 0, 1] = x
    return F


def nominal_stress_mpa(law: Law, mode: Mode, deformation: FloatArray) -> FloatArray:
    """Return the stress of a law in a test.

    Parameters
    ----------
    law : Law
        Isotropic, or with fibres along the axes.
    mode : Mode
    deformation : ndarray, shape (...)
        As in `Table`.

    Returns
    -------
    ndarray, shape (...)
        Force per undeformed area in MPa.

    Examples
    --------
    >>> from palpate.workers.mechanics.materials.neo_hookean import NeoHookean
    >>> pulled = nominal_stress_mpa(NeoHookean(1.0), Mode.UNIAXIAL, np.array([1.0, 2.0]))
    >>> pulled.round(12).tolist()  # mu (l - 1/l^2)
    [0.0, 1.75]
    """
    F = deformation_gradient(mode, deformation)
    P = law.stress(F)
    if mode is Mode.SIMPLE_SHEAR:
        return P[..., 0, 1]  # the pressure acts on the diagonal and on P_21 only
    return P[..., 0, 0] - P[..., 2, 2] * F[..., 2, 2] / F[..., 0, 0]
