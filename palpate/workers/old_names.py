"""Old names of keys, which files may still use.

A record in a store keeps its original names, because its digest depends on them;
`with_current_names` reads both, and `with_recorded_names` writes the old ones.
"""

import logging
from collections.abc import Iterator, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, Final

_log = logging.getLogger(__name__)

DIAGNOSIS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "model.nu": "constants.nu",
        "wall.kx_kpa_per_mm": "wall.wall_hold_x_kpa_per_mm",
        "wall.ky_kpa_per_mm": "wall.wall_hold_y_kpa_per_mm",
        "scans.loads[].file": "scans.loads[].volume",
        "constants.eta_kpa": "constants.eta_fat_kpa",
    }
)
"""Keys of a diagnosis, by their old names; ``[]`` means each entry of a list."""

SAME_FIBRES: Final = {"eta_glandular_kpa": "eta_fat_kpa"}
"""Key added to ``eta_fat_kpa`` if both tissues share one value, formerly ``eta_kpa``."""


def with_current_names(data: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Return a diagnosis with the current names of its keys.

    Parameters
    ----------
    data : mapping
        A diagnosis as read from YAML or JSON; it is not modified.
    where : str, optional
        Name of the file, for a log message about each old name; omit it for records in a store.
    """
    tree = _copied(data)
    for old, new in DIAGNOSIS.items():
        if not _moved(tree, old, new):
            continue
        text = new
        if old == "constants.eta_kpa":
            tree["constants"] |= SAME_FIBRES
            text = "constants.eta_fat_kpa, with eta_glandular_kpa: eta_fat_kpa"
        if where:
            _note(where, old, text)
    return tree


def with_recorded_names(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a diagnosis with the key names used in its stored record."""
    tree = _copied(data)
    constants = tree["constants"]
    same = all(constants.get(key) == value for key, value in SAME_FIBRES.items())
    for old, new in DIAGNOSIS.items():
        if old != "constants.eta_kpa" or same:
            _moved(tree, new, old)
    if same:
        for key in SAME_FIBRES:
            del constants[key]
    return tree


@cache
def _note(where: str, old: str, text: str) -> None:
    """Log a note once."""
    _log.warning("%s: %s is now called %s. The old name is still read.", where, old, text)


def _copied(value: Any) -> Any:
    """Return a copy of nested mappings and lists; other values are kept."""
    if isinstance(value, Mapping):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list) else value


def _moved(tree: dict[str, Any], source: str, target: str) -> bool:
    """Move values between paths; return False if the source is empty or the target is not."""
    *above, name = source.split(".")
    *inside, new = target.split(".")
    moved = False
    for place in _places(tree, above):
        if name not in place:
            continue
        goal = place if inside == above else tree.setdefault(inside[0], {})
        if isinstance(goal, dict) and new not in goal:
            goal[new] = place.pop(name)
            moved = True
    return moved


def _places(value: Any, path: list[str]) -> Iterator[dict[Any, Any]]:
    """Yield the mappings at a path."""
    if not path:
        if isinstance(value, dict):
            yield value
        return
    name, *rest = path
    inside = value.get(name.removesuffix("[]")) if isinstance(value, dict) else None
    if not name.endswith("[]"):
        yield from _places(inside, rest)
        return
    for item in inside if isinstance(inside, list) else ():
        yield from _places(item, rest)
