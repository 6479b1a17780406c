"""An organ as one value with its optional capabilities, and the registry of organs by name.

A distribution offers an organ as an entry point of the group ``palpate.organs``. All that is large
is named as ``"module:attribute"`` and imported when it is first used, so no result depends on the
code of another organ, and no evaluation depends on how a study is checked or reported.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from palpate.storage.values import FreeParameter
from palpate.workers import plugins
from palpate.workers.organs.organ_protocol import Organ, OrganSpec

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from palpate.workers.mechanics.effects.effect import Catalogue


@dataclass(frozen=True, slots=True)
class Fact:
    """A fact about a body or its mesh, as shown in a report.

    Parameters
    ----------
    label : str
    key : str
        Key in the result of `Organ.facts`.
    unit : str
    factor : float
        Ratio of the displayed number to the value, such as 100 for a share in per cent.
    """

    label: str
    key: str
    unit: str = ""
    factor: float = 1.0


@dataclass(frozen=True, slots=True)
class OrganPlugin:
    """One organ, and its optional capabilities.

    Parameters
    ----------
    name : str
        The name given under ``organ`` in a case.
    spec : str
        The `workers.organs.organ_protocol.OrganSpec`.
    organ : str
        The `workers.organs.organ_protocol.Organ`.
    checks : str
        The `workers.organs.plausibility_rule.StudyChecks`.
    findings : str
        The module with `workers.organs.organ_plugins.Findings` about a fitted body.
    study_kind : str
        The kind of source of a finished study.
    study_source : str
        The class of that source; empty if its studies cannot be diagnosed.
    effects : str
        The `workers.mechanics.effects.effect.Catalogue` of effects its model may lack.
    load_direction : str
        The direction of the load in a picture, as a sentence.
    facts : tuple of Fact
        Facts about body and mesh in a report.
    templates : mapping of str to str
        Files for ``palpate new``, ``"package:file"``, by name.
    """

    name: str
    spec: str
    organ: str
    checks: str = ""
    findings: str = ""
    study_kind: str = ""
    study_source: str = ""
    effects: str = "palpate.workers.mechanics.effects.effect:NO_EFFECTS"
    load_direction: str = ""
    facts: tuple[Fact, ...] = ()
    templates: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SourcePlugin:
    """A source of diagnoses or plans other than a study.

    A distribution offers it as an entry point of the group ``palpate.sources``.

    Parameters
    ----------
    kinds : mapping of str to str
        The class that recreates the source of each kind of content.
    reader : str
        The `workers.organs.source_registry.Reader` of its files.
    file : str
        The name of its file, such as ``"experiment"``; empty if it has no keys of its own.
    keys : str
        The pydantic model of that file.
    """

    kinds: Mapping[str, str]
    reader: str
    file: str = ""
    keys: str = ""


def module_of(reference: str) -> str:
    """Return the module of ``"module:attribute"``."""
    return reference.partition(":")[0]


def resolve(reference: str) -> Any:
    """Return the object named by ``"module:attribute"``, or a module without an attribute."""
    module, _, attribute = reference.partition(":")
    loaded = import_module(module)
    return getattr(loaded, attribute) if attribute else loaded


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
    return organ_of(organ_plugin(name))


def organ_of(plugin: OrganPlugin) -> Organ[Any, Any, Any]:
    """Return the organ of a plug-in; the defaults are added to one that is no `Organ`."""
    organ = resolve(plugin.organ)
    if isinstance(organ, Organ):
        return organ
    own = {name: getattr(organ, name) for name in dir(organ) if not name.startswith("_")}
    own |= {name: staticmethod(method) for name, method in own.items() if callable(method)}
    completed: type[Organ[Any, Any, Any]] = type(plugin.name, (Organ,), own)
    return completed()


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
