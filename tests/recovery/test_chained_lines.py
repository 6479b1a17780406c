"""A line of a journal that was removed, repeated or moved is noticed; old journals are readable."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from palpate.service.results.results_from_journal import check_records, findings_of, study_results
from palpate.service.server.job_progress import JournalTail
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import JournalError
from palpate.storage.journal import PREVIOUS_KEY, Journal, Seal
from palpate.storage.json_digests import CHECKSUM_KEY, dumps, seal
from tests.recovery.stand_ins import SPEC, Inline, run, small_spec, told

Lines = list[bytes]

KINDS = ("study", "session", "proposal", "evaluation", "generation", "identification")


def removed(lines: Lines, place: int, _: Lines) -> Lines:
    return lines[:place] + lines[place + 1 :]


def repeated(lines: Lines, place: int, _: Lines) -> Lines:
    return lines[: place + 1] + lines[place:]


def repeated_later(lines: Lines, place: int, _: Lines) -> Lines:
    return [*lines, lines[place]]


def reordered(lines: Lines, place: int, _: Lines) -> Lines:
    return [*lines[:place], lines[place + 1], lines[place], *lines[place + 2 :]]


def replaced(lines: Lines, place: int, others: Lines) -> Lines:
    return [*lines[:place], others[place], *lines[place + 1 :]]


def inserted(lines: Lines, place: int, others: Lines) -> Lines:
    return [*lines[:place], others[place], *lines[place:]]


def inserted_without_link(lines: Lines, place: int, others: Lines) -> Lines:
    return [*lines[: place + 1], unchained(others[place]), *lines[place + 1 :]]


EDITS = (removed, repeated, repeated_later, reordered, replaced, inserted, inserted_without_link)


def bare(line: bytes) -> bytes:
    """Return a line as the first versions wrote it."""
    record = json.loads(line) | {"schema_version": 1}
    del record[CHECKSUM_KEY], record[PREVIOUS_KEY]
    return dumps(record).encode() + b"\n"


def unchained(line: bytes) -> bytes:
    """Return a line as versions without chains wrote it."""
    return seal(bare(line).decode().strip()).encode() + b"\n"


def demo_spec(seed: int) -> StudySpec:
    return small_spec(SPEC.replace("seed: 7", f"seed: {seed}"))


@pytest.fixture(scope="module")
def studies(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Provide two completed studies that share a store and differ in their seed."""
    runs = tmp_path_factory.mktemp("chained") / "runs"
    for name, seed in (("demo", 0), ("other", 1)):
        run(runs / name, Inline(), demo_spec(seed))
    return runs / "demo", runs / "other"


def lines_of(folder: Path) -> Lines:
    return StudyLayout(folder).journal.read_bytes().splitlines(keepends=True)


def place_of(lines: Lines, kind: str) -> int:
    return next(i for i, line in enumerate(lines) if json.loads(line)["kind"] == kind)


@pytest.fixture
def copied(studies: tuple[Path, Path], tmp_path: Path) -> Path:
    """Provide a copy of the first study."""
    shutil.copytree(studies[0], tmp_path / "runs" / "demo")
    shutil.copytree(studies[0].parent / "store", tmp_path / "runs" / "store")
    return tmp_path / "runs" / "demo"


