"""The organs by name. An organ is imported when it is first asked for.

A result of one organ therefore does not depend on the code of another.
"""

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from palpate.storage.errors import InputError
from palpate.storage.records.tasks import FreeParameter
from palpate.workers.mechanics.effects.catalogue import Catalogue
from palpate.workers.mechanics.parameters import unknown_name
from palpate.workers.mechanics.pressed import Pressed
from palpate.workers.organs.organ import Organ
from palpate.workers.spec import CaseSpec

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The module of each organ; it holds the object ORGAN.
MODULES = {
    "breast": "palpate.workers.organs.breast.organ",
    "cornea": "palpate.workers.organs.cornea.organ",
}
DEFAULT = "breast"
# The module of each organ's effects; it holds the object CATALOGUE.
CATALOGUES = {
    "breast": "palpate.workers.organs.breast.effects",
    "cornea": "palpate.workers.organs.cornea.effects",
}
# What is said of a fitted body beside its constants, where an organ has something to say.
FINDINGS = {"cornea": "palpate.workers.organs.cornea.findings.study"}


class Findings(Protocol):
    """Says what a fitted body tells, and draws it and the images it was read from."""

    def findings(
        self,
        model: Any,
        case: Any,
        constants: Mapping[str, float],
        landmarks: Any,
        score: Any,
        body: Any | None = None,
        free: Sequence[FreeParameter] = (),
    ) -> dict[str, Any]:
        """Return the findings of a fitted body as plain values; maybe nothing.

        ``notes`` are sentences for a reader, ``numbers`` belong to them, ``derived`` are values
        that follow from the constants, ``against`` says why constants may not be quoted.
        """

    def figures(
        self, spec: Any, bodies: Sequence[Any], findings: Mapping[str, Any]
    ) -> Iterable[tuple["Figure", str]]:
        """Return figures of a study, each with its caption; of bodies some may be None."""


def catalogue_of(organ: str) -> Catalogue:
    """Return the effects that a diagnosis of an organ may suspect.

    Raises
    ------
    InputError
        If there is no such organ, or it has no effects; close names are suggested.
    """
    if organ not in CATALOGUES:
        raise InputError(unknown_name("organ with effects", organ, CATALOGUES))
    catalogue: Catalogue = import_module(CATALOGUES[organ]).CATALOGUE
    return catalogue


def findings_of(organ: str) -> Findings | None:
    """Return what says more of a fitted body; None for an organ without."""
    name = FINDINGS.get(organ)
    module: Any = None if name is None else import_module(name)
    return module


def pressed_of(case: CaseSpec) -> Pressed | None:
    """Return how plates press the body of a case; None for an organ without plates."""
    pressed = getattr(organ_named(case.organ), "pressed", None)
    found: Pressed | None = None if pressed is None else pressed(case)
    return found


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
