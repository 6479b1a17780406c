"""The organs by name. An organ is imported when it is first asked for.

A result of one organ therefore does not depend on the code of another.
"""

from importlib import import_module
from typing import Any

from storage.errors import InputError
from workers.mechanics.parameters import unknown_name
from workers.organs.organ import Organ

# The module of each organ; it holds the object ORGAN.
MODULES = {
    "breast": "workers.organs.breast.organ",
    "cornea": "workers.organs.cornea.organ",
}
DEFAULT = "breast"


def organ_module(name: str) -> str:
    """Return the dotted name of an organ's module.

    Raises
    ------
    InputError
        If there is no such organ; close names are suggested.
    """
    if name not in MODULES:
        raise InputError(unknown_name("organ", name, MODULES))
    return MODULES[name]


def organ_named(name: str) -> Organ[Any, Any, Any]:
    """Return an organ.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    organ: Organ[Any, Any, Any] = import_module(organ_module(name)).ORGAN
    return organ
