"""The truth of a case, and the record that sets an answer beside it.

The truth is the cause with which the case was made, and the displacements of its points. The
record holds what a score needs of both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from palpate.service.blind.sealed_set import read_json
from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.common_keys import validated
from palpate.workers.diagnosis.verdict.cause_selection import NO_GAP, NONE_OF_THESE
from palpate.workers.organs.organ_plugins import catalogue_of

# A blind case is a breast.
CATALOGUE = catalogue_of("breast")
# The effect whose position is scored.
MAPPED = next(e for e in CATALOGUE.effects if e.is_mapped)
CONFOUNDED = {e.name for e in CATALOGUE.effects if e.is_confounded}

Group = Literal["control", "absorbed", "single", "pair", "triple", "unlike", "relative"]
"""The expected answer to a case: none (``control``, ``absorbed``), one effect, two or three, no
effect in the catalogue (``unlike``), or the family of an effect that is not in the catalogue
(``relative``)."""

GROUPS: dict[Group, str] = {
    "control": "nothing missing",
    "absorbed": "hidden in the constants",
    "single": "one effect",
    "pair": "two effects",
    "triple": "three effects",
    "unlike": "unlike any effect",
    "relative": "relative of an effect",
}


class _Record(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Cause(_Record):
    """One deviation of a case.

    Parameters
    ----------
    kind : str
        Name used by the maker of the case.
    effect : str or None
        Name in the catalogue, if it is listed.
    family : str or None
        Family of the effect, or of its relatives in the catalogue.
    parameters : dict
        Magnitudes, with units in their names.
    """

    kind: str
    effect: str | None
    family: str | None
    parameters: dict[str, Any]


class Truth(_Record):
    """The part of ``truth.json`` needed for a score."""

    kind: str
    causes: tuple[Cause, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the acting effects from the catalogue."""
        return tuple(c.effect for c in self.causes if c.effect is not None)

    @property
    def families(self) -> tuple[str, ...]:
        """Return the families of all causes that have one."""
        return tuple(c.family for c in self.causes if c.family is not None)

    @property
    def group(self) -> Group:
        """Return the expected kind of answer."""
        if not self.causes:
            return "control"
        if len(self.effects) < len(self.causes):
            return "relative" if self.families else "unlike"
        if CONFOUNDED.issuperset(self.effects):
            return "absorbed"
        together: tuple[Group, ...] = ("single", "pair", "triple")
        return together[len(self.causes) - 1]


@dataclass(frozen=True, eq=False)
class Moved:
    """Noise-free displacements of the interfaces.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Points on the true interfaces at rest, in mm.
    interface : ndarray of int, shape (k,)
        0 for the outline, 1 for the boundary of the glandular tissue.
    displacement : ndarray, shape (scans, k, 3)
        Displacements in mm.
    """

    points: FloatArray
    interface: IntArray
    displacement: FloatArray


def read_truth(folder: Path) -> Truth:
    """Read the causes of a case.

    Raises
    ------
    InputError
        If the truth is missing or incomplete.
    """
    path = folder / "truth.json"
    return validated(Truth, read_json(path), str(path))


def read_moved(folder: Path) -> Moved:
    """Read the displacements of a case's points.

    Raises
    ------
    InputError
        If the arrays are missing or their shapes do not match.
    """
    path = folder / "truth.npz"
    try:
        with np.load(path) as arrays:
            points, interface = arrays["points"], arrays["interface"]
            displacement = arrays["displacement"]
    except (OSError, KeyError, ValueError) as error:
        raise InputError(
            f"{path} must have points, interface and displacement: {error}."
        ) from error
    k = len(points)
    fits = points.shape == (k, 3) and interface.shape == (k,) and displacement.ndim == 3
    if not fits or displacement.shape[1:] != (k, 3):
        raise InputError(
            f"{path} needs points (k, 3), interface (k,) and displacement (scans, k, 3), found "
            f"{points.shape}, {interface.shape} and {displacement.shape}."
        )
    return Moved(points, interface, displacement)


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
        Effects that act, the dominant one first; see `service.blind.case_truth.Cause`.
    answer : str
        The verdict, or "failed" if the diagnosis did not finish.
    primary : tuple of str
        Named effects in the order of their selection.
    rivals : tuple of str
        Effects that cannot be told apart from the first.
    family_of : mapping of str to str
        Families of the named effects and their rivals.
    gain : float or None
        Gain of the best single effect in log evidence, in nats: of the first named effect, if any.
    something_else : bool
        Whether the diagnosis says that something else acts.
    claimed_before_mm, claimed_after_mm : float or None
        Gap beyond noise with the nominal model, and with the named effects.
    true_before_mm, true_after_mm : float or None
        The same gaps without noise, from the truth; see `service.blind.true_gap`.
    true_material_mm : float or None
        The gap before, at points that move with the tissue.
    gap_interval_mm, share_interval : tuple of float or None
        Stated 90 % intervals of the gap before and of the shrinkage.
    claimed_share, held_out_share : float or None
        Stated reduction of the squared gap by the effects: on the same scans, and with each scan
        predicted by a fit to the others.
    magnitudes : tuple of Magnitude
        Of the true effect, if it was refitted and the truth has the same parameters.
    lump_apart_mm : float or None
        Distance from the estimated centre of a lump to the true one.
    named_by : mapping of str to (str or None)
        The effect named by each baseline.
    loudness : mapping of str to float
        The evidence of each baseline; see `service.blind.set_answering`.
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
    rivals: tuple[str, ...] = ()
    family_of: Mapping[str, str] = field(default_factory=dict)
    gain: float | None = None
    something_else: bool = False
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
        """Return True if the answer is certain: one effect, or several that act together."""
        return self.answer == "effect"

    @property
    def first(self) -> str | None:
        """Return the first named effect."""
        return self.primary[0] if self.primary else None

    @property
    def right_first(self) -> bool:
        """Return True if the first named effect acts, or is a relative of one that does."""
        return self.right_among(self.primary[:1])

    def right_among(self, names: Sequence[str]) -> bool:
        """Return True if one of these effects acts, or is a relative of one that does."""
        if self.group == "relative":
            return any(self.family_of[name] in self.families for name in names)
        return any(name in self.effects for name in names)

    @property
    def complete(self) -> bool:
        """Return True if exactly the acting effects are named."""
        return self.named and set(self.primary) == set(self.effects)

    @property
    def outside(self) -> bool:
        """Return True if the answer is that an effect outside the catalogue acts."""
        return self.answer == NONE_OF_THESE or self.something_else

    @property
    def right(self) -> bool:
        """Return True if the answer is correct for this group of cases."""
        if self.silent:
            return self.answer == NO_GAP
        return self.outside if self.group == "unlike" else self.right_first

    @property
    def true_share(self) -> float | None:
        """Return the true reduction of the squared gap by the named effects."""
        before, after = self.true_before_mm, self.true_after_mm
        if after is None or not before:
            return None
        return 1 - after**2 / before**2
