"""The life of an evaluation ends in a verdict, or in being asked for again."""

from storage.status import Status


def test_only_a_verdict_on_the_candidate_is_an_ending():
    assert {status for status in Status if status.is_ending} == {
        Status.DONE,
        Status.DIVERGED,
        Status.CRASHED,
    }


def test_nothing_follows_an_ending_and_everything_else_can_reach_one():
    for status in Status:
        assert bool(status.may_become) != status.is_ending
        reached = {status}
        while new := {after for s in reached for after in s.may_become} - reached:
            reached |= new
        assert any(s.is_ending for s in reached)


def test_a_lost_evaluation_waits_again():
    assert Status.LOST.may_become == {Status.WAITING}


def test_a_status_is_its_word():
    assert f"{Status.DIVERGED}" == "diverged"
    assert Status("lost") is Status.LOST
