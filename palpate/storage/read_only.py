"""Arrays, mappings and lists that their holder cannot change.

What a caller gives to the public interface is copied, and what a result hands out is read-only:
later changes reach neither a finished result nor the next simulation. Arrays become views, so that
nothing large is copied.

Frozen mappings and lists equal plain ones, are written as JSON and pickled like them, and their
``copy``, ``|`` and ``+`` return plain ones.
"""

from dataclasses import fields, is_dataclass
from types import MappingProxyType
from typing import Any, NoReturn, TypeVar

import numpy as np

T = TypeVar("T")
K = TypeVar("K")
V = TypeVar("V")


def _refuse(self: Any, *_: Any, **__: Any) -> NoReturn:
    kind = "mapping" if isinstance(self, dict) else "list"
    raise TypeError(
        f"This {kind} belongs to a study, a model or a result and is read-only. Change a copy, "
        f"{'dict' if kind == 'mapping' else 'list'}(...), and create a new object from it."
    )


_refused: Any = _refuse


class FrozenDict(dict[K, V]):
    """Dictionary that cannot be changed."""

    __slots__ = ()

    __setitem__ = __delitem__ = __ior__ = _refused
    clear = pop = popitem = setdefault = update = _refused

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)


class FrozenList(list[V]):
    """List that cannot be changed."""

    __slots__ = ()

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refused
    append = clear = extend = insert = pop = remove = reverse = sort = _refused

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (list(self),)


def read_only(value: T) -> T:
    """Return a value whose arrays, mappings and lists, at any depth, cannot be changed.

    Arrays become views; objects of other types are returned as they are.

    Examples
    --------
    >>> bounds = read_only({"E_fat_kpa": [5, 20]})
    >>> bounds == {"E_fat_kpa": [5, 20]}, bounds | {"nu": [0.45, 0.49]}
    (True, {'E_fat_kpa': [5, 20], 'nu': [0.45, 0.49]})
    """
    frozen: Any = value
    if isinstance(value, np.ndarray):
        frozen = value.view()
        frozen.flags.writeable = False
    elif isinstance(value, (dict, MappingProxyType)):
        frozen = FrozenDict({key: read_only(item) for key, item in value.items()})
    elif isinstance(value, list):
        frozen = FrozenList([read_only(item) for item in value])
    elif isinstance(value, tuple) and type(value) is tuple:  # a named tuple stays
        frozen = tuple([read_only(item) for item in value])
    return frozen


def hold_read_only(record: Any) -> None:
    """Make the fields of a dataclass, or the attributes of another object, read-only."""
    names = [f.name for f in fields(record)] if is_dataclass(record) else list(vars(record))
    for name in names:
        object.__setattr__(record, name, read_only(getattr(record, name)))


class ReadOnly:
    """Base of frozen dataclasses whose arrays, mappings and lists are read-only.

    Copies and pickles are read-only, too.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        hold_read_only(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        hold_read_only(self)
