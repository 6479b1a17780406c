r"""What given scans could show, and what another scan would add.

Nothing here looks at a residual. A further state, another load or view, brings more rows
to all columns and its noise, part of which it shares with the present states: they all
start from one reference scan.

Two effects are told apart by the evidence. If k acts at its prior scale, it beats j on
average by the Kullback-Leibler divergence of their predictions

.. math:: \tfrac12 [ \mathrm{tr}(\Sigma_j^{-1} \Sigma_k) - m + \ln|\Sigma_j| - \ln|\Sigma_k| ],
          \qquad \Sigma_k = P^{-1} + B_k S_k B_k',

in nats (the discrimination criterion of G. E. P. Box and W. J. Hill, Technometrics 9
(1967) 57). Bounds of one-sided parameters are left out.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from storage.errors import InputError
from storage.values import BoolArray, FloatArray
from workers.diagnosis.detectability import absorbed_share, confusion, minimum_detectable
from workers.diagnosis.fingerprint import Fingerprint
from workers.diagnosis.linear import Linearised, factored

Design = tuple[Linearised, tuple[Fingerprint, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class Detectability:
    """What the scans could show of one effect.

    Parameters
    ----------
    name : str
    minimum : ndarray, shape (q,)
        Magnitude of each parameter found with 80 % power at 1 % false alarms.
    absorbed : float
        Share that hides in the nominal parameters; median over the places.
    nearest : str or None
        The effect whose visible part looks most alike.
    cosine : float
        How alike, 0 to 1.
    """

    name: str
    minimum: FloatArray
    absorbed: float
    nearest: str | None
    cosine: float


@dataclass(frozen=True, slots=True, eq=False)
class NewStates:
    """States that are not scanned yet.

    Parameters
    ----------
    nominal : ndarray, shape (k, p)
        Derivatives of their residuals by the nominal parameters.
    columns : mapping of str to ndarray, shape (k, q) or (g, k, q)
        By the parameters of each effect.
    covariance : ndarray, shape (k, k)
        Of their noise, in mm^2.
    shared : ndarray, shape (k, m)
        Covariance with the noise of the present residuals.
    """

    nominal: FloatArray
    columns: Mapping[str, FloatArray]
    covariance: FloatArray
    shared: FloatArray


def detectability(
    problem: Linearised, fingerprints: Sequence[Fingerprint]
) -> tuple[Detectability, ...]:
    """A row for each effect, in the order given."""
    cosines = confusion(problem, fingerprints) - np.eye(len(fingerprints))
    rows = []
    for fingerprint, cosine in zip(fingerprints, cosines, strict=True):
        shares = [absorbed_share(problem, B) for B in fingerprint.whitened(problem)]
        near = int(cosine.argmax())
        rows.append(
            Detectability(
                fingerprint.name,
                minimum_detectable(problem, fingerprint),
                float(np.median(shares)),
                fingerprints[near].name if cosine[near] > 0 else None,
                float(cosine[near]),
            )
        )
    return tuple(rows)


def separation(problem: Linearised, fingerprints: Sequence[Fingerprint]) -> FloatArray:
    """Log evidence by which an effect that acts beats another one, on average.

    Returns
    -------
    ndarray, shape (effects, effects)
        ``[k, j]`` for k acting, in nats; the median over the places of k, against the best
        place of j.
    """
    columns = [fingerprint.whitened(problem) for fingerprint in fingerprints]
    projected = [np.array([problem.project(B) for B in places]) for places in columns]
    found = np.zeros((len(columns), len(columns)))
    for k, acting in enumerate(columns):
        for j, other in enumerate(columns):
            if k != j:
                table = [
                    [
                        _divergence(b.T @ Pb, b.T @ Pc, c.T @ Pc)
                        for c, Pc in zip(other, projected[j], strict=True)
                    ]
                    for b, Pb in zip(acting, projected[k], strict=True)
                ]
                found[k, j] = np.median(np.min(table, axis=1))
    return found


def of_states(problem: Linearised, fingerprints: Sequence[Fingerprint], rows: BoolArray) -> Design:
    """The problem with some of its residuals, those of a load or a view.

    Raises
    ------
    InputError
        If no residual is left.
    """
    if rows.shape != (problem.size,) or not rows.any():
        raise InputError(
            f"Choose some of {problem.size} residuals, found {int(rows.sum())} in shape "
            f"{rows.shape}."
        )
    smaller = Linearised(
        problem.residual[rows],
        problem.nominal[rows],
        problem.nominal_sd,
        problem.nominal_offset,
        factored(problem.covariance[np.ix_(rows, rows)]),
    )
    return smaller, tuple(replace(f, columns=f.columns[..., rows, :]) for f in fingerprints)


def extended(problem: Linearised, fingerprints: Sequence[Fingerprint], new: NewStates) -> Design:
    """The problem with states that are not scanned yet; their residuals are zero.

    Raises
    ------
    InputError
        If an effect has no columns for the new states, shapes disagree, or the noise of all
        states together is not positive definite.
    """
    missing = [f.name for f in fingerprints if f.name not in new.columns]
    k, m = len(new.covariance), problem.size
    if missing or new.shared.shape != (k, m):
        raise InputError(
            f"New states need columns of every effect and shared noise ({k}, {m}); found "
            f"{new.shared.shape} and no columns of {missing}."
        )
    L = problem.covariance_factor
    below = solve_triangular(L, new.shared.T, lower=True).T
    factor = np.zeros((m + k, m + k))
    factor[:m, :m], factor[m:, :m] = L, below
    factor[m:, m:] = factored(new.covariance - below @ below.T)
    larger = Linearised(
        np.append(problem.residual, np.zeros(k)),
        np.vstack([problem.nominal, new.nominal]),
        problem.nominal_sd,
        problem.nominal_offset,
        factor,
    )
    grown = tuple(
        replace(f, columns=np.concatenate([f.columns, new.columns[f.name]], axis=-2))
        for f in fingerprints
    )
    return larger, grown


def next_scan(
    problem: Linearised,
    fingerprints: Sequence[Fingerprint],
    confusable: Collection[str],
    options: Mapping[str, NewStates],
) -> dict[str, float]:
    """Which further scan separates effects that cannot be told apart.

    Parameters
    ----------
    problem : Linearised
    fingerprints : sequence of Fingerprint
    confusable : collection of str
        Two or more effects.
    options : mapping of str to NewStates
        Scans that could be made.

    Returns
    -------
    dict of str to float
        For each option the `separation` of the two effects that stay most alike, in nats;
        the best option first.

    Raises
    ------
    InputError
        If fewer than two effects are named, or one is not listed.
    """
    chosen = [f for f in fingerprints if f.name in confusable]
    if len(chosen) < 2 or len(chosen) < len(set(confusable)):
        raise InputError(
            f"Name two or more of the effects {[f.name for f in fingerprints]}, found "
            f"{sorted(confusable)}."
        )
    found = {}
    for name, new in options.items():
        table = separation(*extended(problem, chosen, new))
        found[name] = float(table[~np.eye(len(chosen), dtype=bool)].min())
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _divergence(kk: FloatArray, kj: FloatArray, jj: FloatArray) -> float:
    """From inner products in the metric P of the acting effect k and its rival j."""
    own, rival = np.eye(len(kk)) + kk, np.eye(len(jj)) + jj
    trace = np.trace(kk) - np.trace(kj @ np.linalg.solve(rival, kj.T))
    trace -= np.trace(np.linalg.solve(rival, jj))
    logs = np.linalg.slogdet(rival)[1] - np.linalg.slogdet(own)[1]
    return float(0.5 * (trace + logs))
