r"""One linear step of a fit, and its effect on the noise in the residuals.

With a residual r, noise of covariance C and a fit that changes residuals by ``r -> r + F r``, the
noise covariance after the fit is ``(I + F) C (I + F)'``. The mean square error of the fitted model
on a noise-free image is smaller than the mean square residual by

.. math:: \overline{\mathrm{diag}\,C} + 2\,\overline{\mathrm{diag}\,FC}:

the noise, and the part of it that the fit absorbed (the covariance penalty of C. L. Mallows,
Technometrics 15 (1973) 661, and B. Efron, J. Am. Stat. Assoc. 99 (2004) 619). Without a fit, F is
zero.

The pose of a scan is not an error of the model. If scans are registered by another fit, with ``r ->
r + R r``, C includes the uncertainty of the poses, and only the remainder counts as noise: ``(I +
R) C (I + R)'`` replaces C in the first term, and ``F C (I + R)'`` replaces FC.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.diagnosis.algebra.linearisation import Linearised, factored


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Poses of the scans from one fit, as a step ``-(gain r + shift)`` in prior sd.

    Parameters
    ----------
    gain : ndarray, shape (q, m)
        Matrix applied to the residuals of the registered model.
    shift : ndarray, shape (q,)
    """

    gain: FloatArray
    shift: FloatArray

    @classmethod
    def by(cls, best: "LinearFit", count: int, residual: FloatArray) -> "Registration":
        """Return the best model's registration, for another model of the same scans.

        An incomplete model would move the scans to compensate for what it lacks, so it must not
        register them itself.

        Parameters
        ----------
        best : LinearFit
            Fit to all residuals. Its last `count` parameters are the poses of the scans.
        count : int
        residual : ndarray, shape (m,)
            Residuals of the other model.
        """
        which = slice(len(best.bias) - count, None)
        gain = best.gain[which]
        return cls(gain, best.bias[which] + gain @ (best.problem.residual - residual))


