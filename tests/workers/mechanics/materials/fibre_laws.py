"""One family of fibres, to add to an isotropic law."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.materials.elastic_law import Shape, shape_of, tangent_of_quadratic


@dataclass(frozen=True, eq=False)
class Fibres:
    r"""Family of fibres with a reference direction a at each point.

    .. math:: W = \frac{\eta}{2} (I_4 - 1)^2, \quad I_4 = |F a|^2

    This is a `Law` but not an `Isochoric` one: it is not isotropic, and a plain
    :math:`I_4` also resists a change of volume, as a real fibre does. With
    `isochoric` the invariant is :math:`\bar I_4 = J^{-2/3} I_4`, and the energy depends
    only on the change of shape.

    Parameters
    ----------
    eta_mpa : float
        Fibre stiffness in MPa, >= 0. Under a small strain e along a, the fibres
        alone carry ``4 eta e``.
    directions : ndarray, shape (..., 3)
        Directions in the undeformed body, of any non-zero length; one for all points, or
        leading axes that broadcast with F. Stored as unit vectors.
    tension_only : bool
        Whether fibres shorter than at rest carry no load. Otherwise they resist compression;
        below about ``I4 = 1 - mu / (2 eta)`` a body then has many equilibria.
    isochoric : bool
        Whether to use the isochoric invariant. It is nan where det F <= 0; the plain one
        is defined everywhere.

    Raises
    ------
    InputError
        If the stiffness is negative or a direction has zero length.

    Notes
    -----
    With `tension_only` the tangent jumps where the fibres are just straight; there, and at
    rest, it is the tangent of slack fibres.

    References
    ----------
    M. A. Lago, PhD thesis, 2014, Eq. 4.6.
    G. A. Holzapfel, Nonlinear Solid Mechanics, Wiley 2000, section 6.7.

    Examples
    --------
    >>> import numpy as np
    >>> along_z = Fibres(0.002, np.array([0.0, 0.0, 1.0]))
    >>> round(float(along_z.energy(np.diag([1.0, 1.0, 2.0]))), 12)
    0.009
    """

    eta_mpa: float
    directions: FloatArray
    tension_only: bool = True
    isochoric: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.eta_mpa) and self.eta_mpa >= 0):
            raise InputError(f"Fibres need a stiffness eta >= 0 MPa, got {self.eta_mpa:g}.")
        a = np.array(self.directions, dtype=np.float64)
        if a.ndim == 0 or a.shape[-1] != 3:
            raise InputError(f"Fibre directions need shape (..., 3), got {a.shape}.")
        length = np.linalg.norm(a, axis=-1, keepdims=True)
        bad = np.count_nonzero(~(np.isfinite(length) & (length > 0)))
        if bad:
            raise InputError(
                f"{bad} of {length.size} fibre directions have zero length. Give every point a "
                "vector (x, y, z) other than zero; where there are no fibres, set eta to zero."
            )
        a /= length
        a.setflags(write=False)
        object.__setattr__(self, "directions", a)

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `Law.energy`."""
        _, stretched = self._pull(shape_of(F).F if self.isochoric else F)
        return self.eta_mpa / 2 * stretched**2

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the stress, see `Law.stress`."""
        if not self.isochoric:
            Fa, stretched = self._pull(F)
            return self._dyad(2 * self.eta_mpa * stretched[..., None] * Fa)
        shape = shape_of(F)
        Fa, stretched = self._pull(shape.F)
        _, g = self._invariant(shape, Fa)
        return (shape.scale * self.eta_mpa * stretched)[..., None, None] * g

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the tangent, see `Law.tangent`."""
        S = self._dyad(self.directions)
        if self.isochoric:
            shape = shape_of(F)
            Fa, stretched = self._pull(shape.F)
            I4, g = self._invariant(shape, Fa)
            slope, curvature = self.eta_mpa * stretched, self._curvature(stretched)
            return tangent_of_quadratic(shape, I4, g, S, slope, curvature)
        Fa, stretched = self._pull(F)
        g = 2 * self._dyad(Fa)
        left = self._curvature(stretched)[..., None, None] * g
        A = left[..., :, :, None, None] * g[..., None, None, :, :]
        geometric = 2 * self.eta_mpa * stretched[..., None, None] * S
        for i in range(3):
            A[..., i, :, i, :] += geometric
        return A

    def _pull(self, F: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the deformed fibre F a, shape (..., 3), and its strain I4 - 1."""
        Fa = np.einsum("...iJ,...J->...i", F, self.directions)
        strain = np.einsum("...i,...i->...", Fa, Fa) - 1
        if self.tension_only:
            strain = np.where(strain.real < 0, 0, strain)  # nan stays nan
        return Fa, strain

    def _curvature(self, stretched: FloatArray) -> FloatArray:
        """Return the second derivative of the energy in I4; zero where fibres are slack."""
        return self.eta_mpa * ((stretched != 0) if self.tension_only else np.ones(stretched.shape))

    def _invariant(self, shape: Shape, Fa: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return I4 at J = 1 and its gradient at fixed volume."""
        I4 = np.einsum("...i,...i->...", Fa, Fa)
        return I4, 2 * self._dyad(Fa) - (2 / 3) * I4[..., None, None] * shape.G

    def _dyad(self, v: FloatArray) -> FloatArray:
        return v[..., :, None] * self.directions[..., None, :]
