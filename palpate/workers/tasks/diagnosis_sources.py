"""Sources of a diagnosis or a plan, read from a path and stored once, by content.

A source is scans, a bench experiment, or the parts of a study's folder that a diagnosis needs. Only
these functions read paths. Tasks receive the kind of a source and the digest of its stored content.
"""

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from palpate.storage.backends.store_paths import Location, StudyLayout
from palpate.storage.best_candidate import best_of
from palpate.storage.errors import InputError
from palpate.storage.journal import Journal
from palpate.storage.journal_records import (
    EvaluationRecord,
    SessionRecord,
    StudyRecord,
    caveats_in,
    record_of,
)
from palpate.storage.json_digests import array_digest, digest, dumps, loads, to_plain
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import find_volume, load_volume
from palpate.storage.values import Volume
from palpate.workers.body.mesh.mesh_hierarchy import check_node_count_of
from palpate.workers.diagnosis.outcome.diagnosis_source import (
    Checkable,
    FinishedStudy,
    HasContent,
    PlannedSource,
    Source,
    SourceContent,
)
from palpate.workers.input_files import check_regular, parse_yaml, read_text, reading
from palpate.workers.organs.organ_plugins import DEFAULT, organ_named
from palpate.workers.organs.plausibility_rule import (
    FIRST_LINE,
    CheckedSource,
    Finding,
    accept,
    caveats_of,
)
from palpate.workers.organs.source_registry import (
    Reader,
    StudySource,
    planned_source_of,
    readers,
    source_of,
    source_of_study,
)
from palpate.workers.tasks.task_store import BodyStore, TaskStore


def is_study(folder: Path) -> bool:
    """Return True if the folder contains a study made by `palpate run`."""
    return StudyLayout(folder).journal.is_file()


def open_study(folder: Path) -> StudySource:
    """Read a study that has run, as the source of a diagnosis.

    Parameters
    ----------
    folder : Path
        Folder of the study. Its store must still contain the volumes that the study was run with.

    Raises
    ------
    InputError
        If there is no study, or none of its evaluations has started.
    JournalError, StoreError
        If the journal or the store is damaged, or a volume is missing.
    """
    layout = StudyLayout(folder)
    if not is_study(folder):
        raise InputError(f"{folder} is not a study: it has no {layout.journal.name}.")
    records = [record_of(line) for line in Journal.read(layout.journal)]
    sessions = [r for r in records if isinstance(r, SessionRecord)]
    studies = [r for r in records if isinstance(r, StudyRecord)]
    evaluations = [r for r in records if isinstance(r, EvaluationRecord)]
    if not sessions or not studies:
        raise InputError(
            f"The study {folder} has not run, so it has no body yet. Run it first with "
            f"`palpate run {folder}`."
        )
    spec = studies[0].spec
    prepared, target = sessions[-1].prepared["volume"], sessions[-1].target["target"]
    organ = spec["case"].get("organ", DEFAULT)
    best = best_of({record.candidate: record for record in evaluations})
    bodies = BodyStore(open_store(sessions[-1].store), organ_named(organ))
    study = FinishedStudy(
        name=spec["name"],
        case=spec["case"],
        target=spec["target"],
        score=spec["score"],
        parameters=spec["search"]["parameters"],
        best={} if best is None else best.genes,
        reference=bodies.body(prepared),
        deformed=bodies.body(target),
        caveats=caveats_in(sessions),
    )
    return source_of_study(organ, study)


@dataclass(frozen=True, slots=True)
class SourceName:
    """A source in a store: its kind, and the digest of its content."""

    kind: str
    digest: str


@dataclass(frozen=True, slots=True)
class StoredContent:
    """The record of a source in the store; its arrays are stored with it.

    Parameters
    ----------
    kind : str
        See `SourceContent`.
    text : str
        The source's own record as JSON.
    volumes : mapping of str to str
        Digests of the volumes, by name.
    """

    kind: str
    text: str
    volumes: Mapping[str, str]


def open_source(path: Path, store: Location | None = None) -> Source:
    """Read the source of a diagnosis from a path.

    Parameters
    ----------
    path : Path
        A case or its folder, the folder of a study that has run, or the file of a bench
        experiment.
    store : str or Path, optional
        Store that contains the volumes named in the case.

    Raises
    ------
    InputError
        If the path cannot be diagnosed.
    """
    with reading(path, "a case or an experiment"):
        check_regular(path)
        if is_study(path):
            return open_study(path)
        refuse_study_file(path)
        reader = _reader_of(path)
        if reader is not None:
            return reader.read(path, volumes_of(store))
    missing = "" if path.exists() else "there is nothing at that path; "
    raise InputError(
        f"{path} cannot be diagnosed: {missing}expected a folder with case.yaml and "
        "its scans, the file of a bench experiment, or the folder of a study made by "
        "`palpate run`. `palpate new diagnosis NAME` writes a case, `palpate new experiment NAME` "
        "an experiment."
    )


