"""An organ as one value, with its optional capabilities.

A distribution offers it as an entry point of the group ``palpate.organs``. All that is large is
named as ``"module:attribute"`` and imported when it is first used, so no result depends on the
code of another organ, and no evaluation depends on how a study is checked or reported.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any


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
        The `workers.organs.organ_spec.OrganSpec`.
    organ : str
        The `workers.organs.organ.Organ`.
    checks : str
        The `workers.organs.study_checks.StudyChecks`.
    findings : str
        The module with `workers.organs.registry.Findings` about a fitted body.
    study_kind : str
        The kind of source of a finished study.
    study_source : str
        The class of that source; empty if its studies cannot be diagnosed.
    effects : str
        The `workers.mechanics.effects.catalogue.Catalogue` of effects its model may lack.
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
    effects: str = "palpate.workers.mechanics.effects.catalogue:NO_EFFECTS"
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
