"""What can be diagnosed or planned, by kind. A module is imported when it is first asked for.

A result of one kind therefore does not depend on the code of another; see
`workers.tasks.code_version`.
"""

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Protocol

from palpate.storage.errors import InputError, StoreError
from palpate.storage.values import Volume
from palpate.workers.diagnosis.outcome.source import (
    FinishedStudy,
    PlannedSource,
    Source,
    SourceContent,
)
from palpate.workers.mechanics.parameters import unknown_name

# The module of each kind; it makes the source again from its content.
MODULES = {
    "scanned case": "palpate.workers.organs.breast.case.source",
    "planned case": "palpate.workers.organs.breast.case.source",
    "breast study": "palpate.workers.organs.breast.study_source",
    "cornea study": "palpate.workers.organs.cornea.diagnosis.study_source",
    "specimen": "palpate.workers.organs.specimen.source",
}
# The kind of source that a study of an organ is.
STUDIES = {"breast": "breast study", "cornea": "cornea study"}
# Modules that read sources from files, each with an object READER.
READERS = (
    "palpate.workers.organs.breast.case.files",
    "palpate.workers.organs.specimen.experiment_files",
)


class Reader(Protocol):
    """Reads one kind of source from files."""

    plans: bool
    """Whether further scans of this kind can be planned."""

    def knows(self, path: Path) -> bool:
        """Return whether this kind lies at a path."""

    def read(self, path: Path, stored: Callable[[str], Volume | None]) -> Source:
        """Read what is at a path.

        Parameters
        ----------
        path : Path
        stored : callable
            From the name of a volume in the store to the volume, or None.

        Raises
        ------
        InputError
            If it does not make sense.
        """

    def read_planned(
        self, path: Path, stored: Callable[[str], Volume | None]
    ) -> PlannedSource | None:
        """Read what is known before the loaded scans; None if this kind cannot be planned."""

    def understood(self, path: Path) -> list[tuple[str, str]]:
        """Return what the file was understood to say: names and texts for a reader."""

    def structured(self, path: Path) -> str | None:
        """Return the same as a structured YAML text; None if this kind has no other form."""


def source_module(kind: str) -> str:
    """Return the dotted name of the module that makes a kind of source.

    Raises
    ------
    StoreError
        If there is no such kind.
    """
    if kind not in MODULES:
        raise StoreError(
            f"The store holds a source of the kind {kind!r}, this version knows "
            f"{', '.join(MODULES)}: other versions of Palpate share it. `palpate doctor` shows "
            "which."
        )
    return MODULES[kind]


def readers() -> Iterator[Reader]:
    """Yield what reads sources from files."""
    for module in READERS:
        reader: Reader = import_module(module).READER
        yield reader


def source_of(content: SourceContent) -> Source:
    """Make a source of a diagnosis again from its content."""
    source: Source = import_module(source_module(content.kind)).SOURCES[content.kind](content)
    return source


def planned_source_of(content: SourceContent) -> PlannedSource:
    """Make a source of a plan again from its content."""
    source: PlannedSource = import_module(source_module(content.kind)).SOURCES[content.kind](
        content
    )
    return source


def source_of_study(organ: str, study: FinishedStudy) -> "StudySource":
    """Return the source that a study of an organ is.

    Raises
    ------
    InputError
        If studies of that organ cannot be diagnosed.
    """
    if organ not in STUDIES:
        raise InputError(
            f"A study of this organ cannot be diagnosed: {unknown_name('organ', organ, STUDIES)}"
        )
    source: StudySource = import_module(source_module(STUDIES[organ])).from_study(study)
    return source


class StudySource(Source, PlannedSource, Protocol):
    """A study can be both diagnosed and planned."""
