"""Sensitivity of the residuals to an effect."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.diagnosis.algebra.linearisation import Linearised


@dataclass(frozen=True, eq=False)
class EffectSensitivity:
    """Derivatives of the residuals with respect to the parameters of one effect.

    Parameters
    ----------
    name : str
    family : str
        Family, shared by similar effects.
    columns : ndarray, shape (m, q) or (g, m, q)
        Derivatives in mm per unit; a stack for an effect evaluated at g places, or at g magnitudes,
        the largest first.
    prior_sd : ndarray, shape (q,)
        Plausible scale of each parameter, > 0.
    one_sided : ndarray of bool, shape (q,)
        Whether a parameter is nonnegative, with a half-normal prior.
    held_sd : tuple of float
        See `Effect.held_sd`.
    resembles_roughness : bool
        See `Effect.resembles_roughness`.

    Raises
    ------
    InputError
        If shapes do not match, a number is not finite, or a scale is not positive.
    """

    name: str
    family: str
    columns: FloatArray
    prior_sd: FloatArray
    one_sided: BoolArray
    held_sd: tuple[float, ...] = ()
    resembles_roughness: bool = False

    def __post_init__(self) -> None:
        q = len(self.prior_sd)
        shapes = self.columns.shape, self.prior_sd.shape, self.one_sided.shape
        fits = self.columns.ndim in (2, 3) and self.columns.shape[-1] == q
        if not fits or shapes[1:] != ((q,), (q,)):
            raise InputError(
                f"The effect {self.name} needs columns (m, q) or (g, m, q), prior_sd (q,) and "
                f"one_sided (q,), found {shapes}."
            )
        if not np.isfinite(self.columns).all() or not (self.prior_sd > 0).all():
            raise InputError(
                f"The effect {self.name} needs finite columns and prior_sd > 0, found "
                f"{int((~np.isfinite(self.columns)).sum())} non-finite entries in columns and "
                f"prior_sd {self.prior_sd.tolist()}."
            )

    @property
    def is_stacked(self) -> bool:
        """Whether there are columns for several places or magnitudes."""
        return self.columns.ndim == 3

    @property
    def places(self) -> FloatArray:
        """Columns of each place or magnitude, shape (g, m, q), with g = 1 if there is only one."""
        return self.columns if self.is_stacked else self.columns[None]

    @property
    def is_steep(self) -> bool:
        """Whether the response to the effect grows faster than its magnitude."""
        large, small = np.linalg.norm(self.places[[0, -1], :, 0], axis=1)
        return bool(large > small)

    def whitened(self, problem: Linearised) -> FloatArray:
        """Return the columns in whitened space per prior standard deviation, shape (g, m, q).

        Raises
        ------
        InputError
            If the problem has a different number of residuals.
        """
        g, m, q = self.places.shape
        if m != problem.size:
            raise InputError(
                f"The effect {self.name} has columns for {m} residuals, but the problem has "
                f"{problem.size}. Both must list the same points of the same states."
            )
        flat = self.places.transpose(1, 0, 2).reshape(m, g * q)
        white = problem.whiten(flat).reshape(m, g, q) * self.prior_sd
        return np.ascontiguousarray(white.transpose(1, 0, 2))
