"""The journal keeps every acknowledged record, whatever happens to its writer."""

import errno
import fcntl
import math
import os
import subprocess
import sys
import threading

import pytest

from palpate.storage.errors import JournalError, NewerSchemaError
from palpate.storage.journal import BLOCK, Journal
from palpate.storage.journal_records import EvaluationRecord, Status, record_of

RECORDS = [{"candidate": i, "gsf": -i / 3, "note": "é\n\u2028\udcff"} for i in range(5)]
LAST = {"candidate": 99}


def read(path):
    return list(Journal.read(path))


def run(code, *arguments, **how):
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, **how)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.jsonl"


@pytest.fixture
def written(path):
    with Journal(path) as journal:
        journal.append(*RECORDS)
    return path


def test_records_of_several_sessions_are_read_in_order(path):
    assert read(path) == []
    for record in RECORDS:
        with Journal(path) as journal:
            journal.append(record)
    assert read(path) == RECORDS
    assert path.read_bytes().count(b"\n") == len(RECORDS)


def test_round_trip_of_infinite_scores(path):
    common = {"generation": 0, "genes": {"E": 0.1 + 0.2}, "digest": "d"}
    written = [
        EvaluationRecord(candidate=i, status=Status.DONE, score={"gsf": gsf}, **common)
        for i, gsf in enumerate([-math.inf, math.inf, -1 / 3])
    ]
    with Journal(path) as journal:
        journal.append(*(record.to_json() for record in written))
    assert [record_of(line) for line in Journal.read(path)] == written


def test_crash_at_any_byte_loses_only_the_current_record(written):
    whole = written.read_bytes()
    for cut in range(len(whole) + 1):
        written.write_bytes(whole[:cut])
        kept = RECORDS[: whole[:cut].count(b"\n")]
        assert read(written) == kept
        assert written.stat().st_size == cut, "a reader has changed the journal"
        with Journal(written) as journal:
            assert read(written) == kept
            journal.append(LAST)
        assert read(written) == [*kept, LAST]


@pytest.mark.parametrize("length", [1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK])
@pytest.mark.parametrize("before", [[], RECORDS])
def test_next_writer_cuts_off_a_torn_tail(path, before, length):
    with Journal(path) as journal:
        journal.append(*before)
    size = path.stat().st_size
    with path.open("ab") as file:
        file.write(b"\0" * length)
    assert read(path) == before
    with Journal(path):
        pass
    assert path.stat().st_size == size


def test_one_fsync_per_append(path, monkeypatch):
    with Journal(path) as journal:
        synced = []
        monkeypatch.setattr(os, "fsync", synced.append)
        journal.append(*RECORDS)
        assert len(synced) == 1
        journal.append()
        assert len(synced) == 1


def test_record_is_on_disk_when_append_returns(path):
    with Journal(path) as journal:
        for number, record in enumerate(RECORDS, start=1):
            journal.append(record)
            assert read(path) == RECORDS[:number]


# One writer at a time


def test_rejects_a_second_writer(written):
    with Journal(written) as first:
        with pytest.raises(JournalError, match=r"already running.*palpate status"):
            Journal(written)
        first.append(LAST)
    with Journal(written) as next_one:
        next_one.append(LAST)
    assert read(written) == [*RECORDS, LAST, LAST]


def test_second_writer_does_not_cut_off_the_first_one(written):
    with written.open("ab") as first:
        fcntl.flock(first, fcntl.LOCK_EX)
        first.write(b'{"half')
        first.flush()
        with pytest.raises(JournalError, match="already running"):
            Journal(written)
    assert written.read_bytes().endswith(b'{"half')


