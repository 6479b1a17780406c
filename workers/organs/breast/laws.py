"""The laws of a breast's tissues, by name, and their shape constants."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.effects.material import STIFFENING
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants
from palpate.workers.mechanics.materials.law_plugins import (
    DEFAULT_LAW,
    law_named,
    law_of_constant,
)
from palpate.workers.mechanics.parameters import Vocabulary
from palpate.workers.plugins import plugin
from palpate.workers.spec import Door, checked_name

LAW_TISSUES = ("fat", "glandular")
NO_STIFFENING = (
    "strain stiffening",
    "the file chooses a law for every tissue: its shape constants say how the tissue stiffens",
)

LawName = Annotated[str, AfterValidator(lambda name: checked_name("laws", name))]


class TissueLaws(Door):
    """The law of each tissue, without its fibres; ligaments and muscle follow that of fat."""

    fat: LawName = Field(default=DEFAULT_LAW, description="neo-hookean, yeoh, fung, ...")
    glandular: LawName = DEFAULT_LAW

    @property
    def by_tissue(self) -> dict[str, str]:
        """The names of the laws by tissue."""
        return {"fat": self.fat, "glandular": self.glandular}

    @property
    def is_default(self) -> bool:
        """Whether all tissues are neo-Hookean."""
        return set(self.by_tissue.values()) == {DEFAULT_LAW}

    @property
    def can_stiffen(self) -> bool:
        """Whether the effect of strain stiffening acts on a tissue: on a neo-Hookean one."""
        return DEFAULT_LAW in self.by_tissue.values()

    @property
    def modules(self) -> tuple[str, ...]:
        """The modules of the laws, for digests."""
        return tuple(sorted({plugin("laws", name).module for name in self.by_tissue.values()}))

    @property
    def constants(self) -> Vocabulary:
        """The shape constants of these laws."""
        return Vocabulary(
            p for tissue, name in self.by_tissue.items() for p in law_named(name).constants(tissue)
        )

    @property
    def text(self) -> str:
        """The laws in words: ``neo-Hookean``, or ``Yeoh in fat, ...``."""
        labels = {tissue: law_named(name).label for tissue, name in self.by_tissue.items()}
        if len(set(labels.values())) == 1:
            return labels["fat"]
        return f"{labels['fat']} in fat, {labels['glandular']} in glandular tissue"

    def applied(self, tissue: str, own: Constants, values: Mapping[str, float]) -> Constants:
        """Return the constants of a tissue with its law.

        Parameters
        ----------
        tissue : str
            One of `LAW_TISSUES`.
        own : Constants
            Of a neo-Hookean tissue.
        values : mapping of str to float
            Shape constants by their names inside; neutral where it names none.
        """
        name = self.by_tissue[tissue]
        if name == DEFAULT_LAW:
            return own
        return replace(own, law=law_named(name).law(own.mu_mpa, values, tissue))

    def suspects(self, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """Return the effects that can act on bodies of these laws."""
        return effects if self.can_stiffen else tuple(e for e in effects if e is not STIFFENING)

    def reason_against(self, name: str) -> str:
        """Return why a parameter cannot be used with these laws, or ""."""
        if name in STIFFENING.names and not self.can_stiffen:
            return NO_STIFFENING[1]
        law = law_of_constant(name, LAW_TISSUES)
        if not law or name in self.constants.door_names:
            return ""
        tissue = next(t for t in LAW_TISSUES if name.endswith(t))
        return f"it belongs to the law {law}, but the law of {tissue} is {self.by_tissue[tissue]}"


def for_all_tissues(given: Any) -> Any:
    """Let the name of one law stand for all tissues.

    Raises
    ------
    ValueError
        If there is no such law.
    """
    if isinstance(given, str):
        return dict.fromkeys(LAW_TISSUES, checked_name("laws", given))
    return given


Laws = Annotated[
    TissueLaws, BeforeValidator(for_all_tissues, json_schema_input_type=str | TissueLaws)
]


def shape_constants(names: Mapping[str, Any]) -> Vocabulary:
    """Return the shape constants that some of these names are, of whatever law.

    Raises
    ------
    InputError
        If a law cannot be imported.
    """
    found = {}
    for name in names:
        law = law_of_constant(name, LAW_TISSUES)
        for tissue in LAW_TISSUES if law else ():
            found |= {p.door_name: p for p in law_named(law).constants(tissue)}
    return Vocabulary(found[name] for name in names if name in found)

