"""Registry of sources of a diagnosis or a plan, by kind.

A module is imported on first use, so a result of one kind does not depend on the code of another;
see `workers.tasks.code_version`.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from palpate.storage.errors import InputError, StoreError
from palpate.storage.values import Volume
from palpate.workers import plugins
from palpate.workers.diagnosis.outcome.diagnosis_source import (
    FinishedStudy,
    PlannedSource,
    Source,
    SourceContent,
)
from palpate.workers.organs.organ_plugins import (
    SourcePlugin,
    module_of,
    organ_names,
    organ_plugin,
    resolve,
)


class Reader(Protocol):
    """A reader of one kind of source from files."""

    plans: bool
    """Whether further scans of this kind can be planned."""

    def knows(self, path: Path) -> bool:
        """Check whether a path is of this kind."""

    def read(self, path: Path, stored: Callable[[str], Volume | None]) -> Source:
        """Read the source at a path.

        Parameters
        ----------
        path : Path
        stored : callable
            Returns a stored volume by its name, or None.

        Raises
        ------
        InputError
            If the source is invalid.
        """

    def read_planned(
        self, path: Path, stored: Callable[[str], Volume | None]
    ) -> PlannedSource | None:
        """Read a source without its loaded scans; None if this kind cannot be planned."""

    def understood(self, path: Path) -> list[tuple[str, str]]:
        """Return the settings as read from the file: names and texts for the user."""


def source_kinds() -> dict[str, str]:
    """Return the class that recreates each kind of source, ``"module:class"``, by kind."""
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
    """Yield the readers of sources."""
    for name in plugins.plugins("sources"):
        reader: Reader = resolve(source_plugin(name).reader)
        yield reader


def source_of(content: SourceContent) -> Source:
    """Recreate a source of a diagnosis from its content."""
    source: Source = resolve(_source_class(content.kind)).from_content(content)
    return source


def planned_source_of(content: SourceContent) -> PlannedSource:
    """Recreate a source of a plan from its content."""
    source: PlannedSource = resolve(_source_class(content.kind)).from_content(content)
    return source


def source_of_study(organ: str, study: FinishedStudy) -> "StudySource":
    """Return a study of an organ as a source.

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
            f"The store holds a source of the kind {kind!r}, but this version knows only "
            f"{', '.join(kinds)}: other versions of Palpate share the store. `palpate doctor` "
            "shows which."
        )
    return kinds[kind]


class StudySource(Source, PlannedSource, Protocol):
    """A study as a source, which can be both diagnosed and planned."""