def test_killed_writer_leaves_records_and_no_lock(path):
    code = """
import os, signal, sys
from palpate.storage.journal import Journal
journal = Journal(sys.argv[1])
journal.append({"candidate": 0})
os.write(journal._handle, b'{"candidate": 1')
print("half written", flush=True)
signal.pause()
"""
    command = [sys.executable, "-c", code, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "half written\n"
        with pytest.raises(JournalError, match="already running"):
            Journal(path)
        writer.kill()

    with Journal(path) as journal:
        journal.append(LAST)
    assert read(path) == [{"candidate": 0}, LAST]


def test_lock_is_not_inherited_by_other_programs(path):
    with Journal(path):
        outlives = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        Journal(path).close()
    finally:
        outlives.kill()
        outlives.wait()


def test_forked_process_does_not_keep_the_lock(path):
    """A nanny starts a worker while the journal is closed: the new process still has a copy."""
    code = """
import os, signal, sys
from palpate.storage.journal import Journal
journal = Journal(sys.argv[1])
child = os.fork()
if child == 0:
    signal.pause()
try:
    journal.close()
    Journal(sys.argv[1]).close()
    print("opened again")
finally:
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
"""
    ran = run(code, path)
    assert ran.stdout == "opened again\n", ran.stderr


def test_status_check_does_not_reject_a_writer(written):
    """`palpate status` holds a shared lock for an instant; a writer that starts then waits."""
    with written.open("rb") as reader:
        fcntl.flock(reader, fcntl.LOCK_SH)
        leaves = threading.Timer(0.2, fcntl.flock, (reader, fcntl.LOCK_UN))
        leaves.start()
        with Journal(written) as journal:
            journal.append(LAST)
        leaves.join()
    assert read(written) == [*RECORDS, LAST]


def test_reports_a_failed_lock(path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(JournalError, match="No locks available"):
        Journal(path)


def test_reports_a_journal_that_cannot_be_opened(tmp_path):
    with pytest.raises(JournalError, match="No such file or directory"):
        Journal(tmp_path / "nowhere" / "journal.jsonl")
    with pytest.raises(JournalError, match="Is a directory"):
        Journal(tmp_path)
    with pytest.raises(JournalError, match="Is a directory"):
        read(tmp_path)


def test_close_is_idempotent_and_rejects_later_appends(path):
    journal = Journal(path)
    journal.close()
    journal.close()
    with pytest.raises(JournalError, match="closed"):
        journal.append(LAST)


# A disk that fails


def test_file_size_limit_keeps_complete_records(path):
    """The kernel cuts the write at 350 bytes, then refuses (EFBIG)."""
    code = """
import resource, signal, sys
from palpate.storage.errors import JournalError
from palpate.storage.journal import Journal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (350, 350))
with Journal(sys.argv[1]) as journal:
    for number in range(100):
        try:
            journal.append({"candidate": number, "note": "x" * 50})
        except JournalError as error:
            print(number, error)
            break
    journal.append({"c": 1})
"""
    ran = run(code, path)
    assert "cannot be written: File too large" in ran.stdout, ran.stderr
    assert ran.returncode == 0, ran.stderr
    count = int(ran.stdout.split()[0])
    assert count > 1
    assert path.stat().st_size <= 350
    assert read(path) == [*({"candidate": n, "note": "x" * 50} for n in range(count)), {"c": 1}]


FULL = OSError(errno.ENOSPC, "No space left on device")


def fail_after(count, error):
    """Return an ``os.write`` that writes `count` bytes, then raises."""
    real, left = os.write, [count]

    def write(handle, data):
        if not left[0]:
            raise error
        done = real(handle, bytes(data[: left[0]]))
        left[0] -= done
        return done

    return write


@pytest.mark.parametrize("count", [0, 1, 17, 80])
@pytest.mark.parametrize("error", [FULL, KeyboardInterrupt()], ids=["full", "Ctrl-C"])
def test_failed_write_leaves_a_usable_journal(written, count, error):
    with Journal(written) as journal:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "write", fail_after(count, error))
            with pytest.raises((JournalError, KeyboardInterrupt)):
                journal.append(*RECORDS)
        assert read(written) == RECORDS
        journal.append(LAST)
    assert read(written) == [*RECORDS, LAST]


def test_full_disk_gives_advice(written, monkeypatch):
    with Journal(written) as journal:
        monkeypatch.setattr(os, "write", fail_after(3, FULL))
        with pytest.raises(JournalError, match=r"No space left.*free some space"):
            journal.append(LAST)


def test_record_that_cannot_be_synced_is_dropped(written):
    def fail(_):
        raise OSError(errno.EIO, "Input/output error")

    with Journal(written) as journal:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "fsync", fail)
            with pytest.raises(JournalError, match="Input/output error"):
                journal.append(LAST)
        assert read(written) == RECORDS


