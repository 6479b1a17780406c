r"""Linearisation of the model around one fit, with its noise, its effects and one further step.

Near the fit, the signed distances r between model and image obey

.. math:: r(z) = r + J z = \text{systematic part} + e, \qquad e \sim N(0, C),

with z the change in the parameters and a normal prior on each of them. Whitened by ``C = L L'``,
the noise is standard normal; A and rho denote J and r in that space. Integrating z out leaves the
precision

.. math:: P = (I + A S A')^{-1} = I - A (A'A + \Lambda)^{-1} A',
          \qquad S = \Lambda^{-1} = \mathrm{diag}(sd^2),

which almost removes the part that the parameters can absorb. With flat priors, P is the projection
of the efficient score (C. R. Rao, Proc. Camb. Phil. Soc. 44 (1948) 50; J. Neyman's C(alpha), 1959).
An `EffectSensitivity` holds the columns of one effect beside those of the parameters.

One linear step of a fit changes the noise in the residuals. With noise of covariance C and a fit
that changes residuals by ``r -> r + F r``, the noise covariance after the fit is ``(I + F) C (I +
F)'``. The mean square error of the fitted model on a noise-free image is smaller than the mean
square residual by

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
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals, their derivatives and their noise at one fit.

    Parameters
    ----------
    residual : ndarray, shape (m,)
        Signed distances of the model from the observed interfaces at the fit, in mm, with all
        states concatenated.
    nominal : ndarray, shape (m, p)
        Derivatives of the residual with respect to the free parameters, in mm per unit.
    nominal_sd : ndarray, shape (p,)
        Prior standard deviations of the parameters, > 0.
    nominal_offset : ndarray, shape (p,)
        Fitted value minus prior mean of each parameter.
    covariance_factor : ndarray, shape (m, m)
        Lower Cholesky factor of the covariance of the noise, in mm; see `factored`.

    Raises
    ------
    InputError
        If shapes do not match, a number is not finite, or a standard deviation or a diagonal entry
        of the factor is not positive.
    """

    residual: FloatArray
    nominal: FloatArray
    nominal_sd: FloatArray
    nominal_offset: FloatArray
    covariance_factor: FloatArray

    def __post_init__(self) -> None:
        m, p = len(self.residual), len(self.nominal_sd)
        expected = {
            "residual": (m,),
            "nominal": (m, p),
            "nominal_sd": (p,),
            "nominal_offset": (p,),
            "covariance_factor": (m, m),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(
                    f"{name} must be finite numbers of shape {shape}, found shape {array.shape}"
                    f" with {int((~np.isfinite(array)).sum())} non-finite numbers."
                )
        if not (self.nominal_sd > 0).all():
            raise InputError(f"nominal_sd must be > 0, found {self.nominal_sd.tolist()}.")
        if not (np.diag(self.covariance_factor) > 0).all():
            raise InputError(
                "covariance_factor must be a lower Cholesky factor with a positive diagonal. "
                "Make it with palpate.workers.diagnosis.linearisation.factored."
            )

    @property
    def size(self) -> int:
        """The number of residuals, m."""
        return len(self.residual)

    @cached_property
    def whitened_residual(self) -> FloatArray:
        """Whitened residual rho, shape (m,)."""
        return self.whiten(self.residual)

    @cached_property
    def scaled_nominal(self) -> FloatArray:
        """A times the prior standard deviations, shape (m, p): derivatives per prior sd."""
        return self.whiten(self.nominal) * self.nominal_sd

    @cached_property
    def scaled_offset(self) -> FloatArray:
        """Distance of the fit from the prior mean in prior standard deviations, shape (p,)."""
        return self.nominal_offset / self.nominal_sd

    @cached_property
    def efficient_residual(self) -> FloatArray:
        """Part of the whitened residual that the parameters cannot absorb, shape (m,).

        It is ``P (rho - A offset)``, or rho itself if the fit has converged.
        """
        return self.project(self.whitened_residual - self.scaled_nominal @ self.scaled_offset)

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the noise, shape (m, m), in mm^2."""
        return self.covariance_factor @ self.covariance_factor.T

    def whiten(self, values: FloatArray) -> FloatArray:
        """Solve ``L x = values``, shape (m,) or (m, k)."""
        return np.asarray(
            solve_triangular(self.covariance_factor, values, lower=True, check_finite=False)
        )

    def project(self, whitened: FloatArray) -> FloatArray:
        """Return P times whitened values, shape (m,) or (m, k)."""
        A = self.scaled_nominal
        return whitened - A @ cho_solve(self._curvature, A.T @ whitened)

    def freed(self, columns: FloatArray, sd: FloatArray) -> "Linearised":
        """Return the fit with additional free parameters, each at its prior mean.

        Parameters
        ----------
        columns : ndarray, shape (m, q)
            Derivatives of the residual with respect to the new parameters.
        sd : ndarray, shape (q,)
        """
        return Linearised(
            self.residual,
            np.hstack([self.nominal, columns]),
            np.append(self.nominal_sd, sd),
            np.append(self.nominal_offset, np.zeros(len(sd))),
            self.covariance_factor,
        )

    def holding(self, which: BoolArray) -> "Linearised":
        """Return the fit with some parameters, a mask of shape (p,), held at their values."""
        free = ~which
        return Linearised(
            self.residual,
            self.nominal[:, free],
            self.nominal_sd[free],
            self.nominal_offset[free],
            self.covariance_factor,
        )

    def of(self, rows: BoolArray, factor: FloatArray | None = None) -> "Linearised":
        """Return the fit's linearisation for some of its residuals, a mask of shape (m,).

        Parameters
        ----------
        rows : ndarray of bool, shape (m,)
        factor : ndarray, optional
            Factor of their covariance, if it is known.
        """
        if factor is None:
            whole = self.covariance_factor
            factor = whole if rows.all() else factored(self.covariance[np.ix_(rows, rows)])
        return Linearised(
            self.residual[rows], self.nominal[rows], self.nominal_sd, self.nominal_offset, factor
        )

    @cached_property
    def _curvature(self) -> tuple[FloatArray, bool]:
        A = self.scaled_nominal
        return cho_factor(np.eye(A.shape[1]) + A.T @ A, lower=True)


def factored(covariance: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor of a covariance, shape (m, m).

    Raises
    ------
    InputError
        If the covariance is not positive definite.
    """
    try:
        return np.asarray(cholesky(covariance, lower=True))
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"The covariance of the noise, shape {covariance.shape}, is not positive definite. "
            "Add noise that is independent at each point (a nugget)."
        ) from error


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
        p = len(problem.nominal_sd)
        self._columns = problem.nominal * problem.nominal_sd
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
        part = self.problem.of(train)
        A, L = part.scaled_nominal, part.covariance_factor
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
