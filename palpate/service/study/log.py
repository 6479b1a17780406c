"""The journal of a study, read as a whole."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Self

from palpate.storage.backends.layout import StudyLayout
from palpate.storage.errors import InputError, JournalError
from palpate.storage.records.journal import Journal
from palpate.storage.records.record import (
    EndRecord,
    EvaluationRecord,
    IdentificationRecord,
    ProposalRecord,
    SessionRecord,
    StudyRecord,
    caveats_in,
    record_of,
)


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
        Wall time of each run up to its last complete generation.
    proposals : mapping of int to ProposalRecord
        By generation number; empty for a search without generations, and for journals of
        versions that did not record proposals.
    unverified : int
        Number of records without a checksum, written by an earlier version.
    """

    study: StudyRecord | None = None
    sessions: tuple[SessionRecord, ...] = ()
    endings: Mapping[int, EvaluationRecord] = field(default_factory=dict)
    end: EndRecord | None = None
    identification: IdentificationRecord | None = None
    session_seconds: tuple[float, ...] = ()
    proposals: Mapping[int, ProposalRecord] = field(default_factory=dict)
    unverified: int = 0

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
        unverified = 0
        for line, verified in Journal.lines(journal):
            record = record_of(line)
            unverified += not verified
            if isinstance(record, StudyRecord):
                study = record
            elif isinstance(record, SessionRecord):
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
        )

    def wall_s(self, until: datetime) -> float:
        """Return the wall time of all runs.

        Parameters
        ----------
        until : datetime
            The end of the last run, if the run has not recorded it.
        """
        noted = sum(self.session_seconds)
        last = self.last_session
        if last is None or self.end is not None:
            return noted
        since = (until - datetime.fromisoformat(last.began)).total_seconds()
        return noted + max(0.0, last.seconds + since - self.session_seconds[-1])

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