def check_source(source: HasContent, *, anyway: bool = False) -> list[Finding]:
    """Check a source of a diagnosis or a plan, before anything is fitted.

    Parameters
    ----------
    source : Source or PlannedSource
    anyway : bool
        Whether to accept implausible inputs.

    Raises
    ------
    InputError
        If the source is rejected; lists all reasons.
    """
    with reading("What is to be diagnosed", "a case or an experiment"):
        if isinstance(source, CheckedSource):
            insisted = any(text.startswith(FIRST_LINE) for text in source.caveats)
            return accept(source.findings(), "The scans", anyway=anyway or insisted)
        if isinstance(source, Checkable):
            source.check()
    return []


def source_caveats(source: HasContent, findings: list[Finding]) -> tuple[str, ...]:
    """Return the caveats shown before the results of a source."""
    own = source.caveats if isinstance(source, CheckedSource) else ()
    return tuple(dict.fromkeys((*own, *caveats_of(findings))))


def volumes_of(store: Location | None) -> Callable[[str], Volume | None]:
    """Return a function that finds volumes in a store by name."""

    def find(name: str) -> Volume | None:
        if store is None:
            return None
        opened = open_store(store)
        digest_of_it = find_volume(opened, name)
        return None if digest_of_it is None else load_volume(opened, digest_of_it)

    return find


def _reader_of(path: Path) -> Reader | None:
    return next((reader for reader in readers() if reader.knows(path)), None)


def understood(path: Path) -> list[tuple[str, str]]:
    """Return the parsed settings of a case or an experiment; empty for a study.

    Raises
    ------
    InputError
        If it is invalid.
    """
    with reading(path, "a case or an experiment"):
        check_regular(path)
        refuse_study_file(path)
        reader = None if is_study(path) else _reader_of(path)
        return [] if reader is None else reader.understood(path)


def is_plannable(path: Path) -> bool:
    """Return True if further scans can be planned for the source at a path."""
    reader = None if is_study(path) else _reader_of(path)
    return is_study(path) or (reader is not None and reader.plans)


def refuse_study_file(path: Path) -> None:
    """Reject a study file, which has to be run before it can be diagnosed or planned.

    Raises
    ------
    InputError
        If the path is a study file.
    """
    if not path.is_file() or path.suffix not in (".yaml", ".yml"):
        return
    try:
        data = parse_yaml(read_text(path), str(path))
    except (OSError, UnicodeDecodeError, InputError):
        return
    if isinstance(data, Mapping) and "case" in data and "search" in data:
        folder = f"runs/{data.get('name', 'NAME')}"
        raise InputError(
            f"{path} is a study file; expected a case, an experiment or the folder of a study "
            f"that has run. Run it with `palpate run {shlex.quote(str(path))}`, then give its "
            "folder: "
            f"{folder}."
        )


def open_planned(path: Path, store: Location | None = None) -> PlannedSource:
    """Read the part of an acquisition that is known before its loaded scans.

    Raises
    ------
    InputError
        If `path` is neither the folder of a case nor that of a study.
    """
    with reading(path, "a case"):
        check_regular(path)
        if is_study(path):
            return open_study(path)
        refuse_study_file(path)
        reader = _reader_of(path)
        planned = None if reader is None else reader.read_planned(path, volumes_of(store))
    if planned is not None:
        return planned
    raise InputError(
        f"{path} cannot be planned: expected a folder with case.yaml and its "
        "reference scan, or the folder of a study that has run."
    )


def check_nodes(nodes: int, source: HasContent) -> None:
    """Reject a mesh that is too coarse for a scanned body, before sending any work to workers.

    Raises
    ------
    InputError
        See `workers.body.mesh.mesh_hierarchy.check_node_count`.
    """
    reference = source.content.volumes.get("reference")
    if reference is not None:
        check_node_count_of(nodes, reference)


def add_source(source: HasContent, store: TaskStore) -> SourceName:
    """Add a source to the store and return its name; existing content is kept.

    Raises
    ------
    StoreError
        If the store cannot be written.
    """
    content = source.content
    volumes = {name: store.add_volume(volume) for name, volume in content.volumes.items()}
    arrays = {name: array_digest(array) for name, array in content.arrays.items()}
    record = to_plain(content.record, finite=True, where=content.kind)
    name = digest("source", content.kind, record, volumes, arrays)
    stored = StoredContent(content.kind, dumps(record), volumes)
    store.save(name, stored, content.arrays)
    return SourceName(content.kind, name)


def stored_source(name: SourceName, store: TaskStore) -> Source:
    """Rebuild a source from the store; cached in each process.

    Raises
    ------
    StoreError
        If the source is not in the store.
    """
    return store.cached(("source", name), lambda: source_of(_content(name, store)))


def stored_planned(name: SourceName, store: TaskStore) -> PlannedSource:
    """Rebuild the part of a source known before the loaded scans; cached in each process.

    Raises
    ------
    StoreError
        If the source is not in the store.
    """
    return store.cached(("planned", name), lambda: planned_source_of(_content(name, store)))


def _content(name: SourceName, store: TaskStore) -> SourceContent:
    stored, arrays = store.load(name.digest, StoredContent)
    volumes = {key: store.volume(volume) for key, volume in stored.volumes.items()}
    return SourceContent(stored.kind, loads(stored.text), volumes, arrays)
