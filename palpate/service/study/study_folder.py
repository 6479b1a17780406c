"""The folder of a study: creation, checks that it belongs to the same study, and its journal.

The journal is read as a whole, with the generations in it. Reading never runs the search, so a
study stays readable if the search, or a library that it uses, has changed. Journals of earlier
versions do not record proposals; their generations are reconstructed from the endings, without the
candidates that were carried over.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Self

from palpate.service.installed_packages import versions
from palpate.service.search.search_keys import LEAST_SQUARES
from palpate.service.study.study_keys import StudySpec, differences
from palpate.storage.backends.atomic_files import explained, write_file
from palpate.storage.backends.store_paths import Place, StudyLayout, place_of
from palpate.storage.best_candidate import score_of
from palpate.storage.errors import InputError, JournalError
from palpate.storage.journal import Journal, Seal
from palpate.storage.journal_records import (
    EndRecord,
    EvaluationRecord,
    IdentificationRecord,
    ProposalRecord,
    SessionRecord,
    StudyRecord,
    caveats_in,
    record_of,
)
from palpate.storage.values import PreparedBody, PreparedTarget
from palpate.workers.input_files import dump_yaml

LONGEST_RUN_S = 60 * 86_400.0
"""A longer time from the beginning of a run to its last sign is that of a clock that was set."""
FINDINGS_OF = "evaluation"
"""Key of `findings.json` that names the evaluation which the findings are about."""


@dataclass(frozen=True)
class StudyLog:
    """The records of a journal, by kind.

    Parameters
    ----------
    study : StudyRecord or None
        None if nothing has been written.
    sessions : tuple of SessionRecord
        Runs so far.
    endings : mapping of int to EvaluationRecord
        By candidate.
    end : EndRecord or None
        Present if the search has stopped.
    identification : IdentificationRecord or None
        The identifiability of the constants, once it is known.
    session_seconds : tuple of float
        Wall time of each run up to its last sign; of the last run up to its last complete
        generation.
    proposals : mapping of int to ProposalRecord
        By generation number; empty for a search without generations, and for journals of
        versions that did not record proposals.
    unverified : int
        Number of records without a checksum, written by an earlier version.
    unchained : int
        Number of records that do not name the one before, written by an earlier version: those
        without a checksum, and some with one.
    """

    study: StudyRecord | None = None
    sessions: tuple[SessionRecord, ...] = ()
    endings: Mapping[int, EvaluationRecord] = field(default_factory=dict)
    end: EndRecord | None = None
    identification: IdentificationRecord | None = None
    session_seconds: tuple[float, ...] = ()
    proposals: Mapping[int, ProposalRecord] = field(default_factory=dict)
    unverified: int = 0
    unchained: int = 0

    @classmethod
    def read(cls, journal: Path) -> Self:
        """Read a journal; a missing or empty one has no records.

        Raises
        ------
        JournalError
            If it is damaged, or has two endings for one candidate.
        NewerSchemaError
            If it was written by a newer version of Palpate.
        """
        study: StudyRecord | None = None
        end: EndRecord | None = None
        identification: IdentificationRecord | None = None
        sessions: list[SessionRecord] = []
        endings: dict[int, EvaluationRecord] = {}
        session_seconds: list[float] = []
        proposals: dict[int, ProposalRecord] = {}
        unverified = unchained = 0
        for line, protection in Journal.lines(journal):
            record = record_of(line)
            unverified += protection is Seal.NONE
            unchained += protection is not Seal.CHAIN
            if isinstance(record, StudyRecord):
                study = record
            elif isinstance(record, SessionRecord):
                if session_seconds and record.previous_run_s is not None:
                    session_seconds[-1] = max(session_seconds[-1], record.previous_run_s)
                sessions.append(record)
                session_seconds.append(record.seconds)
            elif isinstance(record, EvaluationRecord):
                if record.candidate in endings:
                    raise _two_endings(journal, record.candidate)
                endings[record.candidate] = record
            elif isinstance(record, IdentificationRecord):
                identification = record
            elif isinstance(record, ProposalRecord):
                proposals[record.number] = record
            else:
                if session_seconds:
                    session_seconds[-1] = record.elapsed_s
                if isinstance(record, EndRecord):
                    end = record
        if study is None and (endings or sessions):
            raise JournalError(
                f"{journal} does not begin with its study: its beginning is missing. Start a new "
                "study; evaluations in the store are used again."
            )
        return cls(
            study=study,
            sessions=tuple(sessions),
            endings=endings,
            end=end,
            identification=identification,
            session_seconds=tuple(session_seconds),
            proposals=proposals,
            unverified=unverified,
            unchained=unchained,
        )

    def wall_s(self, until: datetime) -> float:
        """Return the wall time of all runs.

        Parameters
        ----------
        until : datetime
            The end of the last run, if the run has not recorded it.
        """
        return sum(self.session_seconds[:-1]) + (self.last_run_s(until) or 0.0)

    def last_run_s(self, until: datetime) -> float | None:
        """Return the wall time of the last run; None if there was none.

        Parameters
        ----------
        until : datetime
            Its end, if the run has not recorded it.
        """
        last = self.last_session
        if last is None:
            return None
        noted = self.session_seconds[-1]
        began = last.began_at
        if self.end is not None or began is None:
            return noted
        seconds = last.seconds + (until - began).total_seconds()
        return max(noted, seconds) if seconds < LONGEST_RUN_S else noted

    @property
    def last_session(self) -> SessionRecord | None:
        """Return the latest run; None if preparation has never been completed."""
        return self.sessions[-1] if self.sessions else None

    @property
    def caveats(self) -> tuple[str, ...]:
        """Return the statements that qualify every result of the study."""
        return caveats_in(self.sessions)

    @property
    def code(self) -> str:
        """Return the digest of the code of the latest run; empty if there was none."""
        if self.sessions:
            return self.sessions[-1].versions["code"]
        return "" if self.study is None else self.study.versions.get("code", "")


def _two_endings(journal: Path, candidate: int) -> JournalError:
    return JournalError(
        f"{journal} has two endings for candidate {candidate}: it was edited. Remove the "
        "second line, then run the study again."
    )


def read_study(folder: Path) -> tuple[StudyRecord, StudyLog]:
    """Read the journal of an existing study.

    Raises
    ------
    InputError
        If `folder` is not a study.
    JournalError
        If its journal is damaged.
    """
    log = StudyLog.read(StudyLayout(folder).journal)
    if log.study is None:
        problem = "has no journal of a study" if folder.is_dir() else "does not exist"
        raise InputError(
            f"{folder} {problem}. Give the folder of a study, such as runs/NAME, or start one "
            "with `palpate run STUDY.yaml`."
        )
    return log.study, log


@dataclass(frozen=True)
class RecordedGeneration:
    """One generation, as recorded in the journal.

    Parameters
    ----------
    number : int
        From 0.
    genes : mapping of int to mapping of str to float
        By candidate.
    carried : mapping of int to int
        Each carried candidate with its number in the previous generation.
    evaluations : int
        Number of candidates that need an evaluation.
    """

    number: int
    genes: Mapping[int, Mapping[str, float]]
    carried: Mapping[int, int]
    evaluations: int

    def ended(self, endings: Mapping[int, EvaluationRecord]) -> int:
        """Return the number of its evaluations that have ended."""
        return sum(c in endings for c in self.genes if c not in self.carried)


class RecordedGenerations:
    """All generations of a study that has started.

    Parameters
    ----------
    spec : StudySpec
    log : StudyLog
    """

    def __init__(self, spec: StudySpec, log: StudyLog) -> None:
        self.endings = log.endings
        if log.proposals:
            found = [_proposed(log.proposals[number]) for number in sorted(log.proposals)]
        else:
            found = list(_from_endings(spec, log))
        self.generations = tuple(found)

    def generation_of(self, candidate: int) -> RecordedGeneration | None:
        """Return the generation of a candidate; None if no record names it."""
        return next((g for g in self.generations if candidate in g.genes), None)

    def evaluated_as(self, candidate: int) -> int:
        """Return the number under which a candidate was evaluated."""
        generation = self.generation_of(candidate)
        while generation is not None and candidate in generation.carried:
            candidate = generation.carried[candidate]
            generation = self.generation_of(candidate)
        return candidate

    def scores(self, generation: RecordedGeneration) -> dict[int, float] | None:
        """Return the scores of a generation by candidate; None until all are known."""
        sources = {c: self.evaluated_as(c) for c in generation.genes}
        known = all(source in self.endings for source in sources.values())
        if not known or generation.ended(self.endings) < generation.evaluations:
            return None
        return {c: score_of(self.endings[source]) for c, source in sources.items()}

    @property
    def candidates(self) -> int:
        """Return the number of candidates."""
        return sum(len(generation.genes) for generation in self.generations)


def _proposed(record: ProposalRecord) -> RecordedGeneration:
    genes = {
        record.first + index: dict(zip(record.names, row, strict=True))
        for index, row in enumerate(record.genes)
    }
    carried = {int(candidate): origin for candidate, origin in record.carried.items()}
    return RecordedGeneration(record.number, genes, carried, len(genes) - len(carried))


def _from_endings(spec: StudySpec, log: StudyLog) -> Iterator[RecordedGeneration]:
    numbers = sorted({record.generation for record in log.endings.values()})
    if not numbers and log.end is None:
        yield RecordedGeneration(0, {}, {}, _usual_size(spec, 0))
    for number in numbers:
        here = [log.endings[c] for c in sorted(log.endings) if log.endings[c].generation == number]
        genes = {record.candidate: dict(record.genes) for record in here}
        complete = log.end is not None or number < numbers[-1]
        wanted = len(here) if complete else max(len(here), _usual_size(spec, number))
        yield RecordedGeneration(number, genes, {}, wanted)


def _usual_size(spec: StudySpec, number: int) -> int:
    """Return the usual number of evaluations in a generation."""
    if spec.search.strategy == LEAST_SQUARES.name:
        return spec.search.starts
    if spec.search.steady:
        left = spec.most_evaluations - number * spec.search.population
        return max(0, min(spec.search.population, left))
    return spec.search.population - (spec.search.elite if number else 0)


def best_in(scores: Mapping[int, float]) -> int:
    """Return the candidate with the lowest score, the first in a tie."""
    return min(sorted(scores), key=lambda candidate: scores[candidate])


def finite(scores: Mapping[int, float]) -> list[float]:
    """Return the finite scores, in the order of the candidates."""
    return [scores[candidate] for candidate in sorted(scores) if math.isfinite(scores[candidate])]


HEAD = "# The settings of this study, with all defaults. Changing them has no effect.\n"


class StudyFolder:
    """The folder of one study.

    Parameters
    ----------
    root : Path
        Created if missing.
    spec : StudySpec
        The study to run in this folder.
    accept_new_code : bool
        Whether to continue even if the code has changed since the last run.
    """

    def __init__(self, root: Path, spec: StudySpec, *, accept_new_code: bool = False) -> None:
        self.root = root.expanduser().absolute()
        self.spec = spec
        self.layout = StudyLayout(self.root)
        self._accept_new_code = accept_new_code

    def check(self) -> StudyLog:
        """Read the folder, and raise an error if it belongs to another study.

        Raises
        ------
        InputError
            If the folder holds another study, or other code has run this one.
        JournalError
            If its journal is damaged.
        """
        if self.root.exists() and not self.root.is_dir():
            raise InputError(f"{self.root} is a file; expected a study folder: choose another.")
        log = StudyLog.read(self.layout.journal)
        if log.study is not None and log.sessions:
            self._refuse_other_study(log.study)
            self._refuse_other_code(log)
        return log

    def open(self) -> Journal:
        """Lock the journal, creating the folder if it is missing.

        Raises
        ------
        StoreError
            If the folder cannot be written.
        JournalError
            If the study is already running.
        """
        with explained(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
        return Journal(self.layout.journal)

    def begin(self, journal: Journal) -> StudyLog:
        """Read the locked journal; a new study gets its first record.

        A study may still be changed until its preparation has succeeded once.
        """
        log = self.check()
        if log.study is not None and log.study.spec_digest == self.spec.digest:
            return log
        text = dump_yaml(self.spec.as_dict())
        write_file(self.layout.study, (HEAD + text).encode())
        journal.append(StudyRecord(self.spec.digest, self.spec.as_dict(), versions()).to_json())
        return log

    def default_store(self, log: StudyLog) -> Place:
        """Return the store of the last run if it still exists, else the one next to the study."""
        last = None if log.last_session is None else place_of(log.last_session.store)
        if last is None or (isinstance(last, Path) and not last.is_dir()):
            return self.root.parent / "store"
        return last

    def check_same(self, log: StudyLog, prepared: PreparedBody, target: PreparedTarget) -> None:
        """Raise an error if the body or the target is different.

        Raises
        ------
        InputError
            If an image has changed since the study began.
        """
        last = log.last_session
        if last is None or self._accept_new_code:
            return
        for what, before, now in (
            ("undeformed body", last.prepared["volume"], prepared["volume"]),
            ("mesh", last.prepared["mesh"], prepared["mesh"]),
            ("target", last.target["target"], target["target"]),
        ):
            if before != now:
                raise InputError(
                    f"The {what} of this study was {before}, now it is {now}: its image has "
                    "changed since the study began. Restore the old image, or start a new study "
                    "with --study."
                )

    def _refuse_other_study(self, study: StudyRecord) -> None:
        if study.spec_digest == self.spec.digest:
            return
        changes = "\n".join(f"  {line}" for line in differences(study.spec, self.spec.as_dict()))
        raise InputError(
            f"{self.root} holds a study with different settings:\n{changes}\n"
            "Undo these changes to continue it, or give the changed study another folder with "
            "--study; evaluations in the store are used again."
        )

    def _refuse_other_code(self, log: StudyLog) -> None:
        now = versions()["code"]
        if log.code == now or self._accept_new_code:
            return
        raise InputError(
            f"The code has changed since this study last ran (then {log.code}, now {now}), so "
            "its scores may not be comparable. Install the version it was run with, restart it "
            "in another folder with --study, or add --accept-new-code to continue."
        )
