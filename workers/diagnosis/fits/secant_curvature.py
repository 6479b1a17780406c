r"""Learns from its steps what Gauss and Newton's method leaves out of the curvature.

The Hessian of half a sum of squares is :math:`A^T A + \sum_i r_i \nabla^2 r_i`. The second part is
left out where residuals are small or change evenly. What acts at one place of a body moves its
points unevenly, and noise is never small: there a step along the first part alone falls short of
what it promises by ten times, and a line search crawls. The second part is learnt as in NL2SOL
(J. E. Dennis, D. M. Gay and R. E. Welsch, ACM Trans. Math. Softw. 7 (1981) 348), and used for the
next step where it would have told the last one better.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.settings.values import SETTINGS

SMALLEST = 1e-12


@dataclass(frozen=True, eq=False)
class LocalModel:
    """Half the cost around some parameters, in their prior standard deviations.

    Parameters
    ----------
    columns : ndarray, shape (m, p)
        Derivatives of the whitened residuals.
    residual : ndarray, shape (m,)
        Whitened, without what poses explain of it.
    gradient : ndarray, shape (p,)
        The prior's included.
    curvature : ndarray, shape (p, p)
        Of Gauss and Newton, the prior's included.
    """

    columns: FloatArray
    residual: FloatArray
    gradient: FloatArray
    curvature: FloatArray

    def fall(self, step: FloatArray, missing: FloatArray | None = None) -> float:
        """Return by how much the cost should fall over a step, (p,)."""
        bent = self.curvature if missing is None else self.curvature + missing
        return float(-2.0 * self.gradient @ step - step @ bent @ step)


@dataclass(frozen=True, eq=False)
class SecantCurvature:
    """What the curvature lacks, as the steps so far show it.

    Parameters
    ----------
    missing : ndarray, shape (p, p)
    is_used : bool
        Whether the next step takes it into account.
    last : LocalModel, optional
        Where the last step began.
    step : ndarray, shape (p,), optional
        That step.
    """

    missing: FloatArray
    is_used: bool = False
    last: LocalModel | None = None
    step: FloatArray | None = None

    @classmethod
    def unknown(cls, parameters: int) -> "SecantCurvature":
        """Return that of a fit which has not taken a step."""
        return cls(np.zeros((parameters, parameters)))

    @property
    def is_known(self) -> bool:
        """Whether any step has told of it."""
        return bool(self.missing.any())

    def used(self) -> "SecantCurvature":
        """Return the same, for the next step to take into account."""
        return replace(self, is_used=True)

    def stepped(self, model: LocalModel, step: FloatArray, fall: float) -> "SecantCurvature":
        """Return what is kept of a step from a model, over which the cost has fallen."""
        without, with_it = model.fall(step), model.fall(step, self.missing)
        better = self.is_known and abs(fall - with_it) < abs(fall - without)
        return SecantCurvature(self.missing, better, model, step)

    def renewed(self, now: LocalModel) -> "SecantCurvature":
        """Return what is known where the last step has ended."""
        if self.last is None or self.step is None:
            return self
        s, bent = self.step, self.missing
        y = now.gradient - self.last.gradient
        wanted = now.columns.T @ now.residual - self.last.columns.T @ now.residual
        along = float(s @ bent @ s)
        if along:
            bent = bent * min(1.0, abs(float(s @ wanted)) / abs(along))
        ys = float(y @ s)
        if ys > SMALLEST * float(np.linalg.norm(y) * np.linalg.norm(s)):
            off = wanted - bent @ s
            bent = bent + (np.outer(off, y) + np.outer(y, off)) / ys
            bent = bent - float(s @ off) * np.outer(y, y) / ys**2
        return SecantCurvature(bent, self.is_used)

    def forgotten(self) -> "SecantCurvature":
        """Return the same without the last step, of whose end the derivatives are not known."""
        return replace(self, last=None, step=None)

    def curvature(self, model: LocalModel) -> FloatArray:
        """Return the curvature for the next step, positive definite, shape (p, p)."""
        if not self.is_used:
            return model.curvature
        bent = model.curvature + self.missing
        lacks = SETTINGS.fit.least_curvature - float(np.linalg.eigvalsh(bent)[0])
        return bent + max(lacks, 0.0) * np.eye(len(bent))
