"""Numbers with units, of constants and of names with a unit suffix.

As JSON a constant is ``{"value": 10.0, "unit": "kPa"}`` under its name in a study file.
"""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

from palpate.workers.mechanics.parameters import Vocabulary

# Unit suffixes of names, longest first.
SUFFIXES = {"_mm2": "mm2", "_mm": "mm", "_mj": "mJ", "_ml": "ml", "_kpa": "kPa", "_n": "N"}


class Quantity(NamedTuple):
    """A number and its unit in files, "" for a pure number."""

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:.6g} {self.unit}".rstrip()

    def as_json(self) -> dict[str, Any]:
        """Return the record that ``--json`` prints."""
        return {"value": self.value, "unit": self.unit}


def quantities_at_door(vocabulary: Vocabulary, genes: Mapping[str, float]) -> dict[str, Quantity]:
    """Return parameters, with the names and values of a study file, as quantities."""
    return {
        name: Quantity(value, vocabulary.at_door(name).unit.symbol) for name, value in genes.items()
    }


def quantities_inside(
    vocabulary: Vocabulary, constants: Mapping[str, float]
) -> dict[str, Quantity]:
    """Return constants with internal names and units (E_fat, MPa) as in a study file."""
    return {
        vocabulary[name].door_name: Quantity(
            vocabulary[name].unit.to_door(value), vocabulary[name].unit.symbol
        )
        for name, value in constants.items()
    }


def not_neutral(
    vocabulary: Vocabulary, constants: Mapping[str, float], stated: Collection[str] = ()
) -> dict[str, float]:
    """Return the constants that are given or differ from their neutral values.

    Parameters
    ----------
    vocabulary : Vocabulary
    constants : mapping of str to float
        By internal name; one that follows another is neutral if the values are equal.
    stated : collection of str
        Internal names that are always kept.
    """

    def neutral(name: str) -> float:
        parameter = vocabulary[name]
        return constants[parameter.follows] if parameter.neutral is None else parameter.neutral

    return {
        name: value for name, value in constants.items() if name in stated or value != neutral(name)
    }


def quantities_json(quantities: Mapping[str, Quantity]) -> dict[str, Any]:
    """Return quantities as the record that ``--json`` prints."""
    return {name: quantity.as_json() for name, quantity in quantities.items()}


def named_quantity(name: str, value: Any) -> tuple[str, str]:
    """Return the name and text of a value with a unit suffix in its name.

    Examples
    --------
    >>> named_quantity("plate_force_n", 100.0)
    ('plate_force', '100 N')
    >>> named_quantity("cg_iterations", [3, 4])
    ('cg_iterations', '3, 4')
    """
    if isinstance(value, list | tuple):
        return name, ", ".join(map(str, value))
    if isinstance(value, bool):
        return name, "yes" if value else "no"
    suffix = next((s for s in SUFFIXES if name.endswith(s)), "")
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return name.removesuffix(suffix), f"{text} {SUFFIXES.get(suffix, '')}".rstrip()
