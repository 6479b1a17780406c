"""Fair sharing of slots, simulated without a cluster."""

import random

from palpate.service.server.jobs.job_runner import FairShare, JobSlots


def simulate(
    share: FairShare, jobs: list[JobSlots], threads: int, rounds: int
) -> dict[JobSlots, int]:
    """Return tasks by job if all jobs take every slot and one task ends per round."""
    chance, ended = random.Random(1), dict.fromkeys(jobs, 0)
    running: list[JobSlots] = []
    for _ in range(rounds):
        for job in chance.sample(jobs, len(jobs)):
            while job.take(threads):
                running.append(job)
        assert share.held == len(running) == 2 * threads
        one = running.pop(chance.randrange(len(running)))
        one.give_back()
        ended[one] += 1
    return ended


def test_equal_jobs_share_equally() -> None:
    share = FairShare()
    jobs = [share.join(owner, 0, n) for n, owner in enumerate(["ann", "bob", "eve"])]
    ended = simulate(share, jobs, threads=6, rounds=3000)
    assert max(ended.values()) - min(ended.values()) < 0.1 * 1000


def test_an_owner_of_many_jobs_gets_no_more_than_an_owner_of_few() -> None:
    share = FairShare()
    many = [share.join("ann", 0, n) for n in range(4)]
    one = share.join("bob", 0, 4)
    ended = simulate(share, [*many, one], threads=4, rounds=2000)
    assert abs(ended[one] - 1000) < 100
    assert max(ended[j] for j in many) - min(ended[j] for j in many) < 100


def test_higher_priority_is_served_first() -> None:
    share = FairShare()
    low, high = share.join("ann", 0, 0), share.join("ann", 3, 1)
    assert [low.take(1), low.take(1)] == [True, True]
    assert not high.take(1)
    low.give_back()
    assert not low.take(1)  # high has asked in vain
    assert high.take(1)
    low.give_back()
    assert high.take(1)
    high.give_back()  # at the barrier of a generation: it requests nothing
    assert low.take(1)
    assert not high.take(1)
    low.give_back()
    high.leave()
    assert [low.take(1), low.take(1), low.take(1)] == [True, True, False]
