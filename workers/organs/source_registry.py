"""What can be diagnosed or planned, by kind. A module is imported when it is first asked for.

A result of one kind therefore does not depend on the code of another; see
`workers.tasks.code_version`.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from palpate.storage.errors import InputError, StoreError
from palpate.storage.values import Volume
from palpate.workers import plugins
from palpate.workers.diagnosis.outcome.source import (
    FinishedStudy,
    PlannedSource,
    Source,
    SourceContent,
)
from palpate.workers.organs.plugin import SourcePlugin, module_of, resolve
from palpate.workers.organs.registry import organ_names, organ_plugin


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


def source_kinds() -> dict[str, str]:
    """Return what makes a source again from its content, ``"module:class"``, by kind."""
    kinds: dict[str, str] = {}
    for name in plugins.plugins("sources"):
        kinds |= source_plugin(name).kinds
    for organ in map(organ_plugin, organ_names()):
        if organ.study_kind:
            kinds[organ.study_kind] = organ.study_source
    return kinds


def source_plugin(name: str) -> SourcePlugin:
    """Return a plug-in of sources by its name."""
    plugin: SourcePlugin = plugins.load("sources", name)
    return plugin


def file_keys() -> dict[str, str]:
    """Return the model of each file that describes a source, ``"module:class"``, by its name."""
    found = [source_plugin(name) for name in plugins.plugins("sources")]
    return {plugin.file: plugin.keys for plugin in found if plugin.file}


def source_module(kind: str) -> str:
    """Return the dotted name of the module that makes a kind of source.

    Raises
    ------
    StoreError
        If there is no such kind.
    """
    return module_of(_source_class(kind))


def readers() -> Iterator[Reader]:
    """Yield what reads sources from files."""
    for name in plugins.plugins("sources"):
        reader: Reader = resolve(source_plugin(name).reader)
        yield reader


def source_of(content: SourceContent) -> Source:
    """Make a source of a diagnosis again from its content."""
    source: Source = resolve(_source_class(content.kind)).from_content(content)
    return source


def planned_source_of(content: SourceContent) -> PlannedSource:
    """Make a source of a plan again from its content."""
    source: PlannedSource = resolve(_source_class(content.kind)).from_content(content)
    return source


def source_of_study(organ: str, study: FinishedStudy) -> "StudySource":
    """Return the source that a study of an organ is.

    Raises
    ------
    InputError
        If studies of that organ cannot be diagnosed.
    """
    reference = organ_plugin(organ).study_source
    if not reference:
        raise InputError(f"Studies of the organ {organ} cannot be diagnosed.")
    source: StudySource = resolve(reference).from_study(study)
    return source


def _source_class(kind: str) -> str:
    kinds = source_kinds()
    if kind not in kinds:
        raise StoreError(
            f"The store holds a source of the kind {kind!r}, this version knows "
            f"{', '.join(kinds)}: other versions of Palpate share it. `palpate doctor` shows "
            "which."
        )
    return kinds[kind]


class StudySource(Source, PlannedSource, Protocol):
    """A study can be both diagnosed and planned."""
