"""The profile of a constant: compensation of its error by the other constants."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.comparison.identifiability import (
    FittedContour,
    fitted_contour,
    stepped,
)
from palpate.workers.organs.cornea.solver.candidate import Candidate

# Gauss-Newton steps of the others at every value, each starting from the previous value.
STEPS = 3
# Directions that move the contour by less than this fraction of the strongest are not changed.
CUTOFF = 1e-5
LARGEST_STEP = 0.5


@dataclass(frozen=True, eq=False)
class Profile:
    """The smallest misfit of a contour with one constant held.

    Parameters
    ----------
    name : str
    factor : ndarray, shape (n,)
        Ratio of the held value to the fitted one.
    misfit_um : ndarray, shape (n,)
        Root mean square along the normal, the other constants refitted; nan where a
        simulation did not converge.
    """

    name: str
    factor: FloatArray
    misfit_um: FloatArray


def profile_of(
    candidate: Candidate,
    fitted: FittedContour,
    name: str,
    logarithms: FloatArray,
    window_mm: tuple[float, float] | None = None,
) -> Profile:
    """Return the misfits with a constant held at given values and the others refitted.

    Parameters
    ----------
    candidate : Candidate
        The fitted candidate; its own contour is the data, so only the constants differ.
    fitted : FittedContour
        Contour of the candidate.
    name : str
        Name of the constant.
    logarithms : ndarray
        Logarithms of the factors, ascending; zero is the fit itself.
    window_mm : tuple of float, optional
        As for `fitted_contour`.
    """
    misfit = np.full(len(logarithms), np.nan)
    for side in (1, -1):
        state: _State | None = _State(dict.fromkeys(fitted.names, 0.0), fitted, 0.0)
        places = [i for i in np.argsort(np.abs(logarithms)) if side * logarithms[i] >= 0]
        for i in places:
            assert state is not None
            state = _refitted(candidate, fitted, name, float(logarithms[i]), state, window_mm)
            if state is None:
                break
            misfit[i] = state.misfit_um
    return Profile(name, np.exp(logarithms), misfit)


class _State(NamedTuple):
    """Logarithms of the factors of all constants, the contour there, and its misfit."""

    at: dict[str, float]
    contour: FittedContour
    misfit_um: float


def _refitted(
    candidate: Candidate,
    fitted: FittedContour,
    name: str,
    held: float,
    state: _State,
    window_mm: tuple[float, float] | None,
) -> _State | None:
    """Hold a constant at a new value and refit the others, starting from their last values."""
    weight = np.sqrt(fitted.length_mm / fitted.length_mm.sum())
    best: _State | None = None
    for _ in range(1 + STEPS):
        start = best or state
        gap = 1e3 * ((start.contour.position_mm - fitted.position_mm) * fitted.normal).sum(axis=1)
        free = [k for k, other in enumerate(fitted.names) if other != name]
        ahead = held - start.at[name]
        wanted = gap + ahead * start.contour.shift_um[:, fitted.names.index(name)]
        columns = weight[:, None] * start.contour.shift_um[:, free]
        step = np.linalg.lstsq(columns, -weight * wanted, rcond=CUTOFF)[0]
        step *= min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-12))
        at = start.at | {name: held}
        for k, ds in zip(free, step, strict=True):
            at[fitted.names[k]] += float(ds)
        contour = fitted_contour(stepped(candidate, at), window_mm)
        if contour is None:
            break
        off = 1e3 * ((contour.position_mm - fitted.position_mm) * fitted.normal).sum(axis=1)
        misfit = float(np.linalg.norm(weight * off))
        if best is not None and misfit >= best.misfit_um:
            break
        best = _State(at, contour, misfit)
    return best