def test_failed_cut_of_a_tail_is_repeated_later(written):
    def fail(*_):
        raise OSError(errno.EIO, "Input/output error")

    with Journal(written) as journal:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "write", fail_after(9, FULL))
            patch.setattr(os, "ftruncate", fail)
            for _ in range(2):
                with pytest.raises(JournalError):
                    journal.append(LAST)
        assert read(written) == RECORDS
        journal.append(LAST)
    assert read(written) == [*RECORDS, LAST]


@pytest.mark.parametrize("bad", [{"gsf": math.nan}, {"gsf": -math.inf}, {"x": {1, 2}}])
def test_rejects_values_that_json_cannot_represent(written, bad):
    with Journal(written) as journal, pytest.raises((ValueError, TypeError)):
        journal.append(LAST, bad)
    assert read(written) == RECORDS


# A file changed by other programs


def test_detects_a_replaced_journal(written, tmp_path):
    with Journal(written) as journal:
        written.rename(tmp_path / "moved")
        with pytest.raises(JournalError, match="moved or replaced"):
            journal.append(LAST)
        written.write_text("")
        with pytest.raises(JournalError, match="moved or replaced"):
            journal.append(LAST)
    assert read(tmp_path / "moved") == RECORDS


def test_detects_and_keeps_an_edited_journal(written):
    with Journal(written) as journal:
        with written.open("a") as other:
            other.write('{"by": "hand"}\n')
        with pytest.raises(JournalError, match="changed by another program"):
            journal.append(LAST)
    assert written.read_text().endswith('\n{"by": "hand"}\n')
    with pytest.raises(JournalError, match=r"line 6: .*added by another program.*head -n 5 OLD"):
        read(written)


@pytest.mark.parametrize(
    "damage",
    [b'{"candi', b"", b"[1]", b"3", b'{"gsf":NaN}', b"\xff\xfe", b"\0" * 40, b"[" * 100_000],
    ids=["torn", "empty", "list", "number", "nan", "bytes", "zeros", "deep"],
)
def test_damaged_line_in_the_middle_is_an_error(path, damage):
    path.write_bytes(b'{"candidate":0}\n{"candidate":1}\n' + damage + b'\n{"candidate":3}\n')
    lines = Journal.read(path)
    assert [next(lines), next(lines)] == [{"candidate": 0}, {"candidate": 1}]
    with pytest.raises(JournalError, match=r"line 3: not a JSON record.*head -n 2 OLD") as caught:
        next(lines)
    assert len(str(caught.value)) < 600


def test_advice_for_a_damaged_line_works(path):
    path.write_bytes(b'{"candidate":0}\n{"candi\n{"candidate":2}\n')
    with pytest.raises(JournalError, match=r"line 2: .*the line before it is intact"):
        read(path)
    old = path.rename(path.with_name("OLD"))
    with path.open("wb") as new:
        subprocess.run(["head", "-n", "1", str(old)], stdout=new, check=True)
    with Journal(path) as journal:
        journal.append(LAST)
    assert read(path) == [{"candidate": 0}, LAST]


def test_newer_record_asks_for_an_upgrade(written):
    with written.open("a") as newer:
        newer.write('{"kind":"verdict","schema_version":3}\n')
    with pytest.raises(NewerSchemaError, match=r"line 6, was written by a newer.*Upgrade"):
        read(written)


@pytest.mark.parametrize("version", ["null", '"1"', "0", "true", "1.5"])
def test_invalid_version_is_damage(written, version):
    with written.open("a") as other:
        other.write(f'{{"schema_version":{version}}}\n')
    with pytest.raises(JournalError, match="line 6: not a JSON record"):
        read(written)


def test_concurrent_readers_never_see_partial_records(path):
    code = """
import sys
from palpate.storage.journal import Journal
with Journal(sys.argv[1]) as journal:
    for number in range(300):
        journal.append({"candidate": number, "note": "x" * (number * 37 % 9000)})
"""
    with subprocess.Popen([sys.executable, "-c", code, str(path)]) as writer:
        seen = 0
        while writer.poll() is None:
            numbers = [record["candidate"] for record in Journal.read(path)]
            assert numbers == list(range(len(numbers)))
            assert len(numbers) >= seen
            seen = len(numbers)
    assert writer.returncode == 0
    assert len(read(path)) == 300
