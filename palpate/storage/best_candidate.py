"""The best candidate of a study, by one rule for every reader of its journal.

Candidates are compared at the study's own resolution; if a study stopped before reaching it, the
finest level reached is used. If the strategy minimises the sum of squares, the candidate with the
smallest sum is best, otherwise the one with the lowest score; ties go to the first. The score is
GSF unless the study defines another objective.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from palpate.storage.journal_records import EvaluationRecord, Status
from palpate.storage.json_digests import to_number

Endings = Mapping[int, EvaluationRecord]
Rank = tuple[float, ...]


def minimised(score: Mapping[str, Any]) -> float:
    """Return the value that a search minimises: the objective, or else GSF."""
    return float(to_number(score.get("objective", score["gsf"])))


def score_of(record: EvaluationRecord) -> float:
    """Return the score that the search minimises, or +inf for a candidate without one."""
    if record.status is not Status.DONE or record.score is None:
        return math.inf
    return minimised(record.score)


def rank_of(record: EvaluationRecord) -> Rank | None:
    """Return the rank of a candidate, lower for better ones; None if it has no score."""
    cost = None if record.fit is None else float(record.fit["cost"])
    return _rank(record.candidate, score_of(record), record.level, cost)


def rank_of_line(line: Mapping[str, Any]) -> Rank | None:
    """Return the rank of an evaluation from an unparsed line of the journal; see `rank_of`."""
    score, fit = line.get("score"), line.get("fit")
    if not score or line.get("status") != Status.DONE:
        return None
    cost = float(to_number(fit["cost"])) if fit else None
    return _rank(int(line["candidate"]), minimised(score), line.get("level"), cost)


def _rank(candidate: int, score: float, level: int | None, cost: float | None) -> Rank | None:
    if score == math.inf:
        return None
    resolution = (0, 0) if level is None else (1, -level)
    by = (1, score) if cost is None else (0, cost)
    return (*resolution, *by, candidate)


def best_of(endings: Endings) -> EvaluationRecord | None:
    """Return the best candidate; None if none has a score."""
    return best_so_far(endings.values()).record


def best_searched(endings: Endings) -> EvaluationRecord | None:
    """Return the best candidate among those not fitted by derivatives."""
    return best_of({c: r for c, r in endings.items() if r.fit is None and r.level is None})


def equally_good(endings: Endings, best: EvaluationRecord, within: float) -> list[EvaluationRecord]:
    """Return the candidates whose score is at most `within` above the best, which is included."""
    limit = score_of(best) + within
    own = (endings[c] for c in sorted(endings) if endings[c].level == best.level)
    return [record for record in own if score_of(record) <= limit]


class BestSoFar:
    """The best of the candidates that have ended so far, in any order.

    Attributes
    ----------
    record : EvaluationRecord or None
        The best one; None until one has a score.
    """

    def __init__(self) -> None:
        self.record: EvaluationRecord | None = None
        self._rank: Rank | None = None
        self._lowest: dict[int | None, EvaluationRecord] = {}

    def add(self, record: EvaluationRecord) -> None:
        """Add a candidate."""
        self._add(rank_of(record), score_of(record), record.level, lambda: record)

    def add_line(self, line: Mapping[str, Any]) -> None:
        """Add a candidate given as an unparsed line of the journal.

        Raises
        ------
        JournalError
            If it is the best so far and its line is damaged.
        """
        rank = rank_of_line(line)
        if rank is not None:
            made = partial(EvaluationRecord.from_json, line)
            self._add(rank, minimised(line["score"]), line.get("level"), made)

    def _add(
        self,
        rank: Rank | None,
        score: float,
        level: int | None,
        record: Callable[[], EvaluationRecord],
    ) -> None:
        if rank is None:
            return
        if self._rank is None or rank < self._rank:
            self.record, self._rank = record(), rank
        lowest = self._lowest.get(level)
        if lowest is None or (score, rank[-1]) < (score_of(lowest), lowest.candidate):
            self._lowest[level] = record()

    @property
    def lowest_score(self) -> EvaluationRecord | None:
        """Return the candidate with the lowest score if it is not the best one, else None."""
        if self.record is None:
            return None
        lowest = self._lowest[self.record.level]
        return lowest if score_of(lowest) < score_of(self.record) else None

    @property
    def note(self) -> str:
        """Return the reason why the best candidate does not have the lowest score; else empty."""
        best, lowest = self.record, self.lowest_score
        if best is None or lowest is None or best.fit is None:
            return ""
        other = (
            f"a larger sum ({lowest.fit['cost']:.6g})"
            if lowest.fit is not None
            else "no sum of squares, since it was evaluated without derivatives"
        )
        name = "score" if "objective" in (best.score or {}) else "GSF"
        return (
            f"Candidate {best.candidate} is best because this strategy minimises the sum of "
            f"squared distances ({best.fit['cost']:.6g}; {name} {score_of(best):.5g}); candidate "
            f"{lowest.candidate} has the lowest {name} ({score_of(lowest):.5g}) but {other}."
        )


def best_so_far(endings: Iterable[EvaluationRecord]) -> BestSoFar:
    """Find the best of these candidates, and the one with the lowest score."""
    best = BestSoFar()
    for record in endings:
        best.add(record)
    return best
