"""Records of a study's journal, and the states of its evaluations.

::

    study         first line: the study file, and the versions it began with
    session       a run of the study begins: versions, store, and the prepared bodies
    proposal      a generation is proposed: the genes of its candidates, and which are carried over
    evaluation    one line for each ending of a candidate, in order of arrival
    generation    all scores of a generation are known
    identification  the identifiability of the constants, from the tangents at the best candidate
    end           the search has stopped: reason, best candidate, scores by tissue

Scores do not depend on session, generation or end records. Records are validated, so an
inconsistent one can be neither created nor read.

States of an evaluation::

    waiting --> running --+--> done        simulated and scored
       ^                  +--> diverged    no equilibrium was found: ranked last, never retried
       |                  +--> crashed     an exception, with its traceback: ranked last
       |                  `--> lost        its worker died: no verdict on the candidate
       |                         |
       `-------------------------'

Endings are written to the journal. The next run of a study resubmits every candidate
without an ending.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, ClassVar, Self

from palpate.storage.errors import JournalError
from palpate.storage.json_digests import to_number, to_plain
from palpate.storage.read_only import ReadOnly, read_only
from palpate.storage.store import check_schema
from palpate.storage.values import (
    FitJson,
    MeshFit,
    OutcomeJson,
    PreparedBody,
    PreparedTarget,
    Scores,
)


class Status(StrEnum):
    """State of an evaluation."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    DIVERGED = "diverged"
    CRASHED = "crashed"
    LOST = "lost"

    @property
    def is_ending(self) -> bool:
        """Return True if the search gets a score for it: done, diverged or crashed."""
        return self in (Status.DONE, Status.DIVERGED, Status.CRASHED)


SCHEMA_VERSION = 2
"""Version 1 has the same records, in lines that do not name the line before them."""


class _JournalRecord(ReadOnly):
    """Conversion of a dataclass to and from a line of the journal, field by field."""

    kind: ClassVar[str]
    # Fields added later, which older journals lack.
    left_out_if_none: ClassVar[frozenset[str]] = frozenset()

    def to_json(self) -> dict[str, Any]:
        """Return the line of the journal, as plain values."""
        named: Any = self
        plain = {
            f.name: to_plain(getattr(self, f.name))
            for f in fields(named)
            if f.name not in self.left_out_if_none or getattr(self, f.name) is not None
        }
        return {"kind": self.kind, "schema_version": SCHEMA_VERSION, **plain}

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Self:
        """Undo `to_json`.

        Raises
        ------
        JournalError
            If the record is of another kind, lacks a field or is inconsistent.
        NewerSchemaError
            If a newer version of Palpate wrote it.
        """
        values = {k: v for k, v in record.items() if k not in ("kind", "schema_version")}
        dataclass_type: Any = cls
        expected = {f.name for f in fields(dataclass_type)}
        try:
            check_schema(record.get("schema_version"), SCHEMA_VERSION, f"A {cls.kind} record")
            if record.get("kind") != cls.kind:
                raise ValueError(f"its kind is {record.get('kind')!r}")
            if wrong := sorted((expected ^ set(values)) - cls.left_out_if_none & expected):
                raise ValueError(f"fields missing or unknown: {', '.join(wrong)}")
            return cls(**values)
        except (TypeError, ValueError, AttributeError, JournalError) as error:
            raise JournalError(
                f"A {cls.kind} record cannot be read ({error}). The journal is damaged: start a "
                "new study; evaluations in the store are used again."
            ) from error


@dataclass(frozen=True)
class StudyRecord(_JournalRecord):
    """The study file with all defaults, and the versions that the study began with.

    Parameters
    ----------
    spec_digest : str
        Digest of `spec`.
    spec : mapping
        The study file with all defaults filled in.
    versions : mapping of str to str
        Versions of Palpate, its code and the packages that results depend on.
    """

    kind: ClassVar[str] = "study"

    spec_digest: str
    spec: Mapping[str, Any]
    versions: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.spec_digest:
            _refuse("a study has no digest")
        if not isinstance(self.spec, Mapping) or not isinstance(self.versions, Mapping):
            _refuse("spec and versions of a study must be mappings")
        super().__post_init__()


