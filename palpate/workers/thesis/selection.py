"""The argument of thesis section 3.3.2 for its choice of coefficients."""

from dataclasses import dataclass
from itertools import pairwise

from palpate.workers.comparison.coefficients.coefficients import HAUSDORFF_NAMES, NAMES
from palpate.workers.thesis.bar import GROUPS, BarExperiment

WORST = GROUPS[2]  # the deformations that "must be considered the least similar"
RIGHT_HALF = (*GROUPS[0], *GROUPS[1])
OVERLAPS, SIGNED = ("JC", "DC"), ("dV", "SM")


@dataclass(frozen=True)
class Selection:
    """Behaviour of each coefficient over the eight deformations.

    Parameters
    ----------
    curves : dict of str to tuple of float
        The 28 coefficients over the deformations that converged, each divided by its
        largest magnitude (thesis Fig. 3.5).
    numbers : tuple of int
        The deformations that converged.
    kept, rejected : tuple of str
        Hausdorff variants under which each of deformations 5 to 7 is worse than each of 1
        to 4, and the remaining variants.
    monotone : dict of str to bool
        True if a coefficient, including GSF, worsens from each of `GROUPS` to the next. Volume
        difference and signed mean worsen as their magnitude grows, JC and DC as they fall.
    """

    curves: dict[str, tuple[float, ...]]
    numbers: tuple[int, ...]
    kept: tuple[str, ...]
    rejected: tuple[str, ...]
    monotone: dict[str, bool]


def select(experiment: BarExperiment) -> Selection:
    """Apply the thesis' argument to the rows that converged."""
    rows = [(row.number, row.coefficients) for row in experiment.rows if row.coefficients]
    values = {name: {n: c.by_name[name] for n, c in rows} for name in NAMES}
    values["GSF"] = {n: c.gsf for n, c in rows}
    misfit = {name: _misfit(name, each) for name, each in values.items()}
    kept = tuple(n for n in HAUSDORFF_NAMES if _worse(misfit[n], RIGHT_HALF, WORST))
    return Selection(
        curves={name: _normalised(list(values[name].values())) for name in NAMES},
        numbers=tuple(n for n, _ in rows),
        kept=kept,
        rejected=tuple(n for n in HAUSDORFF_NAMES if n not in kept),
        monotone={name: monotone_in_groups(each) for name, each in misfit.items()},
    )


def _misfit(name: str, values: dict[int, float]) -> dict[int, float]:
    """Return the values with signs chosen so that larger is worse."""
    if name in OVERLAPS:
        return {n: -v for n, v in values.items()}
    if name in SIGNED:
        return {n: abs(v) for n, v in values.items()}
    return values


def monotone_in_groups(misfit: dict[int, float]) -> bool:
    """Return True if all misfits of each group exceed all misfits of the previous group."""
    return all(_worse(misfit, better, worse) for better, worse in pairwise(GROUPS))


def _worse(misfit: dict[int, float], better: tuple[int, ...], worse: tuple[int, ...]) -> bool:
    low = [misfit[n] for n in better if n in misfit]
    high = [misfit[n] for n in worse if n in misfit]
    return not low or not high or max(low) < min(high)


def _normalised(values: list[float]) -> tuple[float, ...]:
    largest = max((abs(v) for v in values), default=0.0)
    return tuple(v / largest if largest else 0.0 for v in values)
