"""The rule that names causes: forward selection by gains in log evidence.

1. The effect whose fit gains most over the nominal model is named if it gains enough.
2. A further effect is named if it adds enough to the fit so far, up to three effects.
3. Single effects that gain almost as much as the first cannot be told apart from it, unless a
   further effect is named with it.
4. A smooth field that still gains in addition to the named effects means that something else acts.
   If it gains more than they do, none of these explains the data.

The thresholds are in `diagnosis_settings`, with the bodies on which they were set. An effect that
the constants hide (see `effect_screening.hides`) is neither named nor ruled out.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from palpate.storage.errors import InputError
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS

Kind = Literal["no-gap", "effect", "cannot-be-told-apart", "none-of-these"]

NO_GAP: Final = "no-gap"
NONE_OF_THESE: Final = "none-of-these"
MOST_EFFECTS = 3


@dataclass(frozen=True, slots=True)
class Verdict:
    """The diagnosis of one case.

    Parameters
    ----------
    kind : {"no-gap", "effect", "cannot-be-told-apart", "none-of-these"}
    primary : tuple of str
        The named effects in the order of their selection; empty unless `kind` is "effect" or
        "cannot-be-told-apart".
    rivals : tuple of str
        Effects that cannot be told apart, the best first, which is also the only one in `primary`;
        empty if there is only one.
    gain : float
        Gain of the best single effect over the nominal model, in nats; zero if none gains.
    left_gain : float
        Gain of a smooth field in addition to the selected effects, or to the nominal model.
    hidden : tuple of str
        Effects that the data cannot show.
    """

    kind: Kind
    primary: tuple[str, ...]
    rivals: tuple[str, ...]
    gain: float
    left_gain: float
    hidden: tuple[str, ...]

    @property
    def something_else_acts(self) -> bool:
        """Whether a smooth field still gains clearly in addition to the named effects."""
        return self.left_gain > SETTINGS.selection.left


Gains = Mapping[tuple[str, ...], float]
"""Gains in log evidence over the nominal model, in nats, by the effects of a fit."""


def selected(
    gains: Gains,
    hidden: Collection[str] = (),
    further: float = SETTINGS.selection.further,
    first: float = SETTINGS.selection.first,
) -> tuple[str, ...]:
    """Return the effects that forward selection names, in the order of their selection.

    The first effect must gain more than `first` nats, a further one must add more than `further`.

    Examples
    --------
    >>> selected({("tilt",): 20.0, ("friction",): 4.0, ("tilt", "friction"): 60.0})
    ('tilt', 'friction')
    >>> selected({("tilt",): 20.0, ("tilt", "friction"): 40.0}), selected({("tilt",): 3.0})
    (('tilt',), ())
    """
    gain = 0.0
    chosen: tuple[str, ...] = ()
    while len(chosen) < MOST_EFFECTS:
        longer = {
            effects: value
            for effects, value in gains.items()
            if len(effects) == len(chosen) + 1
            and set(chosen) < set(effects)
            and not set(effects) & set(hidden)
        }
        best = min(longer, key=lambda effects: (-longer[effects], effects), default=None)
        least = further if chosen else first
        if best is None or longer[best] - gain <= least:
            break
        chosen = (*chosen, *(name for name in best if name not in chosen))
        gain = longer[best]
    return chosen


def verdict(
    gains: Gains,
    left_gain: float,
    hidden: Collection[str] = (),
    further: float = SETTINGS.selection.further,
    first: float = SETTINGS.selection.first,
) -> Verdict:
    """Name the causes.

    Parameters
    ----------
    gains : mapping of tuple of str to float
        Gains of all fits, including those with hidden effects.
    left_gain : float
        Gain of a smooth field in addition to the effects that `selected` returns.
    hidden : collection of str
        Effects that the constants hide.
    further, first : float
        See `selected`.

    Raises
    ------
    InputError
        If a fit has more than three effects, or one of them twice.
    """
    for effects in gains:
        if not 0 < len(set(effects)) == len(effects) <= MOST_EFFECTS:
            raise InputError(f"A fit has one to {MOST_EFFECTS} different effects, found {effects}.")
    names = selected(gains, hidden, further, first)
    singles = {who: gain for (who, *more), gain in gains.items() if not more and who not in hidden}
    best = max(singles.values(), default=0.0)
    order = sorted(singles, key=lambda who: (-singles[who], who))
    near = [who for who in order if singles[who] > best - SETTINGS.selection.tie]
    rivals = tuple(near) if len(names) == 1 and len(near) > 1 else ()
    total = max((gain for who, gain in gains.items() if set(who) == set(names)), default=0.0)
    kind: Kind = "cannot-be-told-apart" if rivals else "effect"
    if not names:
        kind = NONE_OF_THESE if left_gain > SETTINGS.selection.left else NO_GAP
    elif left_gain > total:
        kind = NONE_OF_THESE
    if kind == NONE_OF_THESE:
        names, rivals = (), ()
    return Verdict(kind, names, rivals, max(best, 0.0), left_gain, tuple(sorted(hidden)))
