"""A case with its truth and its answer, as needed for a score."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from palpate.service.blind.sealed.truth import Group
from palpate.workers.diagnosis.verdict.verdict import NO_GAP, NONE_OF_THESE

Answer = Literal["no-gap", "effect", "cannot-be-told-apart", "none-of-these", "failed"]
FAILED: Answer = "failed"


@dataclass(frozen=True)
class Magnitude:
    """One parameter: the estimate, its standard deviation, and the true value."""

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
        Effects that act, the dominant one first; see `service.blind.sealed.truth.Cause`.
    answer : str
        The verdict, or "failed" if the diagnosis did not finish.
    primary : tuple of str
        Named effects, the most probable one first.
    primary_families : tuple of str
        Families of these effects.
    set90 : tuple of str
    probabilities : mapping of str to float
        Probability that each effect acts, as far as the data can tell; with "no-gap" and
        "none-of-these".
    family_probabilities : mapping of str to float
        Probability that an effect of the family acts.
    alarm : float or None
        Log evidence against no gap.
    claimed_before_mm, claimed_after_mm : float or None
        Gap beyond noise with the nominal model, and with the named effects.
    true_before_mm, true_after_mm : float or None
        The same gaps without noise, from the truth; see `service.blind.scoring.true_gap`.
    true_material_mm : float or None
        The gap before, at points that move with the tissue.
    gap_interval_mm, share_interval : tuple of float or None
        Stated 90 % intervals of the gap before and of the shrinkage.
    claimed_share, held_out_share : float or None
        Stated reduction of the squared gap by the effects: averaged over the causes, and with
        each scan predicted by a fit to the others.
    magnitudes : tuple of Magnitude
        Of the true effect, if it was refitted and the truth has the same parameters.
    strength : float or None
        True size of a single effect in standard deviations of its estimate; see
        `service.blind.scoring.magnitudes.strength`.
    lump_apart_mm : float or None
        Distance from the estimated centre of a lump to the true one.
    named_by : mapping of str to (str or None)
        The effect named by each baseline.
    loudness : mapping of str to float
        The evidence of each baseline; see `service.blind.answering.baselines`.
    catalogue : int
        Number of candidate effects.
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
    named_by: Mapping[str, str | None] = field(default_factory=dict)
    loudness: Mapping[str, float] = field(default_factory=dict)
    catalogue: int = 0
    reason: str = ""

    @property
    def silent(self) -> bool:
        """Return True if the model lacks nothing that data could reveal."""
        return self.group in ("control", "absorbed")

    @property
    def named(self) -> bool:
        """Return True if the answer is certain: an effect, or two that act together."""
        return self.answer == "effect"

    @property
    def first(self) -> str | None:
        """Return the first named effect."""
        return self.primary[0] if self.primary else None

    @property
    def right_family(self) -> bool:
        """Return True if the first named effect is in a true family."""
        return bool(self.primary_families) and self.primary_families[0] in self.families

    @property
    def right_first(self) -> bool:
        """Return True if the first named effect acts, or is a relative of one that does."""
        return self.right_family if self.group == "relative" else self.first in self.effects

    @property
    def strictly_right(self) -> bool:
        """Return True if at least one effect is named, and every named effect acts."""
        return bool(self.primary) and set(self.primary) <= set(self.effects)

    @property
    def covered(self) -> bool:
        """Return True if the 90 % set includes a true cause: no gap, an acting effect, or none."""
        return bool(set(self.set90) & set(self.true_causes))

    @property
    def true_causes(self) -> tuple[str, ...]:
        """Return the causes to which a perfect diagnosis would give probability one."""
        if self.silent:
            return (NO_GAP,)
        return self.effects or ((NONE_OF_THESE,) if self.group == "unlike" else ())

    @property
    def right(self) -> bool:
        """Return True if the answer is correct for this group of cases."""
        if self.silent:
            return self.answer == NO_GAP
        if self.group == "unlike":
            return self.answer == NONE_OF_THESE
        return self.right_first

    @property
    def is_careful(self) -> bool:
        """Return True if the answer reports a gap but is not sure of any effect."""
        return self.answer in (NONE_OF_THESE, "cannot-be-told-apart")

    @property
    def true_share(self) -> float | None:
        """Return the true reduction of the squared gap by the named effects."""
        before, after = self.true_before_mm, self.true_after_mm
        if after is None or not before:
            return None
        return 1 - after**2 / before**2
