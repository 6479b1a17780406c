"""An evaluation ends in a verdict, or is submitted again."""

from palpate.storage.journal_records import Status


def test_only_verdicts_are_endings():
    assert {status for status in Status if status.is_ending} == {
        Status.DONE,
        Status.DIVERGED,
        Status.CRASHED,
    }


def test_status_formats_as_its_value():
    assert f"{Status.DIVERGED}" == "diverged"
    assert Status("lost") is Status.LOST
