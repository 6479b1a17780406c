"""The reference of the Python interface: public names, signatures and docstrings."""

import inspect
from collections.abc import Iterator
from typing import Any


def public_names() -> Iterator[str]:
    """Yield the lines of the reference."""
    import palpate

    for name in sorted(palpate.__all__, key=str.lower):
        if name.startswith("_"):
            continue
        value = getattr(palpate, name)
        yield f"### {name}\n"
        yield _block(name, value)
        if inspect.isclass(value) and value.__module__.startswith("palpate"):
            for member, function in inspect.getmembers(value, _is_public):
                if member.startswith("_") or member not in _own(value):
                    continue
                yield f"#### {name}.{member}\n"
                yield _block(member, function)


def _own(value: type) -> set[str]:
    """Return the members of a class, including those inherited from `SimulationRecord`."""
    from palpate.service.simulation.simulation_record import SimulationRecord

    base = vars(SimulationRecord) if issubclass(value, SimulationRecord) else {}
    return {*vars(value), *base}


def _block(name: str, value: Any) -> str:
    return f"```\n{_signature(name, value)}\n\n{inspect.getdoc(value) or ''}\n```\n"


def _is_public(value: Any) -> bool:
    return inspect.isfunction(value) or inspect.ismethod(value) or isinstance(value, property)


def _signature(name: str, value: Any) -> str:
    if isinstance(value, property):
        return name
    try:
        return f"{name}{inspect.signature(value)}"
    except (TypeError, ValueError):
        return name
