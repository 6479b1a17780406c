"""The cost of the search itself, which is negligible compared with one simulation."""

import sys
import time

import numpy as np
import pytest

from palpate.service.search.genetic_search import GeneticSearch, GeneticSettings
from palpate.service.search.search_interface import Generation, Proposal, Space

SPACE = Space.from_bounds({f"E_{index}_kpa": (5, 80) for index in range(5)})


@pytest.mark.slow
def test_thesis_search_costs_less_than_one_simulation(capsys: pytest.CaptureFixture[str]) -> None:
    search = GeneticSearch(SPACE, GeneticSettings(stall=None), seed=1)
    history: list[Generation] = []
    begin = time.perf_counter()
    while isinstance(proposal := search.propose(history), Proposal):
        scores = np.log(np.linalg.norm(proposal.genes - 40, axis=1))
        told = {index: float(scores[index]) for index in proposal.to_evaluate}
        history.append(proposal.complete(told, history))
    total_ms = 1e3 * (time.perf_counter() - begin)
    with capsys.disabled():
        sys.stdout.write(f"\nsearch: 15 generations of 84 in {total_ms:.1f} ms\n")
    assert total_ms < 1000
