"""Holds a case with its truth and its answer: all that a score asks for."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from palpate.service.blind.sealed.truth import Group
from palpate.workers.diagnosis.verdict.verdict import NO_GAP, NONE_OF_THESE

Answer = Literal["no-gap", "effect", "cannot-be-told-apart", "none-of-these", "failed"]
FAILED: Answer = "failed"


@dataclass(frozen=True)
class Magnitude:
    """One parameter: what was found, how sure that was, and what is true."""

    name: str
    found: float
    sd: float
    true: float


@dataclass(frozen=True)
class CaseRecord:
    """One case.

    Parameters
    ----------
    name, kind : str
    group : Group
    effects, families : tuple of str
        That truly act, the dominant effect first; see `service.blind.sealed.truth.Cause`.
    answer : str
        The verdict, or "failed" where the diagnosis did not end.
    primary : tuple of str
        Effects accused, the more probable one first.
    primary_families : tuple of str
        Of these.
    set90 : tuple of str
    probabilities : mapping of str to float
        That each effect acts, as far as the data could tell; with "no-gap" and
        "none-of-these".
    family_probabilities : mapping of str to float
        That an effect of the family acts.
    alarm : float or None
        Log evidence against no gap.
    claimed_before_mm, claimed_after_mm : float or None
        Gap beyond noise with the nominal model, and with the effects accused.
    true_before_mm, true_after_mm : float or None
        The same without noise, from the truth; see `service.blind.scoring.true_gap`.
    true_material_mm : float or None
        The first of them, of points that go with the tissue.
    gap_interval_mm, share_interval : tuple of float or None
        In which the gap before and the shrinkage are said to lie with 90 %.
    claimed_share, held_out_share : float or None
        By how much the effects are said to shrink the gap's square: averaged over the causes,
        and with every scan judged by a fit to the others.
    magnitudes : tuple of Magnitude
        Of the true effect, where it was refitted and the truth has the same parameters.
    strength : float or None
        True size of a single effect in standard deviations of its estimate; see
        `service.blind.scoring.magnitudes.strength`.
    lump_apart_mm : float or None
        From the found centre of a lump to the true one.
    accused_by : mapping of str to (str or None)
        Whom the baselines accuse.
    loudness : mapping of str to float
        How loudly each of them does; see `service.blind.answering.baselines`.
    catalogue : int
        How many effects were suspected.
    reason : str
        Why the diagnosis failed.
    """

    name: str
    kind: str
    group: Group
    effects: tuple[str, ...]
    families: tuple[str, ...]
    answer: Answer
    primary: tuple[str, ...] = ()
    primary_families: tuple[str, ...] = ()
    set90: tuple[str, ...] = ()
    probabilities: Mapping[str, float] = field(default_factory=dict)
    family_probabilities: Mapping[str, float] = field(default_factory=dict)
    alarm: float | None = None
    claimed_before_mm: float | None = None
    claimed_after_mm: float | None = None
    true_before_mm: float | None = None
    true_after_mm: float | None = None
    true_material_mm: float | None = None
    gap_interval_mm: tuple[float, float] | None = None
    share_interval: tuple[float, float] | None = None
    claimed_share: float | None = None
    held_out_share: float | None = None
    magnitudes: tuple[Magnitude, ...] = ()
    strength: float | None = None
    lump_apart_mm: float | None = None
    accused_by: Mapping[str, str | None] = field(default_factory=dict)
    loudness: Mapping[str, float] = field(default_factory=dict)
    catalogue: int = 0
    reason: str = ""

    @property
    def silent(self) -> bool:
        """Return whether nothing is to be found: the model lacks nothing that data could show."""
        return self.group in ("control", "absorbed")

    @property
    def named(self) -> bool:
        """Return whether the answer is one effect, or two that act together, without a doubt."""
        return self.answer == "effect"

    @property
    def first(self) -> str | None:
        """Return the effect accused before all others."""
        return self.primary[0] if self.primary else None

    @property
    def right_family(self) -> bool:
        """Return whether the effect accused first is of a true family."""
        return bool(self.primary_families) and self.primary_families[0] in self.families

    @property
    def right_first(self) -> bool:
        """Return whether the effect accused first acts, or is a relative of one that does."""
        return self.right_family if self.group == "relative" else self.first in self.effects

    @property
    def strictly_right(self) -> bool:
        """Return whether somebody is accused, and nobody who does not act."""
        return bool(self.primary) and set(self.primary) <= set(self.effects)

    @property
    def covered(self) -> bool:
        """Return whether the 90 % set holds a true cause: no gap, an effect that acts, or none."""
        return bool(set(self.set90) & set(self.true_causes))

    @property
    def true_causes(self) -> tuple[str, ...]:
        """Return what a perfect diagnosis would be sure of."""
        if self.silent:
            return (NO_GAP,)
        return self.effects or ((NONE_OF_THESE,) if self.group == "unlike" else ())

    @property
    def right(self) -> bool:
        """Return whether the answer is the one that this group of cases asks for."""
        if self.silent:
            return self.answer == NO_GAP
        if self.group == "unlike":
            return self.answer == NONE_OF_THESE
        return self.right_first

    @property
    def is_careful(self) -> bool:
        """Return whether the answer sees a gap and claims no effect as sure."""
        return self.answer in (NONE_OF_THESE, "cannot-be-told-apart")

    @property
    def true_share(self) -> float | None:
        """Return by how much the effects accused truly shrink the gap's square."""
        before, after = self.true_before_mm, self.true_after_mm
        if after is None or not before:
            return None
        return 1 - after**2 / before**2
