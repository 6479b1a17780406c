"""What a study's journal says, as a whole.

Beside the records of `storage.records` a journal holds three kinds of marks, which
no score depends on::

    session      a run of the study begins: versions, store, and what was prepared
    generation   all scores of a generation are known
    end          the search has stopped: reason, best candidate, scores by tissue
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from storage.errors import InputError, JournalError
from storage.journal import Journal
from storage.layout import StudyLayout
from storage.plain import from_plain, to_plain
from storage.records import EvaluationRecord, StudyRecord, record_of

SCHEMA_VERSION = 1
Json = dict[str, Any]


@dataclass(frozen=True)
class Session:
    """The beginning of a run, after its preparation.

    Parameters
    ----------
    began : str
        Date and time, ISO 8601.
    store : str
        Where the store is.
    versions : mapping
        See `service.versions`.
    prepared, target : mapping
        As the tasks returned them.
    workers : int
        Evaluations at once.
    seconds : float
        How long the preparation took.
    """

    began: str
    store: str
    versions: Mapping[str, str]
    prepared: Mapping[str, Any]
    target: Mapping[str, Any]
    workers: int
    seconds: float


@dataclass(frozen=True)
class GenerationMark:
    """A generation is complete, so many seconds after its session began."""

    number: int
    best: float
    elapsed_s: float


@dataclass(frozen=True)
class End:
    """The search has stopped.

    Parameters
    ----------
    reason : str
        In words.
    best : int or None
        Candidate; None if none has a score.
    volume : str or None
        Digest of its deformed volume.
    before : mapping
        Score of the undeformed body for each tissue: where every fit begins.
    per_label : mapping
        Score of the best candidate for each tissue.
    elapsed_s : float
        Since the session began.
    """

    reason: str
    best: int | None
    volume: str | None
    before: Mapping[str, Any]
    per_label: Mapping[str, Any]
    elapsed_s: float


Mark = Session | GenerationMark | End
_KINDS: dict[str, type[Mark]] = {"session": Session, "generation": GenerationMark, "end": End}


def mark_to_json(mark: Mark) -> Json:
    """A line of the journal."""
    kind = next(kind for kind, made in _KINDS.items() if isinstance(mark, made))
    return {"kind": kind, "schema_version": SCHEMA_VERSION, **to_plain(vars(mark))}


def _mark_of(line: Json) -> Mark:
    values = {k: v for k, v in from_plain(line).items() if k not in ("kind", "schema_version")}
    if line["kind"] == "generation":
        values["best"] = float(values["best"])  # "-inf" at the top stays text otherwise
    try:
        return _KINDS[line["kind"]](**values)
    except TypeError as error:
        raise JournalError(f"A {line['kind']} record cannot be read: {error}.") from error


@dataclass(frozen=True)
class Chronicle:
    """A journal, read.

    Parameters
    ----------
    study : StudyRecord or None
        None if nothing was ever written.
    sessions : tuple of Session
        Runs so far.
    endings : mapping of int to EvaluationRecord
        By candidate.
    end : End or None
        If the search has stopped.
    seconds : float
        Wall time of all runs, as far as they noted it.
    """

    study: StudyRecord | None = None
    sessions: tuple[Session, ...] = ()
    endings: Mapping[int, EvaluationRecord] = field(default_factory=dict)
    end: End | None = None
    seconds: float = 0.0

    @classmethod
    def read(cls, journal: Path) -> Self:
        """Read a journal; one that is missing or empty says nothing.

        Raises
        ------
        JournalError
            If it is damaged, or tells of one candidate twice.
        NewerSchemaError
            If a newer version of Palpate wrote it.
        """
        told = cls(endings={})
        endings: dict[int, EvaluationRecord] = {}
        spent: list[float] = []
        for line in Journal.read(journal):
            if line.get("kind") in _KINDS:
                told = told._with(_mark_of(line), spent)
                continue
            record = record_of(line)
            if isinstance(record, StudyRecord):
                told = replace(told, study=record)
            elif record.candidate in endings:
                raise JournalError(
                    f"{journal} tells of candidate {record.candidate} twice: it was changed by "
                    "hand. Remove the second line, then run the study again."
                )
            else:
                endings[record.candidate] = record
        if told.study is None and (endings or told.sessions):
            raise JournalError(
                f"{journal} does not begin with its study: its head was cut off. Start a new "
                "study; evaluations in the store are used again."
            )
        return replace(told, endings=endings, seconds=sum(spent))

    def _with(self, mark: Mark, spent: list[float]) -> Self:
        if isinstance(mark, Session):
            spent.append(mark.seconds)
            return replace(self, sessions=(*self.sessions, mark))
        if spent:
            spent[-1] = mark.elapsed_s
        return replace(self, end=mark) if isinstance(mark, End) else self

    @property
    def code(self) -> str:
        """The code that the study was run with last; empty if it never was."""
        if self.sessions:
            return self.sessions[-1].versions["code"]
        return "" if self.study is None else self.study.versions.get("code", "")


def read_study(folder: Path) -> tuple[StudyRecord, Chronicle]:
    """The journal of an existing study.

    Raises
    ------
    InputError
        If `folder` is no study.
    JournalError
        If its journal is damaged.
    """
    told = Chronicle.read(StudyLayout(folder).journal)
    if told.study is None:
        what = "holds no journal of a study" if folder.is_dir() else "does not exist"
        raise InputError(
            f"{folder} {what}. Give the folder of a study, such as runs/NAME, or start one with "
            "`palpate run STUDY.yaml`."
        )
    return told.study, told
