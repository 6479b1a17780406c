"""Expected information of a planned acquisition, and the benefit of further measurements.

No residuals are used. An effect is *detectable* (`seen`) if, at its plausible size, it is expected
to raise the log evidence over no gap by at least `clear` in the plan's settings, and if the
constants do not hide it. Two effects are *distinguishable* (`apart`) if both are detectable and
each, when it acts, is expected to beat the other by the same margin. Further rows never lower an
expected log evidence, because it is a Kullback-Leibler divergence; see
`workers.diagnosis.planning.state_information`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag

from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.algebra.linearisation import Linearised, factored
from palpate.workers.diagnosis.planning.load_sensitivity import LoadSensitivity
from palpate.workers.diagnosis.planning.state_information import (
    Detectability,
    detectability,
    separation,
)
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem, Scan, Values
from palpate.workers.diagnosis.problem.noise_parts import planned_covariance
from palpate.workers.diagnosis.screening.detectability import confusion
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.mechanics.effects.base import Effect, one_sided
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem


@dataclass(frozen=True, slots=True)
class Design:
    """A set of scans and measurements.

    Parameters
    ----------
    states : tuple of int
        Indices of the loads.
    drawings : int
        Number of independent segmentations of each scan.
    plates : bool
        Whether the distance between the plates is measured under each load.
    known : int or None
        Index of a constant that is measured separately.
    """

    states: tuple[int, ...]
    drawings: int = 1
    plates: bool = False
    known: int | None = None


@dataclass(frozen=True, eq=False)
class DesignEvaluation:
    """Expected information of a design.

    Parameters
    ----------
    rows : tuple of Detectability
        Row for each effect.
    evidence : ndarray, shape (effects,)
        Expected log Bayes factor of each effect, at its plausible size, against no gap.
    cosines : ndarray, shape (effects, effects)
        Similarity of the visible parts of each pair of effects.
    separation : ndarray, shape (effects, effects)
        Expected log Bayes factor of the row's effect, when it acts, against the column's effect.
    shown : frozenset of str
        Effects already detectable in a part of the design: further measurements do not hide them,
        although they may raise the share that the constants absorb.
    """

    rows: tuple[Detectability, ...]
    evidence: FloatArray
    cosines: FloatArray
    separation: FloatArray
    shown: frozenset[str] = frozenset()

    @property
    def names(self) -> list[str]:
        """Names of the effects, in order."""
        return [row.name for row in self.rows]

    @property
    def seen(self) -> BoolArray:
        """Mask of the detectable effects, which can be named or ruled out, shape (effects,)."""
        return (self.evidence >= SETTINGS.plan.clear) & ~self.hidden

    @property
    def hidden(self) -> BoolArray:
        """Mask of the effects that the constants absorb, shape (effects,)."""
        sunk = [
            row.absorbed > SETTINGS.detectability.sunk_share and row.name not in self.shown
            for row in self.rows
        ]
        mostly = np.array(
            [row.absorbed > SETTINGS.detectability.hidden_share for row in self.rows], np.bool_
        )
        return np.array(sunk, np.bool_) | (mostly & (self.evidence < SETTINGS.plan.clear))

    def apart(self) -> set[frozenset[str]]:
        """Return the pairs of effects that can be distinguished."""
        return {pair for pair, worst in self.pairs().items() if worst >= SETTINGS.plan.clear}

    def pairs(self) -> dict[frozenset[str], float]:
        """Return the smaller expected log Bayes factor of each pair of detectable effects."""
        index = np.flatnonzero(self.seen)
        return {
            frozenset((self.names[i], self.names[j])): float(
                min(self.separation[i, j], self.separation[j, i])
            )
            for i, j in combinations(index, 2)
        }


def evaluate_design(
    unloaded: InverseProblem,
    design: Design,
    load_sensitivities: Mapping[int, LoadSensitivity],
    effects: Sequence[Effect],
) -> DesignEvaluation:
    """Return the expected information of a design about `effects`.

    Parameters
    ----------
    unloaded : InverseProblem
        See `workers.diagnosis.problem.acquisition.inverse_problem_of`.
    design : Design
    load_sensitivities : mapping of int to LoadSensitivity
        Sensitivities of at least every state in the design.
    effects : sequence of Effect
        Effects with columns in every state.

    Raises
    ------
    InputError
        If the columns and the points do not match.
    """
    problem, sensitivities = assembled(unloaded, design, load_sensitivities, effects)
    nothing = EffectSensitivity(
        "nothing", "", np.zeros((problem.size, 1)), np.ones(1), np.zeros(1, np.bool_)
    )
    table = separation(problem, [*sensitivities, nothing])
    return DesignEvaluation(
        detectability(problem, sensitivities),
        table[:-1, -1],
        confusion(problem, sensitivities),
        table[:-1, :-1],
    )


def assembled(
    unloaded: InverseProblem,
    design: Design,
    load_sensitivities: Mapping[int, LoadSensitivity],
    effects: Sequence[Effect],
) -> tuple[Linearised, list[EffectSensitivity]]:
    """Return the linear problem of a design at the prior mean, and its sensitivities."""
    parts = [load_sensitivities[s] for s in design.states]
    k = len(unloaded.points)
    plates = range(len(parts)) if design.plates else range(0)

    def rows(of: Sequence[FloatArray]) -> FloatArray:
        """Return the rows of all points in all states, then the plate distances."""
        last = [of[s][..., k:, :] for s in plates]
        return np.concatenate([*(c[..., :k, :] for c in of), *last], axis=-2)

    nominal = rows([part.nominal for part in parts])
    blocks = [_scanned(unloaded, design), SETTINGS.plan.plates_sd_mm**2 * np.eye(len(plates))]
    sensitivities = [_print(e, rows([part.columns[e.name] for part in parts])) for e in effects]
    p = nominal.shape[1]
    if design.known is not None:
        # A constant that is measured separately has its own row, unaffected by effects.
        nominal = np.vstack([nominal, np.eye(p)[design.known]])
        blocks.append(np.array([[SETTINGS.plan.stiffness_sd**2]]))
        sensitivities = [replace(f, columns=_with_zeros(f.columns)) for f in sensitivities]
    problem = Linearised(
        np.zeros(len(nominal)),
        nominal,
        np.array([f.log_sd for f in unloaded.free]),
        np.zeros(p),
        factored(np.asarray(block_diag(*blocks))),
    )
    return problem, sensitivities


def simulated(
    load_sensitivities: Iterable[LoadSensitivity], effects: Sequence[Effect]
) -> list[Effect]:
    """Return the effects that could be simulated in every state and act on at least one."""
    states = list(load_sensitivities)
    return [
        e
        for e in effects
        if all(e.name in f.columns for f in states) and any(f.columns[e.name].any() for f in states)
    ]


def loose(load_sensitivities: Iterable[LoadSensitivity], effects: Sequence[Effect]) -> list[Effect]:
    """Return the effects that would push the body away from its supports.

    At their plausible size, a point would move by more than `drift_mm` in the settings.
    """
    states = list(load_sensitivities)
    return [
        e
        for e in effects
        if any(
            np.abs(f.columns[e.name] * np.array(plausible(e))).max() > SETTINGS.plan.drift_mm
            for f in states
        )
    ]


def plausible(effect: Effect) -> tuple[float, ...]:
    """Return the prior standard deviations of an effect's size parameters."""
    return effect.prior_sd[: effect.size_count]


