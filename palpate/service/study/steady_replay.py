"""Replay of a search without generations, in the order of the endings in its journal.

Candidates are counted in blocks of a population, so that results and pages can refer to
generations; there is no barrier at the end of a block.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from palpate.service.search.base import FloatArray, Generation, Proposal, Stopped
from palpate.service.search.steady import Pool, SteadyGenetic
from palpate.service.study.replay import PendingGeneration
from palpate.storage.records.best_candidate import score_of
from palpate.storage.records.record import EvaluationRecord


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
