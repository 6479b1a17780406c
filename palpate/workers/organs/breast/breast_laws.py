"""Laws of a breast's tissues: their names, shape constants, defaults and descriptions.

The defaults hold for every study, diagnosis and plan that specifies no other physics. A blind set
gives its law in its files and has no defaults.

The fibres depend on their full stretch, ``I4``, as in the published law and in every study so far;
the isochoric part, ``I4bar``, must be specified.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from palpate.storage.values import Triple
from palpate.workers.common_keys import Door, LawName, checked_name
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import WALL_TO_NIPPLE, Constants
from palpate.workers.mechanics.materials.law_plugins import DEFAULT_LAW, law_named, law_of_constant
from palpate.workers.mechanics.model_parameters import BREAST, Vocabulary
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from palpate.workers.plugins import plugin

Law = Literal["neo-hookean", "fibre-neo-hookean"]
Fibres = Literal["tension-only", "literal"]
FibreInvariant = Literal["I4", "isochoric"]
Skin = Literal["none", "membrane", "layer"]

LAW: Law = "fibre-neo-hookean"
FIBRES: Fibres = "tension-only"
FIBRE_INVARIANT: FibreInvariant = "I4"
FIBRE_DIRECTION: Triple = WALL_TO_NIPPLE.axis
SKIN: Skin = "none"
SKIN_THICKNESS_MM = 1.5
NU: float = BREAST.complete()["nu"]
# The body slides along the chest wall and cannot move away from it.
WALL_HELD = False
WALL_SPRING_KPA_PER_MM = 0.0


def law_text(
    fibres: str, fibre_invariant: str, direction: Triple, matrix: str = "neo-Hookean"
) -> str:
    """Describe the law of tissue with fibres.

    Examples
    --------
    >>> law_text("tension-only", "I4", (0.0, 0.0, 1.0))
    'neo-Hookean, fibres along (0, 0, 1) that act in tension only, full (I4) stretch'
    """
    pulled = "in tension only" if fibres == "tension-only" else "in compression as well"
    stretch = "isochoric" if fibre_invariant == "isochoric" else "full (I4)"
    along = ", ".join(f"{c:g}" for c in direction)
    return f"{matrix}, fibres along ({along}) that act {pulled}, {stretch} stretch"


def wall_text(held: bool, kx_kpa_per_mm: float, ky_kpa_per_mm: float) -> str:
    """Describe the support of the body at the chest wall.

    Examples
    --------
    >>> wall_text(False, 0.0, 0.0)
    'held along z, slides along x and y'
    """
    if held:
        return "held in all directions"
    if not kx_kpa_per_mm and not ky_kpa_per_mm:
        return "held along z, slides along x and y"
    springs = f"springs of {kx_kpa_per_mm:g} kPa/mm along x and {ky_kpa_per_mm:g} kPa/mm along y"
    return f"held along z, {springs}"


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

    @cached_property
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
