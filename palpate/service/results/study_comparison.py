"""Comparison of several studies: constants, scores, differing settings, convergence."""

import csv
import io
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

from palpate.service.results.result_records import ParameterEstimate, StudyResults
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.study_folder import read_study
from palpate.service.study.study_keys import ABSENT, differing_settings
from palpate.storage.best_candidate import score_of
from palpate.storage.errors import InputError
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.json_digests import to_plain
from palpate.storage.read_only import ReadOnly

# Keys from the record that `palpate report --json` prints.
SHARED_KEYS = (
    "study", "folder", "state", "stopped", "caveats", "identifiable", "ratios", "estimates",
    "score", "evaluations", "seconds",
)  # fmt: skip
SCORES = ("jc", "mhd_mm", "gsf")
TABLE = (
    "study", "quantity", "unit", "value", "lower", "upper", "target", "quotable", "reasons",
)  # fmt: skip
# Differences in the name are shown elsewhere.
UNTOLD = frozenset({"name"})
GSF_AXIS = "GSF"
# A section of the file that some studies leave out and others set to null.
EMPTY = frozenset({str(None), ABSENT})


@dataclass(frozen=True)
class ComparedStudy(ReadOnly):
    """One study of a comparison.

    Parameters
    ----------
    label : str
        Its name, or its folder if several studies have the same name.
    results : StudyResults
    lowest_scores : tuple of float
        The lowest score after 1, 2, 3 ... evaluations; +inf before the first score.
    """

    label: str
    results: StudyResults
    lowest_scores: tuple[float, ...]

    def __repr__(self) -> str:
        return f"<Compared study {self.label}: {self.results!r}"[:498] + ">"


@dataclass(frozen=True)
class StudyComparison(ReadOnly):
    """A comparison of several studies.

    Parameters
    ----------
    studies : tuple of ComparedStudy
        In the given order.
    settings : mapping of str to tuple
        Differing keys of the study file, each with its value in every study, or ``absent``.
    axis : str
        The score in `lowest_scores`: the one that all studies minimise, or else GSF.
    """

    studies: tuple[ComparedStudy, ...]
    settings: Mapping[str, tuple[Any, ...]]
    axis: str

    @property
    def genes(self) -> tuple[str, ...]:
        """Return the constants searched by any of the studies, by their names in the file."""
        return tuple(
            dict.fromkeys(e.gene for s in self.studies for e in s.results.estimates.values())
        )

    def estimate(self, study: ComparedStudy, gene: str) -> ParameterEstimate | None:
        """Return a study's estimate of a constant; None if it was not searched."""
        return next((e for e in study.results.estimates.values() if e.gene == gene), None)

    def as_dict(self) -> dict[str, Any]:
        """Return the record printed by `palpate compare --json`."""
        studies = []
        for study in self.studies:
            whole = study_json(study.results)
            own = {key: whole[key] for key in SHARED_KEYS}
            studies.append({"label": study.label} | own | {"lowest_scores": study.lowest_scores})
        return dict(
            to_plain({"studies": studies, "settings": self.settings, "minimised": self.axis})
        )

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield a row for each constant and score of each study, with the keys in `TABLE`."""
        for study in self.studies:
            for e in study.results.estimates.values():
                lower, upper = e.interval or (None, None)
                yield _row(
                    study.label, e.gene, e.unit, e.estimate, lower, upper, e.target, e.quotable,
                    "; ".join(e.reasons),
                )  # fmt: skip
            for name, value in (study.results.best_score or {}).items():
                if name in SCORES:
                    unit = "mm" if name.endswith("_mm") else ""
                    yield _row(study.label, name, unit, value, None, None, None, None, "")

    def as_csv(self) -> str:
        """Return `rows` as CSV with a header; unknown values are empty."""
        text = io.StringIO()
        writer = csv.DictWriter(text, TABLE, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows())
        return text.getvalue()


def compare_studies(folders: Sequence[Path]) -> StudyComparison:
    """Read several studies, which may be running, and compare them.

    Raises
    ------
    InputError
        If there are fewer than two studies, one is repeated, or a folder has no study.
    JournalError
        If a journal is damaged.
    """
    if len(folders) < 2:
        raise InputError(f"A comparison needs at least two studies, got {len(folders)}.")
    resolved = [folder.resolve() for folder in folders]
    twice = [str(f) for f, times in Counter(resolved).items() if times > 1]
    if twice:
        raise InputError(f"{twice[0]} is given twice: compare different studies.")
    all_results = [study_results(folder) for folder in folders]
    names = Counter(results.name for results in all_results)
    labels = [
        results.name if names[results.name] == 1 else str(folder)
        for results, folder in zip(all_results, folders, strict=True)
    ]
    objectives = {results.spec.objective.name for results in all_results}
    same = len(objectives) == 1
    studies = tuple(
        ComparedStudy(label, results, _lowest(folder, same))
        for label, results, folder in zip(labels, all_results, folders, strict=True)
    )
    settings = differing_settings([results.spec.as_dict() for results in all_results])
    differing = {
        key: values
        for key, values in settings.items()
        if key not in UNTOLD and not set(map(str, values)) <= EMPTY
    }
    return StudyComparison(
        studies, differing, all_results[0].spec.objective.axis if same else GSF_AXIS
    )


def _row(*values: object) -> dict[str, Any]:
    return dict(zip(TABLE, values, strict=True))


def _lowest(folder: Path, minimised: bool) -> tuple[float, ...]:
    _, log = read_study(folder)
    score = score_of if minimised else _gsf
    return tuple(accumulate((score(r) for _, r in sorted(log.endings.items())), min))


def _gsf(record: EvaluationRecord) -> float:
    return math.inf if record.score is None else float(record.score["gsf"])
