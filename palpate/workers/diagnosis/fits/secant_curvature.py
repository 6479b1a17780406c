r"""Secant estimate of the curvature that the Gauss-Newton method neglects.

The Hessian of half a sum of squares is :math:`A^T A + \sum_i r_i \nabla^2 r_i`. The second part is
negligible if the residuals are small or nearly linear. A localised effect moves the points
nonlinearly, and noise is never small: a step based on the first part alone then achieves a tenth of
the expected decrease, and a line search crawls. The second part is estimated as in NL2SOL (J. E.
Dennis, D. M. Gay and R. E. Welsch, ACM Trans. Math. Softw. 7 (1981) 348), and used for the next
step if it would have predicted the last step better.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.settings.values import SETTINGS

SMALLEST = 1e-12


@dataclass(frozen=True, eq=False)
class LocalModel:
    """Quadratic model of half the cost, with parameters in prior standard deviations.

    Parameters
    ----------
    columns : ndarray, shape (m, p)
        Derivatives of the whitened residuals.
    residual : ndarray, shape (m,)
        Whitened residuals, without the part that poses explain.
    gradient : ndarray, shape (p,)
        Gradient, including the prior.
    curvature : ndarray, shape (p, p)
        Gauss-Newton curvature, including the prior.
    """

    columns: FloatArray
    residual: FloatArray
    gradient: FloatArray
    curvature: FloatArray

    def fall(self, step: FloatArray, missing: FloatArray | None = None) -> float:
        """Return the expected decrease in cost over a step, (p,)."""
        bent = self.curvature if missing is None else self.curvature + missing
        return float(-2.0 * self.gradient @ step - step @ bent @ step)


@dataclass(frozen=True, eq=False)
class SecantCurvature:
    """The neglected curvature, estimated from the steps so far.

    Parameters
    ----------
    missing : ndarray, shape (p, p)
    is_used : bool
        Whether the next step takes the estimate into account.
    last : LocalModel, optional
        The model at the start of the last step.
    step : ndarray, shape (p,), optional
        The last step.
    """

    missing: FloatArray
    is_used: bool = False
    last: LocalModel | None = None
    step: FloatArray | None = None

    @classmethod
    def unknown(cls, parameters: int) -> "SecantCurvature":
        """Return the initial estimate, for a fit that has not taken a step."""
        return cls(np.zeros((parameters, parameters)))

    @property
    def is_known(self) -> bool:
        """Whether any step has contributed to the estimate."""
        return bool(self.missing.any())

    def used(self) -> "SecantCurvature":
        """Return the estimate, to be used in the next step."""
        return replace(self, is_used=True)

    def stepped(self, model: LocalModel, step: FloatArray, fall: float) -> "SecantCurvature":
        """Return the estimate after recording a step from a model, given the decrease in cost."""
        without, with_it = model.fall(step), model.fall(step, self.missing)
        better = self.is_known and abs(fall - with_it) < abs(fall - without)
        return SecantCurvature(self.missing, better, model, step)

    def renewed(self, now: LocalModel) -> "SecantCurvature":
        """Return the estimate updated at the end of the last step."""
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
        """Return the estimate without the last step, if the derivatives at its end are unknown."""
        return replace(self, last=None, step=None)

    def curvature(self, model: LocalModel) -> FloatArray:
        """Return the curvature for the next step, positive definite, shape (p, p)."""
        if not self.is_used:
            return model.curvature
        bent = model.curvature + self.missing
        lacks = SETTINGS.fit.least_curvature - float(np.linalg.eigvalsh(bent)[0])
        return bent + max(lacks, 0.0) * np.eye(len(bent))
