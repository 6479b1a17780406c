"""Registry of organs by name.

An organ is imported on first use, so a result of one organ does not depend on the code of another.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from palpate.storage.records.tasks import FreeParameter
from palpate.workers import plugins
from palpate.workers.mechanics.pressed import Pressed
from palpate.workers.organs.organ import Organ, PressedOrgan
from palpate.workers.organs.organ_spec import OrganSpec
from palpate.workers.organs.plugin import OrganPlugin, module_of, resolve
from palpate.workers.spec import CaseSpec

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from palpate.workers.mechanics.effects.catalogue import Catalogue

DEFAULT = "breast"


class Findings(Protocol):
    """Findings about a fitted body, with figures of it and of its images."""

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
        """Return the findings of a fitted body as plain values; may be empty.

        ``notes`` are sentences for a reader, ``numbers`` belong to them, ``derived`` are values
        that follow from the constants, ``against`` are the reasons not to quote constants.
        """

    def figures(
        self, spec: Any, bodies: Sequence[Any], findings: Mapping[str, Any]
    ) -> Iterable[tuple["Figure", str]]:
        """Return figures of a study, each with its caption; some of the bodies may be None."""


def organ_names() -> tuple[str, ...]:
    """Return the names of all organs, Palpate's own first."""
    return tuple(plugins.plugins("organs"))


def organ_plugin(name: str) -> OrganPlugin:
    """Return an organ with its capabilities.

    Raises
    ------
    InputError
        If there is none of that name; close names are suggested.
    """
    plugin: OrganPlugin = plugins.load("organs", name)
    return plugin


def organ_modules(name: str) -> tuple[str, str]:
    """Return the dotted names of the modules of an organ and its keys; see `organ_plugin`."""
    plugin = organ_plugin(name)
    return module_of(plugin.organ), module_of(plugin.spec)


def organ_spec(name: str) -> OrganSpec:
    """Return the specification of an organ; see `organ_plugin`."""
    spec: OrganSpec = resolve(organ_plugin(name).spec)
    return spec


def organ_named(name: str) -> Organ[Any, Any, Any]:
    """Return an organ; see `organ_plugin`."""
    organ: Organ[Any, Any, Any] = resolve(organ_plugin(name).organ)
    return organ


def findings_of(organ: str) -> Findings | None:
    """Return the source of an organ's findings; None if it has none."""
    name = organ_plugin(organ).findings
    found: Findings | None = resolve(name) if name else None
    return found


def catalogue_of(organ: str) -> "Catalogue":
    """Return the effects that the model of an organ may lack.

    Raises
    ------
    InputError
        If there is no such organ.
    """
    catalogue: Catalogue = resolve(organ_plugin(organ).effects)
    return catalogue


def pressed_of(case: CaseSpec) -> Pressed | None:
    """Return the compression of a case by plates; None for an organ without plates."""
    organ = organ_named(case.organ)
    return organ.pressed(case) if isinstance(organ, PressedOrgan) else None