@dataclass(frozen=True)
class SessionRecord(_JournalRecord):
    """The beginning of a run of the study, after its preparation.

    Parameters
    ----------
    began : str
        Date and time, ISO 8601.
    store : str
        Location of the store.
    versions : mapping of str to str
        See `service.installed_packages`.
    prepared : PreparedBody
        The undeformed body and its mesh.
    target : PreparedTarget
        The deformed body to be matched.
    workers : int
        Number of parallel evaluations.
    seconds : float
        Duration of the preparation.
    caveats : sequence of str, optional
        Caveats shown before every result, such as a failed plausibility check.
    previous_run_s : float, optional
        Wall time of the run before this one up to its last sign, which a killed run cannot record
        itself; None for the first run.
    """

    kind: ClassVar[str] = "session"
    left_out_if_none: ClassVar[frozenset[str]] = frozenset({"caveats", "previous_run_s"})

    began: str
    store: str
    versions: Mapping[str, str]
    prepared: PreparedBody
    target: PreparedTarget
    workers: int
    seconds: float
    caveats: Sequence[str] | None = None
    previous_run_s: float | None = None

    def __post_init__(self) -> None:
        _restore_numbers(self, "prepared", "target")
        super().__post_init__()

    @property
    def began_at(self) -> datetime | None:
        """Return the time of `began`, in UTC if it names no zone; None if it is not a time."""
        try:
            moment = datetime.fromisoformat(self.began)
        except (ValueError, TypeError):
            return None
        return moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)


@dataclass(frozen=True)
class ProposalRecord(_JournalRecord):
    """The candidates of a generation, as the search proposed them.

    The journal can then be read without the search that wrote it.

    Parameters
    ----------
    number : int
        Number of the generation, from 0.
    first : int
        Number of its first candidate.
    names : tuple of str
        Names of the genes.
    genes : tuple of tuple of float
        A row for each candidate.
    carried : mapping of str to int
        Candidates that are not evaluated again, and the candidate of the previous generation whose
        ending each one keeps.
    """

    kind: ClassVar[str] = "proposal"

    number: int
    first: int
    names: tuple[str, ...]
    genes: tuple[tuple[float, ...], ...]
    carried: Mapping[str, int]

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "genes", tuple(tuple(map(float, row)) for row in self.genes))
        if not (_is_count(self.number, 0) and _is_count(self.first, 0)):
            _refuse(f"generation {self.number} begins with candidate {self.first}")
        if any(len(row) != len(self.names) for row in self.genes):
            _refuse(f"generation {self.number} has candidates without {', '.join(self.names)}")
        super().__post_init__()


@dataclass(frozen=True)
class GenerationRecord(_JournalRecord):
    """A marker written once all scores of a generation are known.

    Parameters
    ----------
    number : int
        Number of the generation, from 0.
    best : float
        Lowest GSF; may be infinite.
    elapsed_s : float
        Time since the session began.
    """

    kind: ClassVar[str] = "generation"

    number: int
    best: float
    elapsed_s: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "best", float(self.best))


@dataclass(frozen=True)
class EndRecord(_JournalRecord):
    """The end of the search.

    Parameters
    ----------
    reason : str
        Why the search stopped.
    best : int or None
        Best candidate; None if none has a score.
    volume : str or None
        Digest of its deformed volume.
    before : mapping of str to Scores
        Scores of the undeformed body by tissue: the starting point of every fit.
    per_label : mapping of str to Scores
        Scores of the best candidate by tissue.
    elapsed_s : float
        Time since the session began.
    """

    kind: ClassVar[str] = "end"

    reason: str
    best: int | None
    volume: str | None
    before: Mapping[str, Scores]
    per_label: Mapping[str, Scores]
    elapsed_s: float

    def __post_init__(self) -> None:
        _restore_numbers(self, "before", "per_label")


@dataclass(frozen=True)
class IdentificationRecord(_JournalRecord):
    """Identifiability of the constants, from the tangents at the best candidate.

    Parameters
    ----------
    candidate : int
        The best candidate.
    fit : FitJson or None
        Its least-squares problem, or None.
    reason : str
        Why there is no least-squares problem; empty if there is one.
    nuisances : FitJson, optional
        The same problem with the nuisance parameters of the organ; see `Organ.nuisances`.
    meshes : list of MeshFit, optional
        The same problem on meshes of other sizes.
    """

    kind: ClassVar[str] = "identification"
    left_out_if_none: ClassVar[frozenset[str]] = frozenset({"nuisances", "meshes"})

    candidate: int
    fit: FitJson | None
    reason: str = ""
    nuisances: FitJson | None = None
    meshes: list[MeshFit] | None = None

    def __post_init__(self) -> None:
        if (self.fit is None) != bool(self.reason):
            _refuse("an identification needs either tangents or the reason why there are none")
        for name in ("fit", "nuisances", "meshes"):
            if getattr(self, name) is not None:
                _restore_numbers(self, name)