@pytest.mark.parametrize("edit", EDITS)
@pytest.mark.parametrize("kind", KINDS)
def test_an_edited_journal_is_noticed_by_the_check_and_the_next_run(
    studies: tuple[Path, Path], copied: Path, kind: str, edit: Callable[..., Lines]
) -> None:
    lines = lines_of(copied)
    edited = edit(lines, place_of(lines, kind), lines_of(studies[1]))
    # The first line of any journal is a valid first line; the next one gives it away.
    pairs = enumerate(zip(lines, edited, strict=False))
    same = next((number for number, (old, new) in pairs if old != new), len(lines))
    same += kind == "study" and edit in (replaced, inserted)
    journal = StudyLayout(copied).journal
    journal.write_bytes(b"".join(edited))
    (damage,) = check_records([copied]).damages
    assert damage.path == journal
    assert f"{journal}, line {same + 1}: it " in damage.reason
    with pytest.raises(JournalError, match=f"line {same + 1}: it "):
        run(copied, Inline(), demo_spec(0))
    with pytest.raises(JournalError, match=r"is damaged after byte \d+: it "):
        JournalTail(journal).read()
    assert journal.read_bytes() == b"".join(edited)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (0, r"line 1: it is not the first line of its journal: the lines before it are missing\. "),
        (7, r"line 8: it does not follow the line before it: lines were removed, repeated, "),
    ],
)
def test_message_says_what_happened_and_its_advice_works(
    copied: Path, place: int, words: str
) -> None:
    journal = StudyLayout(copied).journal
    lines = lines_of(copied)
    before = told(copied)
    journal.write_bytes(b"".join(removed(lines, place, [])))
    with pytest.raises(JournalError, match=words) as caught:
        StudyLog.read(journal)
    assert ("`head -n 7 OLD > journal.jsonl`" in str(caught.value)) == (place == 7)
    journal.write_bytes(b"".join(lines[:place]))
    run(copied, Inline(), demo_spec(0))
    assert told(copied) == before


@pytest.mark.parametrize("old", [bare, unchained], ids=["no checksums", "checksums"])
@pytest.mark.parametrize("count", [3, 9])
def test_an_old_journal_is_continued_with_chained_lines(
    copied: Path, old: Callable[[bytes], bytes], count: int
) -> None:
    journal = StudyLayout(copied).journal
    before = told(copied)
    journal.write_bytes(b"".join(map(old, lines_of(copied)[:count])))
    log = StudyLog.read(journal)
    assert (log.unchained, log.unverified) == (count, count if old is bare else 0)
    run(copied, Inline(), demo_spec(0))
    protections = [protection for _, protection in Journal.lines(journal)]
    kept = Seal.NONE if old is bare else Seal.CHECKSUM
    assert protections[:count] == [kept] * count
    assert set(protections[count:]) == {Seal.CHAIN}
    assert told(copied) == before
    # From the last of the old lines on, nothing can be taken out.
    lines = lines_of(copied)
    for place in (count - 1, count, count + 1):
        journal.write_bytes(b"".join(removed(lines, place, [])))
        with pytest.raises(JournalError, match="it does not follow the line before it"):
            StudyLog.read(journal)


def test_what_a_kill_leaves_is_continued(copied: Path) -> None:
    """A line that is cut off, or missing at the end, is what a killed writer leaves."""
    journal = StudyLayout(copied).journal
    lines, before = lines_of(copied), told(copied)
    for tail in (b"", lines[20][:40]):
        journal.write_bytes(b"".join(lines[:20]) + tail)
        run(copied, Inline(), demo_spec(0))
        assert told(copied) == before
        assert StudyLog.read(journal).unchained == 0


def test_a_chain_is_followed_from_the_middle_of_a_journal(copied: Path) -> None:
    """The service reads a journal in parts."""
    journal = StudyLayout(copied).journal
    lines = lines_of(copied)
    middle = sum(map(len, lines[:9]))
    whole = [json.loads(line)["kind"] for line in lines]
    assert [line.record["kind"] for line in JournalTail(journal, middle).read()] == whole[9:]
    journal.write_bytes(b"".join(lines[:9] + lines[10:]))
    with pytest.raises(JournalError, match="it does not follow the line before it"):
        JournalTail(journal, middle).read()
    journal.write_bytes(b"".join([*lines[:9], unchained(lines[9])]))
    with pytest.raises(JournalError, match="added by another program"):
        JournalTail(journal, middle).read()


def test_findings_of_another_study_are_noticed(studies: tuple[Path, Path], copied: Path) -> None:
    assert findings_of(copied, StudyLog.read(StudyLayout(copied).journal).end) == {}
    shutil.copy(StudyLayout(studies[1]).findings, StudyLayout(copied).findings)
    with pytest.raises(JournalError, match=r"findings\.json is of another study.*Put the right"):
        study_results(copied)
    (damage,) = check_records([copied]).damages
    assert damage.path == StudyLayout(copied).findings


def test_findings_of_earlier_versions_are_read(copied: Path) -> None:
    StudyLayout(copied).findings.write_text(seal(dumps({"notes": ["soft"]})))
    assert study_results(copied).findings == {"notes": ["soft"]}
