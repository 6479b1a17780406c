"""Laws of a breast's tissues, by name, and their shape constants."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants
from palpate.workers.mechanics.materials.law_plugins import (
    DEFAULT_LAW,
    law_named,
    law_of_constant,
)
from palpate.workers.mechanics.parameters import Vocabulary
from palpate.workers.organs.breast.effects import CATALOGUE
from palpate.workers.plugins import plugin
from palpate.workers.spec import Door, LawName, checked_name

LAW_TISSUES = ("fat", "glandular")
NO_STIFFENING = (
    "strain stiffening",
    "the file chooses a law for every tissue: its shape constants define how the tissue stiffens",
)


class TissueLaws(Door):
    """The law of each tissue, without its fibres; ligaments and muscle use the law of fat.

    Parameters
    ----------
    fat, glandular : str
        Name of a law; `palpate parameters` lists them.
    """

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
            Constants of a neo-Hookean tissue.
        values : mapping of str to float
            Shape constants by their internal names; neutral if missing.
        """
        name = self.by_tissue[tissue]
        if name == DEFAULT_LAW:
            return own
        return replace(own, law=law_named(name).law(own.mu_mpa, values, tissue))

    @property
    def suspects(self) -> tuple[Effect, ...]:
        """The effects that may be missing from a model with these laws."""
        return tuple(e for e in CATALOGUE.effects if self.can_stiffen or not e.is_in_law)

    @property
    def not_simulated(self) -> tuple[tuple[str, str], ...] | None:
        """Causes that cannot be simulated, with reasons; None for the list of the catalogue."""
        return None if self.can_stiffen else (*CATALOGUE.not_simulated, NO_STIFFENING)

    def reason_against(self, name: str) -> str:
        """Return the reason against using a parameter with these laws, or ""."""
        in_law = {n for e in CATALOGUE.effects if e.is_in_law for n in e.names}
        if name in in_law and not self.can_stiffen:
            return NO_STIFFENING[1]
        if name in self.constants.door_names or name not in shape_constants([name]).door_names:
            return ""
        law, tissue = law_of_constant(name), next(t for t in LAW_TISSUES if name.endswith(t))
        return f"it belongs to the law {law}, but the law of {tissue} is {self.by_tissue[tissue]}"


def for_all_tissues(given: Any) -> Any:
    """Apply the name of a single law to all tissues.

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


def shape_constants(names: Iterable[str]) -> Vocabulary:
    """Return all shape constants of the laws named at the start of these constants.

    Raises
    ------
    InputError
        If a law cannot be imported.
    """
    laws = dict.fromkeys(law_of_constant(name) for name in names)
    return Vocabulary(
        p for law in laws if law for t in LAW_TISSUES for p in law_named(law).constants(t)
    )