@dataclass(frozen=True)
class EvaluationRecord(_JournalRecord):
    """Result of the evaluation of one candidate.

    Parameters
    ----------
    candidate : int
        Its number in the study, from 0.
    generation : int
        From 0.
    genes : mapping of str to float
        Parameters by name, finite.
    digest : str
        Digest of the evaluation in the store.
    status : Status
        done, diverged, crashed or lost.
    score : Scores, optional
        Includes ``gsf``, which may be infinite; present only if done.
    outcome : OutcomeJson, optional
        The solver's report on its result.
    reason : str
        Why there is no score; empty only if done.
    traceback : str
        Traceback of a crash; empty otherwise.
    seconds : mapping of str to float
        Time spent in each stage.
    worker : str
        Worker that ran it; empty if unknown.
    attempts : int
        Number of submissions, from 1.
    reused : bool
        True if the result was already in the store.
    fit : FitJson, optional
        Its least-squares problem, if the strategy needs derivatives.
    level : int, optional
        Index of the study's resolution, coarse to fine; None for the resolution of the study file.

    Raises
    ------
    JournalError
        If the fields contradict each other.
    """

    kind: ClassVar[str] = "evaluation"
    left_out_if_none: ClassVar[frozenset[str]] = frozenset({"fit", "level"})

    candidate: int
    generation: int
    genes: Mapping[str, float]
    digest: str
    status: Status
    score: Scores | None = None
    outcome: OutcomeJson | None = None
    reason: str = ""
    traceback: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    worker: str = ""
    attempts: int = 1
    reused: bool = False
    fit: FitJson | None = None
    level: int | None = None

    def __repr__(self) -> str:
        shown = [f"{name} {value:.4g}" for name, value in list(self.genes.items())[:6]]
        more = ", ..." if len(self.genes) > 6 else ""
        ending = f"gsf {self.score['gsf']:.4g}" if self.score else f"{self.status}, {self.reason}"
        text = f"<Candidate {self.candidate} of generation {self.generation}: {', '.join(shown)}"
        return f"{text}{more}; {ending}"[:498] + ">"

    def __post_init__(self) -> None:
        object.__setattr__(self, "status", Status(self.status))
        _restore_numbers(self, "genes", "score", "outcome", "seconds")
        if self.fit is not None:
            _restore_numbers(self, "fit")
        name = f"candidate {self.candidate} is {self.status}"
        if not (_is_count(self.candidate, 0) and _is_count(self.generation, 0)):
            _refuse(f"{name}, but its number or generation ({self.generation}) is not a count")
        if not _is_count(self.attempts, 1):
            _refuse(f"{name} after {self.attempts!r} attempts")
        if not all(math.isfinite(gene) for gene in self.genes.values()):
            _refuse(f"{name} with genes that are not finite: {dict(self.genes)}")
        if not (self.status.is_ending or self.status is Status.LOST):
            _refuse(f"{name}, which is not an ending")
        self._check_ending(name)

    def _check_ending(self, name: str) -> None:
        done = self.status is Status.DONE
        if done != (self.score is not None):
            _refuse(f"{name} {'without' if done else 'with'} a score")
        if self.score is not None and math.isnan(self.score.get("gsf", math.nan)):
            _refuse(f"{name} with gsf {self.score.get('gsf')!r}, expected a number")
        if done == bool(self.reason):
            _refuse(f"{name}, with the reason {self.reason!r}")
        if (self.status is Status.CRASHED) != bool(self.traceback):
            _refuse(f"{name} {'with' if self.traceback else 'without'} a traceback")


JournalRecord = (
    StudyRecord
    | SessionRecord
    | ProposalRecord
    | EvaluationRecord
    | GenerationRecord
    | IdentificationRecord
    | EndRecord
)
_KINDS: dict[str, type[JournalRecord]] = {
    made.kind: made
    for made in (
        StudyRecord,
        SessionRecord,
        ProposalRecord,
        EvaluationRecord,
        GenerationRecord,
        IdentificationRecord,
        EndRecord,
    )
}


def record_of(line: Mapping[str, Any]) -> JournalRecord:
    """Return the record in a line of a journal.

    Raises
    ------
    JournalError
        If its kind is unknown, or it is inconsistent.
    NewerSchemaError
        If a newer version of Palpate wrote it.
    """
    return _KINDS.get(str(line.get("kind")), EvaluationRecord).from_json(line)


def caveats_in(sessions: Iterable[SessionRecord]) -> tuple[str, ...]:
    """Return the caveats shown before every result of a study, from its sessions."""
    stated: list[str] = []
    for session in sessions:
        stated += session.caveats or ()
        if "motion" in session.target:
            words = session.target["motion"]["words"]
            stated.append(f"The target was aligned with the reference: moved by {words}.")
    return tuple(dict.fromkeys(stated))


def _restore_numbers(record: _JournalRecord, *names: str) -> None:
    """Replace "-inf", "inf" and "nan" by numbers in these fields, at any depth."""
    for name in names:
        object.__setattr__(record, name, read_only(to_number(to_plain(getattr(record, name)))))


def _is_count(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _refuse(what: str) -> None:
    raise JournalError(f"this record is inconsistent: {what}")