class LinearFit:
    """The residual after one linear step to the optimum, and the noise in it.

    Parameters
    ----------
    problem : Linearised
    train : ndarray of bool, shape (m,), optional
        Residuals used in the fit; all by default.
    judge : ndarray of bool, shape (m,), optional
        Residuals used to assess the fit; all by default.
    fitted : bool
        If False, the parameters stay unchanged and the residuals are those before a fit.
    registration : Registration, optional
        Replaces the last parameters, the poses of the scans.

    Raises
    ------
    InputError
        If there is no residual for the fit or its assessment.
    """

    def __init__(
        self,
        problem: Linearised,
        train: BoolArray | None = None,
        judge: BoolArray | None = None,
        fitted: bool = True,
        registration: Registration | None = None,
    ) -> None:
        every = np.ones(problem.size, dtype=bool)
        train = every if train is None else train
        judge = every if judge is None else judge
        for name, rows in (("train", train), ("judge", judge)):
            if rows.shape != (problem.size,) or not rows.any():
                raise InputError(
                    f"{name} must mark some of {problem.size} residuals, found "
                    f"{int(np.sum(rows))} marks in shape {rows.shape}."
                )
        self.problem = problem
        self.judge = judge
        p = len(problem.nominal_sd) if fitted else 0
        self._columns = (problem.nominal * problem.nominal_sd)[:, :p]
        self.gain: FloatArray = np.zeros((p, problem.size))
        self.bias: FloatArray = np.zeros(p)
        if p:
            self._fit_to(train)
        self._registered = 0 if registration is None else len(registration.gain)
        if registration is not None:
            self.gain[p - self._registered :] = registration.gain
            self.bias[p - self._registered :] = registration.shift

    def _fit_to(self, train: BoolArray) -> None:
        """Fit a subset of residuals; the step is ``-(gain r + bias)``, in prior sd."""
        problem = self.problem
        L = problem.covariance_factor
        if not train.all():
            L = factored(problem.covariance[np.ix_(train, train)])
        part = Linearised(
            problem.residual[train],
            problem.nominal[train],
            problem.nominal_sd,
            problem.nominal_offset,
            L,
        )
        A = part.scaled_nominal
        H = np.eye(A.shape[1]) + A.T @ A
        weighted = solve_triangular(L, A, lower=True, trans="T", check_finite=False)
        self.gain[:, train] = np.linalg.solve(H, weighted.T)
        self.bias = np.asarray(np.linalg.solve(H, part.scaled_offset), dtype=np.float64)

    @property
    def step(self) -> FloatArray:
        """Change in the parameters due to the fit, shape (p,), in prior standard deviations."""
        return -(self.gain @ self.problem.residual + self.bias)

    @cached_property
    def residual(self) -> FloatArray:
        """Assessed residuals after the step, in mm."""
        return self.after(self.problem.residual[:, None])[:, 0]

    def after(self, residuals: FloatArray) -> FloatArray:
        """Return other residuals, shape (m, n), after the fit; shape (assessed, n)."""
        steps = self.gain @ residuals + self.bias[:, None]
        return np.asarray(residuals[self.judge] - self._columns[self.judge] @ steps)

    @cached_property
    def observation_mm2(self) -> FloatArray:
        """Observation variance of each assessed residual, after any registration."""
        N = self.poses[self.judge]
        own = (self.problem.covariance_factor**2).sum(axis=1)[self.judge] + (N**2).sum(axis=1)
        taken = 2.0 * self._shared_poses[self.judge] - N @ (self._pose_gain @ self._shared_poses)
        return np.asarray(own - (N * taken).sum(axis=1))

    @cached_property
    def noise_mm2(self) -> FloatArray:
        """Expected square of each residual minus the squared gap there."""
        fitted = slice(self._columns.shape[1] - self._registered)
        J, N = self._columns[self.judge, fitted], self.poses[self.judge]
        shared = self._shared[self.judge, fitted] - N @ (self.gain[fitted] @ self._shared_poses).T
        return self.observation_mm2 - 2.0 * (J * shared).sum(axis=1)

    @property
    def excess_mm2(self) -> float:
        """G^2 over all assessed residuals, before clipping at zero."""
        return float((self.residual**2).mean() - self.noise_mm2.mean())

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance D of the assessed residuals."""
        return self.covariance_of(self.judge)

    def covariance_of(self, rows: BoolArray) -> FloatArray:
        """Return the covariance D of the residuals in `rows`, shape (m,), assessed or not."""
        X = self._columns[rows]
        # C - X S' - S X' + X T X' with a symmetric T, computing both halves at once.
        half = self._shared[rows] - 0.5 * X @ (self.gain @ self._shared)
        left, right = [X, half], [half, X]
        if self._registered:
            left.append(-self.poses[rows])
            right.append(self.poses[rows])
        C = self.problem.covariance if rows.all() else self.problem.covariance[np.ix_(rows, rows)]
        return np.asarray(C - np.hstack(left) @ np.hstack(right).T)

    @cached_property
    def floor_mm(self) -> float:
        """Gap due to fitted noise, present even if the model is true: ``tr(F C F')``."""
        X = self._columns[self.judge]
        return float(np.sqrt(((X @ (self.gain @ self._shared)) * X).sum(axis=1).mean()))

    @cached_property
    def _shared(self) -> FloatArray:
        """``C gain'``, shape (m, p)."""
        L, N = self.problem.covariance_factor, self.poses
        return np.asarray(L @ (L.T @ self.gain.T) + N @ (N.T @ self.gain.T))

    @property
    def poses(self) -> FloatArray:
        """Columns of the registered poses, shape (m, q), which also contribute to C."""
        return self._columns[:, self._columns.shape[1] - self._registered :]

    @property
    def _pose_gain(self) -> FloatArray:
        return self.gain[len(self.gain) - self._registered :]

    @property
    def _shared_poses(self) -> FloatArray:
        return self._shared[:, self._shared.shape[1] - self._registered :]
