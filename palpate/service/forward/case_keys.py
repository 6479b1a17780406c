"""Cases from flat keys, such as ``nodes=2000, force_n=50, E_fat_kpa=8``, checked as in a file."""

from collections.abc import Mapping
from typing import Any

from palpate.storage.errors import InputError
from palpate.workers.mechanics.parameters import Vocabulary, unknown_name
from palpate.workers.organs.registry import organ_spec
from palpate.workers.spec import CaseSpec, Door, validated


def case_from_keys(organ: str, keys: Mapping[str, Any]) -> CaseSpec:
    """Return the case described by flat keys.

    Parameters
    ----------
    organ : str
    keys : mapping
        Sections of a case (``mesh``), keys of its sections (``nodes``, ``force_n``), and held
        constants (``E_fat_kpa``). Missing keys have the defaults of a study file.

    Raises
    ------
    InputError
        If a key is not valid; the message names each one, with the expected value or the
        nearest known key.

    Examples
    --------
    >>> keys = {"phantom": {"spacing_mm": 2}, "nodes": 900, "force_n": 40, "E_fat_kpa": 8}
    >>> case = case_from_keys("breast", keys)
    >>> case.mesh.nodes, case.load.force_n, case.constants
    (900, 40.0, {'E_fat_kpa': 8.0})
    """
    spec = organ_spec(organ)
    sections = _sections(spec.case)
    homes = {key: name for name, door in sections.items() for key in door.model_fields}
    data: dict[str, Any] = {"organ": organ}
    constants: dict[str, Any] = dict(keys.get("constants") or {})
    for key, value in keys.items():
        if key in homes and key not in sections:
            data.setdefault(homes[key], {})[key] = value
        elif key in sections:
            data[key] = {**value, **data.get(key, {})} if isinstance(value, Mapping) else value
        elif key != "constants":
            constants[key] = value
    known = set(spec.parameters.door_names)
    uncertain = {key for key in constants if key not in known}
    certain = {key: value for key, value in constants.items() if key not in uncertain}
    case = validated(spec.case, data | {"constants": certain}, "The model")
    for key in sorted(uncertain - set(case.vocabulary.door_names)):
        raise InputError(unknown_name("key", key, [*sections, *homes, *case.parameters.door_names]))
    return validated(spec.case, data | {"constants": constants}, "The model")


def stated_constants(case: CaseSpec, given: Mapping[str, float]) -> dict[str, float]:
    """Return constants with internal names and units.

    Raises
    ------
    InputError
        If a name is unknown or not used by the case, or a value is not admissible.
    """
    parameters = case.parameters
    for name in given:
        if name not in parameters.door_names:
            unused = case.unused_parameter(name)
            reason = f" ({unused})" if unused else ""
            raise InputError(f"{unknown_name('constant', name, parameters.door_names)}{reason}")
    return stated_in(parameters, given)


def stated_in(vocabulary: Vocabulary, given: Mapping[str, float]) -> dict[str, float]:
    """Return constants of a vocabulary with internal names and units.

    Raises
    ------
    InputError
        If a name is unknown, or a value is not a number or not admissible.
    """
    return vocabulary.from_door({name: _as_number(name, value) for name, value in given.items()})


def _as_number(name: str, value: Any) -> float:
    """Return the value of a constant as a float.

    Raises
    ------
    InputError
        If it is not a number.
    """
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a number, found {value!r}.") from None


def _sections(case: type[CaseSpec]) -> dict[str, type[Door]]:
    """Return the sections of a case by name."""
    found = {name: field.annotation for name, field in case.model_fields.items()}
    return {n: t for n, t in found.items() if isinstance(t, type) and issubclass(t, Door)}
