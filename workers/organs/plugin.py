"""An organ as one value: the organ itself, and what else Palpate can do with it.

A distribution offers it as an entry point of the group ``palpate.organs``. All that is large is
named as ``"module:attribute"`` and imported when it is first used, so no result depends on the
code of another organ, and no evaluation on how a study is checked or reported.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any


@dataclass(frozen=True, slots=True)
class Fact:
    """A fact of a body or its mesh, as a report shows it.

    Parameters
    ----------
    label : str
    key : str
        In what `Organ.facts` returns.
    unit : str
    factor : float
        From the value to what is shown, such as 100 for a share in per cent.
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
        What a case states under ``organ``.
    spec : str
        The `workers.organs.organ_spec.OrganSpec`.
    organ : str
        The `workers.organs.organ.Organ`.
    checks : str
        `workers.organs.study_checks.StudyChecks`: whether the input is plausible.
    findings : str
        The module that follows `workers.organs.registry.Findings`: what a fitted body tells.
    study_kind : str
        The kind of source that a finished study is.
    study_source : str
        From a finished study to its source; None if its studies cannot be diagnosed.
    effects : str
        The `workers.mechanics.effects.catalogue.Catalogue` of what its model may lack.
    load_direction : str
        How the load acts in a picture, as a sentence.
    facts : tuple of Fact
        What a report says of body and mesh.
    templates : mapping of str to str
        Files for ``palpate new``: from their name to ``"package:file"``.
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
    """Something that can be diagnosed or planned without being a study.

    A distribution offers it as an entry point of the group ``palpate.sources``.

    Parameters
    ----------
    kinds : mapping of str to str
        From each kind of content to what makes its source again.
    reader : str
        What reads a source from files; see `workers.organs.source_registry.Reader`.
    file : str
        What its file is called, such as ``"experiment"``; empty where it has no keys of its own.
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
    """Return the object that ``"module:attribute"`` names; a module where no attribute is named."""
    module, _, attribute = reference.partition(":")
    loaded = import_module(module)
    return getattr(loaded, attribute) if attribute else loaded
