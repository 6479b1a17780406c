"""Plug-ins by name: organs, effects, laws, scores, searches, sources and exporters.

Each is an entry point of an installed distribution, Palpate's own among them::

    [project.entry-points."palpate.effects"]
    swelling = "my_lab.swelling:SWELLING"

A plug-in is imported at its first use.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Literal, get_args

from palpate.storage.errors import InputError
from palpate.workers.mechanics.model_parameters import unknown_name

Group = Literal["organs", "effects", "laws", "scores", "searches", "sources", "exporters"]
OWN = "palpate"


@dataclass(frozen=True, slots=True)
class Plugin:
    """Named object provided by a distribution.

    Parameters
    ----------
    group : Group
    name : str
    module, attribute : str
        Location of the object.
    distribution, version : str
        Distribution that provides it.
    """

    group: Group
    name: str
    module: str
    attribute: str
    distribution: str
    version: str

    @property
    def is_own(self) -> bool:
        """Whether the plug-in is part of Palpate."""
        return self.distribution == OWN

    @property
    def words(self) -> str:
        """Name and origin, for a message."""
        return f"{self.name} ({self.group}) of {self.distribution} {self.version}"

    def load(self) -> Any:
        """Import the object.

        Raises
        ------
        InputError
            If its module cannot be imported or lacks the object.
        """
        try:
            return getattr(import_module(self.module), self.attribute)
        except (ImportError, AttributeError) as error:
            raise InputError(
                f"The plug-in {self.words} cannot be imported: {error}. Install a compatible "
                "version, or remove it."
            ) from error


@cache
def plugins(group: Group) -> dict[str, Plugin]:
    """Return the plug-ins of a group by name: Palpate's own first, then by name.

    Raises
    ------
    InputError
        If two distributions provide the same name.
    """
    by_name: dict[str, Plugin] = {}
    for plugin in sorted(_installed(group), key=lambda p: (not p.is_own, p.name)):
        other = by_name.get(plugin.name)
        if other is not None and other != plugin:
            raise InputError(
                f"The name {plugin.name!r} ({group}) is provided by {other.distribution} and by "
                f"{plugin.distribution}. Remove one of them."
            )
        by_name[plugin.name] = plugin
    return by_name


def plugin(group: Group, name: str) -> Plugin:
    """Return the plug-in with this name.

    Raises
    ------
    InputError
        If there is none; similar names are suggested.
    """
    known = plugins(group)
    if name not in known:
        raise InputError(unknown_name(_SINGULAR[group], name, known))
    return known[name]


@cache
def load(group: Group, name: str) -> Any:
    """Return the object of a plug-in; see `plugin` and `Plugin.load`."""
    return plugin(group, name).load()


def foreign_plugins() -> tuple[Plugin, ...]:
    """Return the plug-ins of other distributions, of all groups."""
    return tuple(p for g in get_args(Group) for p in plugins(g).values() if not p.is_own)


def lacking_plugins(wanted: Iterable[Plugin]) -> list[str]:
    """Return descriptions of the plug-ins that this process lacks; sent to workers.

    Another version counts as missing, because its results may differ.
    """
    lacking = []
    for plugin in wanted:
        here = plugins(plugin.group).get(plugin.name)
        if here is None:
            lacking.append(f"lacks the plug-in {plugin.words}")
        elif here.version != plugin.version:
            lacking.append(f"has version {here.version} of the plug-in {plugin.words}")
    return lacking


@cache
def _entry_points() -> Any:
    return entry_points()  # reads the metadata of every distribution


def _installed(group: Group) -> Iterator[Plugin]:
    for point in _entry_points().select(group=f"palpate.{group}"):
        offered = point.dist
        yield Plugin(
            group,
            point.name,
            point.module,
            point.attr,
            "" if offered is None else offered.name,
            "" if offered is None else offered.version,
        )


_SINGULAR: dict[Group, str] = {
    "organs": "organ",
    "effects": "effect",
    "laws": "law",
    "scores": "score",
    "searches": "search strategy",
    "sources": "kind of source",
    "exporters": "file type",
}
