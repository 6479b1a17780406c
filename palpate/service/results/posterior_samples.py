"""Draws of the constants from the posterior behind a study's intervals."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from palpate.service.installed_packages import frame_type, xarray
from palpate.service.number_formatting import number
from palpate.service.results.result_records import ParameterEstimate, StudyResults
from palpate.service.search.search_interface import FloatArray
from palpate.storage.errors import InputError
from palpate.storage.read_only import read_only
from palpate.workers.mechanics.model_parameters import unknown_name

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


class Samples(Mapping[str, FloatArray]):
    """Draws of the constants of a study: read-only arrays of equal length by name.

    Parameters
    ----------
    draws : mapping of str to ndarray, shape (n,)
        By the constant's name in the study file, such as ``E_fat_kpa``.
    units : mapping of str to str
        Of the constants; empty for a pure number.
    study : str
        Name of the study.
    seed : int
    """

    def __init__(
        self, draws: Mapping[str, FloatArray], units: Mapping[str, str], study: str, seed: int
    ) -> None:
        self._draws = read_only({name: values.copy() for name, values in draws.items()})
        self.units = read_only(dict(units))
        self.study, self.seed = study, seed

    def __getitem__(self, name: str) -> FloatArray:
        return self._draws[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._draws)

    def __len__(self) -> int:
        return len(self._draws)

    @property
    def n(self) -> int:
        """Return the number of draws."""
        return len(next(iter(self._draws.values())))

    def __repr__(self) -> str:
        shown = [f"{name} {number(float(v.mean()), 3)}" for name, v in self._draws.items()]
        more = ", ..." if len(shown) > 8 else ""
        return f"<{self.n} samples of {self.study}: means {', '.join(shown[:8])}{more}>"

    def to_frame(self) -> "DataFrame":
        """Return the draws as a pandas table with a column for each constant.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        return frame_type()(self._draws)

    def to_xarray(self) -> "Dataset":
        """Return the draws in ArviZ's format for a posterior: ``chain`` (1) and ``draw``.

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        variables = {
            name: (("chain", "draw"), values[None, :].copy(), {"units": self.units[name]})
            for name, values in self._draws.items()
        }
        places = {"chain": [0], "draw": range(self.n)}
        about: dict[str, Any] = {
            "study": self.study,
            "seed": self.seed,
            "inference_library": "palpate",
        }
        made: Dataset = xarray().Dataset(variables, places, about)
        return made


def draw_samples(
    results: StudyResults, n: int = 1000, seed: int = 0, constants: Sequence[str] | None = None
) -> Samples:
    """Draw the constants of a study from the posterior behind its intervals.

    Parameters
    ----------
    results : StudyResults
    n : int
        Number of draws, > 0.
    seed : int
        The same seed gives the same draws.
    constants : sequence of str, optional
        Names with or without unit, ``E_fat`` or ``E_fat_kpa``; default: all searched ones.

    Raises
    ------
    InputError
        If a constant is unknown or has no interval, with the reason.
    """
    if n < 1:
        raise InputError(f"n = {n}: expected at least 1 draw.")
    names = _names(results, constants)
    for name in names:
        if results.estimates[name].interval is None:
            raise InputError(_refusal(results, name))
    posterior, known = results.posterior, results.identification
    if posterior is None:
        note = f": {known.note}" if known is not None and known.note else ""
        raise InputError(
            f"{results.name} has no posterior to draw from{note}. Its intervals come from the "
            "scatter of equally good candidates; `results.to_frame()` has all candidates."
        )
    drawn = dict(zip(names, posterior.draw(names, n, seed), strict=True))
    estimates = {name: results.estimates[name] for name in names}
    return Samples(
        {e.gene: drawn[name] for name, e in estimates.items()},
        {e.gene: e.unit for e in estimates.values()},
        results.name,
        seed,
    )


def constants_with_samples(results: StudyResults) -> list[str]:
    """Return the constants with a known posterior, by internal name."""
    if results.posterior is None:
        return []
    return [name for name, e in results.estimates.items() if e.interval is not None]


def _names(results: StudyResults, constants: Sequence[str] | None) -> list[str]:
    by_gene = {e.gene: name for name, e in results.estimates.items()}
    if constants is None:
        return list(results.estimates)
    for name in constants:
        if name not in by_gene and name not in results.estimates:
            raise InputError(f"{unknown_name('constant', name, by_gene)}.")
    return [by_gene.get(name, name) for name in constants]


def _refusal(results: StudyResults, name: str) -> str:
    estimate: ParameterEstimate = results.estimates[name]
    why = "; ".join(estimate.reasons) or "no interval is known"
    others = [results.estimates[n].gene for n in constants_with_samples(results)]
    instead = f" Constants with an interval: `samples(constants={others})`." if others else ""
    return f"{estimate.gene} has no interval to draw from: {why}.{instead}"