def _scanned(unloaded: InverseProblem, design: Design) -> FloatArray:
    """Return the noise covariance of all states, as used in a diagnosis, in mm^2.

    Errors of independent segmentations average out; the voxel error remains.
    """
    calmer = 1 / np.sqrt(design.drawings)
    noise = replace(
        unloaded.noise,
        sd_mm=calmer * unloaded.noise.sd_mm,
        reference_sd_mm=calmer * unloaded.noise.reference_sd_mm,
    )
    inverse = replace(
        unloaded,
        noise=noise,
        scans=[_NOISE_ONLY] * len(design.states),
    )
    return planned_covariance(inverse)


def _print(effect: Effect, columns: FloatArray) -> EffectSensitivity:
    sd = plausible(effect)
    sides = [one_sided(p) for p in effect.parameters[: len(sd)]]
    return EffectSensitivity(
        effect.name, effect.family, columns, np.array(sd), np.array(sides, np.bool_)
    )


def _with_zeros(columns: FloatArray) -> FloatArray:
    """Append a row of zeros."""
    return np.concatenate([columns, np.zeros_like(columns[..., :1, :])], axis=-2)


def _no_problem(values: Values) -> Problem:
    raise AssertionError("a scan used only for its noise has no problem")


def _no_look(points: FloatArray, of: InterfacePoints) -> tuple[FloatArray, FloatArray]:
    raise AssertionError("a scan used only for its noise cannot be compared")


_NOISE_ONLY = Scan("", _no_problem, _no_look)
