"""The life of an evaluation ends in a verdict, or in being asked for again."""

from palpate.storage.records.status import Status


def test_only_a_verdict_on_the_candidate_is_an_ending():
    assert {status for status in Status if status.is_ending} == {
        Status.DONE,
        Status.DIVERGED,
        Status.CRASHED,
    }


def test_a_status_is_its_word():
    assert f"{Status.DIVERGED}" == "diverged"
    assert Status("lost") is Status.LOST
