"""Selection of the effects and combinations that are worth a joint fit with the constants."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

from palpate.workers.diagnosis.screening.nominal_analysis import NominalAnalysis
from palpate.workers.diagnosis.screening.screening import screen
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.diagnosis.verdict.hypotheses import MOST_EFFECTS
from palpate.workers.diagnosis.verdict.joint_fit import JointFit
from palpate.workers.mechanics.effects.base import Effect

Catalogue = Mapping[str, Effect]
"""Effects by their names."""

Combination = tuple[Effect, ...]
"""Effects fitted together with the constants."""


def suspects(analysis: NominalAnalysis, known: Catalogue) -> list[Effect]:
    """Return the effects that are worth a joint fit, the most probable first.

    If the nominal model is far off, one effect that the linear model underestimates is added.
    """
    settings = SETTINGS.joint_fits
    visible = [one for one in analysis.screening if not one.hides]
    if not visible:
        return []
    best = visible[0].log_bayes_factor
    least = max(min(best - settings.far_behind, settings.nearly * best), settings.least_gain)
    near = [one for one in visible if one.log_bayes_factor > least][: settings.singles]
    if best > settings.far_off:
        loud = [one for one in visible if one.log_bayes_factor > settings.least_gain]
        steep = (one for one in loud if one not in near and analysis.is_steep(known[one.name]))
        near += [*steep][:1]
    return [known[one.name] for one in near]


def pairs(
    analysis: NominalAnalysis, known: Catalogue, fits: Sequence[JointFit]
) -> list[Combination]:
    """Return pairs that are worth a joint fit.

    These are the best effect with each effect that its residuals support; other effects with the
    effects that their residuals support, if the expected evidence is higher; and all pairs of the
    best effects, if a smooth field explains the residuals of the best one.
    """
    near = ranked(one for one in fits if len(one.effects) == 1)[: SETTINGS.joint_fits.partners]
    if not near:
        return []
    best, *others = near
    own = _extended(analysis, known, best)
    found = {one.names: one.effects for one in own}
    unexplained = _is_unexplained(analysis, best)
    if own or unexplained:
        most = max((one.promise for one in own), default=best.log_evidence)
        more = [one for other in others for one in _extended(analysis, known, other)]
        more = sorted(more, key=lambda one: -one.promise)[: SETTINGS.joint_fits.partners]
        found = {one.names: one.effects for one in more if one.promise > most} | found
    if unexplained:
        for a, b in combinations(near, 2):
            found.setdefault(frozenset((*a.names, *b.names)), (*a.effects, *b.effects))
    return list(found.values())


def triples(
    analysis: NominalAnalysis, known: Catalogue, fits: Sequence[JointFit]
) -> list[Combination]:
    """Return the best two effects with each effect that their residuals support.

    There are no triples if a single effect is better than all pairs.
    """
    best = ranked(one for one in fits if len(one.effects) < MOST_EFFECTS)[:1]
    if not best or len(best[0].effects) < MOST_EFFECTS - 1:
        return []
    extended = _extended(analysis, known, best[0])
    return [one.effects for one in extended[: SETTINGS.joint_fits.thirds]]


def ranked(fits: Iterable[JointFit]) -> list[JointFit]:
    """Return joint fits in order of decreasing evidence."""
    return sorted(fits, key=lambda one: -one.log_evidence)


def near_best(fits: Sequence[JointFit]) -> list[JointFit]:
    """Return the ranked fits that are not far behind the best fit."""
    least = fits[0].log_evidence - SETTINGS.joint_fits.far_behind
    return [one for one in fits if one.log_evidence >= least]


class _Extended(NamedTuple):
    """Fitted effects with one more effect, and the log evidence expected from screening."""

    effects: Combination
    promise: float

    @property
    def names(self) -> frozenset[str]:
        return frozenset(effect.name for effect in self.effects)


def _extended(analysis: NominalAnalysis, known: Catalogue, fitted: JointFit) -> list[_Extended]:
    """Return the extensions of a joint fit by one effect that its residuals support, best first.

    The support is computed from the sensitivities at the nominal fit.
    """
    others = [one for one in analysis.sensitivities if one.name not in fitted.names]
    at = fitted.fit.linearised(analysis.inverse).holding(fitted.fit.at_bound != 0)
    least = SETTINGS.joint_fits.second_gain / analysis.inverse.coarsening
    loud = [one for one in screen(at, others) if not one.hides and one.log_bayes_factor > least]
    return [
        _Extended((*fitted.effects, known[one.name]), fitted.log_evidence + one.log_bayes_factor)
        for one in loud[: SETTINGS.joint_fits.partners]
    ]


def _is_unexplained(analysis: NominalAnalysis, best: JointFit) -> bool:
    """Return True if a smooth field explains the residuals of the best single effect."""
    gain = analysis.noise.field_gain(analysis.hypothesis(best.fit))
    least = SETTINGS.joint_fits.left_over / analysis.inverse.coarsening
    return gain is not None and gain > least
