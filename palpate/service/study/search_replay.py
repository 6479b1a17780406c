"""Replay of a search from the endings in a journal, with and without generations.

Candidates are numbered across all generations, including elites: candidate ``c`` has index
``c - first`` in its generation. Elites have no ending of their own;
`PendingGeneration.carried_from` leads to the evaluated candidate.

A steady search is replayed in the order of the endings in its journal. Its candidates are counted
in blocks of a population, so that results and pages can refer to generations; there is no barrier
at the end of a block.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from palpate.service.search.genetic_search import Pool, SteadyGenetic
from palpate.service.search.search_interface import (
    FloatArray,
    Generation,
    Proposal,
    Search,
    Space,
    Stopped,
)
from palpate.storage.best_candidate import score_of
from palpate.storage.errors import JournalError
from palpate.storage.journal_records import EvaluationRecord, ProposalRecord


@dataclass(frozen=True, eq=False)
class PendingGeneration:
    """A proposed population whose scores are not all known yet.

    Parameters
    ----------
    number : int
        Number of the generation, from 0.
    first : int
        Number of its first candidate.
    space : Space
        The searched box, with the names of the genes.
    proposal : Proposal
        Its candidates.
    """

    number: int
    first: int
    space: Space
    proposal: Proposal

    @property
    def candidates(self) -> tuple[int, ...]:
        """Return the numbers of the candidates that need an evaluation, in order."""
        return tuple(self.first + index for index in self.proposal.to_evaluate)

    def genes(self, candidate: int) -> dict[str, float]:
        """Return the genes of a candidate by name, exactly as proposed."""
        return self.space.as_dict(self.proposal.genes[candidate - self.first])

    def carried_from(self, candidate: int) -> int | None:
        """Return the number of the same candidate one generation before; None if it is new."""
        origin = self.proposal.carried[candidate - self.first]
        return None if origin is None else self.first - len(self.proposal.genes) + origin

    def record(self) -> ProposalRecord:
        """Return the record of this generation for the journal."""
        carried = {
            str(self.first + index): origin
            for index in range(len(self.proposal.genes))
            if (origin := self.carried_from(self.first + index)) is not None
        }
        genes = tuple(tuple(map(float, row)) for row in self.proposal.genes)
        return ProposalRecord(self.number, self.first, tuple(self.space.names), genes, carried)

    def check(self, record: EvaluationRecord) -> None:
        """Raise an error for a record from another search.

        Raises
        ------
        JournalError
            If its genes differ from the proposed ones.
        """
        expected = self.genes(record.candidate)
        if dict(record.genes) != expected:
            raise JournalError(
                f"Candidate {record.candidate} has the genes {dict(record.genes)} in the journal, "
                f"but this search proposes {expected}: the search has changed, so the study "
                "cannot be continued. Its results can still be read with `palpate status`, "
                "`show` and `report`. To continue searching, run the study under another name: "
                "evaluations in the store are used again."
            )


class SearchReplay:
    """Step-by-step proposal of generations, each from the previous ones.

    Parameters
    ----------
    search : Search
        Proposes the candidates.
    space : Space
        The searched box.
    """

    def __init__(self, search: Search, space: Space) -> None:
        self._search = search
        self._space = space
        self._first = 0
        self.history: list[Generation] = []

    def propose(self) -> PendingGeneration | Stopped:
        """Return the population that follows the history, or the reason to stop."""
        proposed = self._search.propose(self.history)
        if isinstance(proposed, Stopped):
            return proposed
        return PendingGeneration(len(self.history), self._first, self._space, proposed)

    def complete(
        self, pending: PendingGeneration, endings: Mapping[int, EvaluationRecord]
    ) -> Generation:
        """Add a generation to the history; `endings` has at least all of its candidates."""
        scores = {c - pending.first: score_of(endings[c]) for c in pending.candidates}
        fits = {c - pending.first: endings[c].fit for c in pending.candidates}
        generation = pending.proposal.complete(scores, self.history, fits)
        self.history.append(generation)
        self._first += len(generation.scores)
        return generation

    def replay(
        self, endings: Mapping[int, EvaluationRecord]
    ) -> Iterator[tuple[PendingGeneration, Generation | None]]:
        """Yield the generations in a journal; the last may be unfinished (None).

        Raises
        ------
        JournalError
            If an ending does not belong to this search.
        """
        while isinstance(pending := self.propose(), PendingGeneration):
            recorded = [endings[c] for c in pending.candidates if c in endings]
            for record in recorded:
                pending.check(record)
            if len(recorded) < len(pending.candidates):
                yield pending, None
                return
            yield pending, self.complete(pending, endings)


class SteadyReplay:
    """Step-by-step proposal of candidates, each from the endings available to it.

    Parameters
    ----------
    search : SteadyGenetic

    Attributes
    ----------
    proposed : int
        Number of candidates so far.
    """

    def __init__(self, search: SteadyGenetic) -> None:
        self.search = search
        self.proposed = 0
        self._pool = Pool(search.settings.population)
        self._ended: list[tuple[FloatArray, float]] = []  # in the order of the journal

    def add(self, record: EvaluationRecord) -> None:
        """Add the next ending of the journal."""
        genes = np.array([record.genes[name] for name in self.search.space.names])
        self._ended.append((genes, score_of(record)))

    @property
    def ended(self) -> int:
        """Return the number of endings."""
        return len(self._ended)

    def propose(self) -> PendingGeneration | Stopped | None:
        """Return the next candidate; None if it has to wait for an ending."""
        known = self.search.known_at(self.proposed)
        if known > len(self._ended):
            return None
        for genes, score in self._ended[self._pool.count : known]:
            self._pool.add(genes.tolist(), score)
        proposed = self.search.propose(self.proposed, self._pool)
        if isinstance(proposed, Stopped):
            return proposed
        number = self.proposed // self.search.settings.population
        proposal = Proposal(proposed[None, :], (None,))
        pending = PendingGeneration(number, self.proposed, self.search.space, proposal)
        self.proposed += 1
        return pending

    def last_block(self) -> Generation:
        """Return the last endings, up to a population of them."""
        count = self.search.settings.population
        rest = (len(self._ended) - 1) % count + 1
        genes, scores = zip(*self._ended[-rest:], strict=True)
        return Generation(np.array(genes), np.array(scores))


def replayed(
    search: SteadyGenetic, endings: Mapping[int, EvaluationRecord]
) -> Iterator[tuple[PendingGeneration, Generation | None]]:
    """Yield the blocks of candidates in a journal; an incomplete block has no scores.

    Parameters
    ----------
    search : SteadyGenetic
    endings : mapping of int to EvaluationRecord
        In the order of the journal.

    Raises
    ------
    JournalError
        If an ending does not belong to this search.
    """
    replay, size = SteadyReplay(search), search.settings.population
    for record in endings.values():
        replay.add(record)
    genes: list[FloatArray] = []
    while True:
        pending = replay.propose()
        if isinstance(pending, PendingGeneration):
            if pending.first in endings:
                pending.check(endings[pending.first])
            genes.append(pending.proposal.genes[0])
        if genes and (len(genes) == size or not isinstance(pending, PendingGeneration)):
            yield _block(search, replay.proposed - len(genes), genes, endings)
            genes = []
        if not isinstance(pending, PendingGeneration):
            return


def _block(
    search: SteadyGenetic,
    first: int,
    genes: list[FloatArray],
    endings: Mapping[int, EvaluationRecord],
) -> tuple[PendingGeneration, Generation | None]:
    proposal = Proposal(np.array(genes), (None,) * len(genes))
    number = first // search.settings.population
    pending = PendingGeneration(number, first, search.space, proposal)
    if any(candidate not in endings for candidate in pending.candidates):
        return pending, None
    scores = np.array([score_of(endings[candidate]) for candidate in pending.candidates])
    return pending, Generation(proposal.genes, scores)
