"""The generations of a study, read from its journal alone.

Reading never runs the search, so a study stays readable if the search, or a library that it
uses, has changed. Journals of earlier versions do not record proposals; their generations are
reconstructed from the endings, without the candidates that were carried over.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from palpate.service.search.strategies import LEAST_SQUARES
from palpate.service.study.log import StudyLog
from palpate.service.study.spec import StudySpec
from palpate.storage.records.best_candidate import score_of
from palpate.storage.records.record import EvaluationRecord, ProposalRecord


@dataclass(frozen=True)
class RecordedGeneration:
    """One generation, as recorded in the journal.

    Parameters
    ----------
    number : int
        From 0.
    genes : mapping of int to mapping of str to float
        By candidate.
    carried : mapping of int to int
        Each carried candidate with its number in the previous generation.
    evaluations : int
        Number of candidates that need an evaluation.
    """

    number: int
    genes: Mapping[int, Mapping[str, float]]
    carried: Mapping[int, int]
    evaluations: int

    def ended(self, endings: Mapping[int, EvaluationRecord]) -> int:
        """Return the number of its evaluations that have ended."""
        return sum(c in endings for c in self.genes if c not in self.carried)


class RecordedGenerations:
    """All generations of a study that has started.

    Parameters
    ----------
    spec : StudySpec
    log : StudyLog
    """

    def __init__(self, spec: StudySpec, log: StudyLog) -> None:
        self.endings = log.endings
        if log.proposals:
            found = [_proposed(log.proposals[number]) for number in sorted(log.proposals)]
        else:
            found = list(_from_endings(spec, log))
        self.generations = tuple(found)

    def generation_of(self, candidate: int) -> RecordedGeneration | None:
        """Return the generation of a candidate; None if no record names it."""
        return next((g for g in self.generations if candidate in g.genes), None)

    def evaluated_as(self, candidate: int) -> int:
        """Return the number under which a candidate was evaluated."""
        generation = self.generation_of(candidate)
        while generation is not None and candidate in generation.carried:
            candidate = generation.carried[candidate]
            generation = self.generation_of(candidate)
        return candidate

    def scores(self, generation: RecordedGeneration) -> dict[int, float] | None:
        """Return the scores of a generation by candidate; None until all are known."""
        sources = {c: self.evaluated_as(c) for c in generation.genes}
        known = all(source in self.endings for source in sources.values())
        if not known or generation.ended(self.endings) < generation.evaluations:
            return None
        return {c: score_of(self.endings[source]) for c, source in sources.items()}

    @property
    def candidates(self) -> int:
        """Return the number of candidates."""
        return sum(len(generation.genes) for generation in self.generations)


def _proposed(record: ProposalRecord) -> RecordedGeneration:
    genes = {
        record.first + index: dict(zip(record.names, row, strict=True))
        for index, row in enumerate(record.genes)
    }
    carried = {int(candidate): origin for candidate, origin in record.carried.items()}
    return RecordedGeneration(record.number, genes, carried, len(genes) - len(carried))


def _from_endings(spec: StudySpec, log: StudyLog) -> Iterator[RecordedGeneration]:
    numbers = sorted({record.generation for record in log.endings.values()})
    if not numbers and log.end is None:
        yield RecordedGeneration(0, {}, {}, _usual_size(spec, 0))
    for number in numbers:
        here = [log.endings[c] for c in sorted(log.endings) if log.endings[c].generation == number]
        genes = {record.candidate: dict(record.genes) for record in here}
        complete = log.end is not None or number < numbers[-1]
        wanted = len(here) if complete else max(len(here), _usual_size(spec, number))
        yield RecordedGeneration(number, genes, {}, wanted)


def _usual_size(spec: StudySpec, number: int) -> int:
    """Return the usual number of evaluations in a generation."""
    if spec.search.strategy == LEAST_SQUARES.name:
        return spec.search.starts
    if spec.search.steady:
        left = spec.most_evaluations - number * spec.search.population
        return max(0, min(spec.search.population, left))
    return spec.search.population - (spec.search.elite if number else 0)


def best_in(scores: Mapping[int, float]) -> int:
    """Return the candidate with the lowest score, the first in a tie."""
    return min(sorted(scores), key=lambda candidate: scores[candidate])


def finite(scores: Mapping[int, float]) -> list[float]:
    """Return the finite scores, in the order of the candidates."""
    return [scores[candidate] for candidate in sorted(scores) if math.isfinite(scores[candidate])]
