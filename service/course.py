"""The course of a search so far: a fold over the endings in a journal.

Candidates are numbered through all generations, elites included: candidate ``c``
is number ``c - first`` of its generation. Elites keep the ending they got when
they were evaluated, so they have none of their own; `Step.carried_from` leads
back to it.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from service.search.base import Generation, Proposal, Search, Stopped
from storage.errors import JournalError
from storage.records import EvaluationRecord
from storage.status import Status


@dataclass(frozen=True, eq=False)
class Step:
    """A population on its way to become a generation.

    Parameters
    ----------
    number : int
        Of the generation, from 0.
    first : int
        Number of its first candidate.
    names : tuple of str
        Of the genes.
    proposal : Proposal
        Its candidates.
    """

    number: int
    first: int
    names: tuple[str, ...]
    proposal: Proposal

    @property
    def candidates(self) -> tuple[int, ...]:
        """Numbers of those that need an evaluation, in order."""
        return tuple(self.first + index for index in self.proposal.to_evaluate)

    def genes(self, candidate: int) -> dict[str, float]:
        """Genes by name, exactly as proposed."""
        row = self.proposal.genes[candidate - self.first]
        return {name: float(gene) for name, gene in zip(self.names, row, strict=True)}

    def carried_from(self, candidate: int) -> int | None:
        """Number of the same candidate in the generation before; None if it is new."""
        origin = self.proposal.carried[candidate - self.first]
        return None if origin is None else self.first - len(self.proposal.genes) + origin

    def check(self, record: EvaluationRecord) -> None:
        """Refuse a record that belongs to another search.

        Raises
        ------
        JournalError
            If its genes are not those that this search proposes.
        """
        expected = self.genes(record.candidate)
        if dict(record.genes) != expected:
            raise JournalError(
                f"Candidate {record.candidate} has the genes {dict(record.genes)} in the journal, "
                f"but this search proposes {expected}. The journal was written by another study "
                "or another version of the search: start a new study; evaluations in the store "
                "are used again."
            )


class Course:
    """Generations one after the other, each proposed from those before.

    Parameters
    ----------
    search : Search
        Proposes.
    names : tuple of str
        Of the genes.
    """

    def __init__(self, search: Search, names: tuple[str, ...]) -> None:
        self._search = search
        self._names = names
        self._first = 0
        self.history: list[Generation] = []

    def next(self) -> Step | Stopped:
        """The population that follows."""
        proposed = self._search.propose(self.history)
        if isinstance(proposed, Stopped):
            return proposed
        return Step(len(self.history), self._first, self._names, proposed)

    def close(self, step: Step, endings: Mapping[int, EvaluationRecord]) -> Generation:
        """Make `step` a generation; `endings` by candidate holds at least all of its own."""
        scores = {c - step.first: score_of(endings[c]) for c in step.candidates}
        generation = step.proposal.complete(scores, self.history)
        self.history.append(generation)
        self._first += len(generation.scores)
        return generation


def replay(
    course: Course, endings: Mapping[int, EvaluationRecord]
) -> Iterator[tuple[Step, Generation | None]]:
    """Go through what the journal holds; the last generation may be unfinished (None).

    Raises
    ------
    JournalError
        If an ending does not belong to this search.
    """
    while isinstance(step := course.next(), Step):
        told = [endings[c] for c in step.candidates if c in endings]
        for record in told:
            step.check(record)
        if len(told) < len(step.candidates):
            yield step, None
            return
        yield step, course.close(step, endings)


def score_of(record: EvaluationRecord) -> float:
    """What the search is told: GSF, or +inf for a candidate without one."""
    if record.status is not Status.DONE or record.score is None:
        return math.inf
    return float(record.score["gsf"])
