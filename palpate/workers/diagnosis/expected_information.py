r"""Expected information of a planned acquisition, and the benefit of further measurements.

No residuals are used. The sensitivity of a planned scan to constants and effects is computed from
the model alone. The normals of the loaded interfaces come from the model too: with the deformation
gradient F, a normal n of the body at rest becomes

.. math:: n' = F^{-T} n / |F^{-T} n|

(E. J. Nanson, Messenger of Math. 7 (1878) 182). An additional row is the distance between the
plates: the relative motion of the contact areas, with each node weighted by its contact stiffness.
For flat plates under a given force, this is the reduction in plate travel, apart from the
penetration allowed by the penalty.

An effect is *detectable* (`seen`) if, at its plausible size, it is expected to raise the log
evidence over no gap by as much as a diagnosis demands of a first cause, and if the constants do not
hide it. Two effects are *distinguishable* (`apart`) if both are detectable and each, when it acts,
is expected to beat the other by more than a tie. If effect k acts at its prior scale, it beats j on
average by the Kullback-Leibler divergence between their predictions

.. math:: \tfrac12 [ \mathrm{tr}(\Sigma_j^{-1} \Sigma_k) - m + \ln|\Sigma_j| - \ln|\Sigma_k| ],
          \qquad \Sigma_k = P^{-1} + B_k S_k B_k',

in nats (the discrimination criterion of G. E. P. Box and W. J. Hill, Technometrics 9 (1967) 57).
Bounds of one-sided parameters are ignored. Because an expected log evidence is such a divergence,
further rows never lower it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_matrix, vstack

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import (
    absorbed_share,
    confusion,
    minimum_detectable,
)
from palpate.workers.diagnosis.fits.effect_sensitivities import scan_sensitivity
from palpate.workers.diagnosis.fits.gauss_newton import SolvedFit
from palpate.workers.diagnosis.linearisation import EffectSensitivity, Linearised, factored
from palpate.workers.diagnosis.problem.inverse_problem import (
    InverseProblem,
    Scan,
    Unknowns,
    Values,
    unknowns,
)
from palpate.workers.diagnosis.problem.planned_acquisition import INTERFACES, ProblemBuilder
from palpate.workers.diagnosis.problem.scan_noise import planned_covariance
from palpate.workers.diagnosis.problem.scan_prediction import PredictedScan, columns_of
from palpate.workers.mechanics.effects.effect import Effect, one_sided
from palpate.workers.mechanics.fem.body_equilibrium import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.fem.discretisation import LevelModel
from palpate.workers.mechanics.fem.loads_and_regions import NoPlates

# Interface number of the row with the plate distance.
PLATES = len(INTERFACES)


@dataclass(frozen=True, eq=False)
class LoadSensitivity:
    """Derivatives of the data of a scan, at the prior mean of the constants.

    The rows are the k points on the interfaces, in mm along their normals, then the distance
    between the plates in mm.

    Parameters
    ----------
    nominal : ndarray, shape (k + 1, p)
        Derivatives with respect to the logarithms of the constants.
    columns : dict of str to ndarray, shape (k + 1, q) or (g, k + 1, q)
        Derivatives with respect to the parameters of each effect; zero if it does not act under
        this load.
    travel_mm : float
        Travel of the plates towards each other; 0 if their distance is given.
    """

    nominal: FloatArray
    columns: dict[str, FloatArray]
    travel_mm: float


def load_sensitivity(
    unloaded: InverseProblem, name: str, problem: ProblemBuilder, effects: Sequence[Effect]
) -> LoadSensitivity | None:
    """Simulate one load and differentiate the predicted data of its scan.

    Parameters
    ----------
    unloaded : InverseProblem
        The body at rest; see `workers.diagnosis.problem.planned_acquisition.inverse_problem_of`.
    name : str
        Name of the load.
    problem : callable
    effects : sequence of Effect

    Returns
    -------
    LoadSensitivity or None
        None if the nominal model does not converge under this load. Effects that cannot be
        simulated have no columns.
    """
    free = unknowns(unloaded.free, [])
    nominal = problem(free.constants(free.mean))
    solved = equilibrium(unloaded.model, nominal)
    if not solved.solution.outcome.converged:
        return None
    scan = Scan(name, problem, _not_scanned)
    inverse, prediction = _with_plates(unloaded, scan, solved)
    fit = SolvedFit(free, free.mean, (prediction,), np.empty((0, 0)), 0.0, True, 0)
    columns = {}
    for effect in effects:
        derivatives = _columns(inverse, fit, effect)
        if derivatives is not None:
            columns[effect.name] = derivatives
    jacobian = columns_of(inverse, prediction, _changes(problem, free))
    return LoadSensitivity(jacobian, columns, solved.states[-1].travel_mm)


def deformed_normals(unloaded: InverseProblem, displacement_mm: FloatArray) -> FloatArray:
    """Return the normals of the interfaces after a displacement of the nodes, shape (k, 3)."""
    gradients = nodal_gradients(unloaded.model.finest, displacement_mm)
    at_points = unloaded.at_points @ gradients.reshape(len(gradients), 9)
    F = at_points.reshape(-1, 3, 3)
    turned = np.linalg.solve(F.transpose(0, 2, 1), unloaded.points.normals[:, :, None])[:, :, 0]
    return np.asarray(turned / np.linalg.norm(turned, axis=1)[:, None])


def nodal_gradients(level: LevelModel, displacement_mm: FloatArray) -> FloatArray:
    """Return nodal means of the elements' deformation gradients, shape (n, 3, 3)."""
    tets, gradients, volumes = level.elements
    u = displacement_mm[tets]
    F = np.eye(3) + np.einsum("mai,maj->mij", u[:, 1:] - u[:, :1], gradients)
    total = np.zeros((len(level.nodes), 9))
    weight = np.zeros(len(level.nodes))
    for corner in tets.T:
        np.add.at(total, corner, volumes[:, None] * F.reshape(-1, 9))
        np.add.at(weight, corner, volumes)
    return np.asarray((total / weight[:, None]).reshape(-1, 3, 3))


def plate_row(at: Equilibrium) -> tuple[csr_matrix, FloatArray]:
    """Return the relative motion of both plates' contact areas, as a row for the nodes.

    Returns
    -------
    csr_matrix, shape (1, n)
        Weights of the nodes, with a sum of 1 for the upper plate and -1 for the lower; all zero
        without plates.
    ndarray, shape (3,)
        The axis from the lower to the upper plate.
    """
    level, state, load = at.levels[-1], at.states[-1], at.problem.load
    n = len(level.model.nodes)
    if isinstance(load, NoPlates):
        return csr_matrix((1, n)), np.array([0.0, 1.0, 0.0])
    weights = np.zeros(n)
    for plate, sign in zip(level.plate_contacts(state, at.stage), (-1.0, 1.0), strict=True):
        touching = plate.nodes.stiffness * (plate.gap < 0)
        if touching.any():
            weights[plate.nodes.index] += sign * touching / touching.sum()
    axis = np.asarray(load.device.axis)
    return csr_matrix(weights[None]), axis / np.linalg.norm(axis)


def _changes(problem: ProblemBuilder, free: Unknowns) -> list[Change]:
    """Return the changes in the logarithm of each constant, about the prior mean."""
    found = []
    for step in SETTINGS.fit.log_step * np.eye(len(free.mean)):
        ahead, behind = (problem(free.constants(free.mean + s)) for s in (step, -step))
        found.append(Change(ahead, behind, 2 * SETTINGS.fit.log_step))
    return found


def _with_plates(
    unloaded: InverseProblem, scan: Scan, at: Equilibrium
) -> tuple[InverseProblem, PredictedScan]:
    """Return the problem with the plate distance as a further point, and its prediction."""
    row, axis = plate_row(at)
    u, p = at.solution.displacement_mm, unloaded.points
    points = InterfacePoints(
        np.vstack([p.points, unloaded.frame.centre_mm]),
        np.vstack([p.normals, axis]),
        np.append(p.interface, np.int32(PLATES)),
        np.append(p.area_mm2, 0.0),
        np.append(p.part, p.part.max() + np.int32(1)),
    )
    to_points = csr_matrix(vstack([unloaded.at_points, row]))
    inverse = replace(unloaded, points=points, at_points=to_points, scans=(scan,))
    followed = inverse.followed(scan)
    normals = np.vstack([deformed_normals(unloaded, u), axis])
    return inverse, PredictedScan(followed.moved(u), np.zeros(len(points)), normals, at, followed)


def _columns(inverse: InverseProblem, fit: SolvedFit, effect: Effect) -> FloatArray | None:
    """Return the columns of one effect, zero if it does not act, or None if not simulated."""
    found = scan_sensitivity(inverse, fit, 0, effect)
    if found.idle:
        return np.zeros((len(inverse.points), len(effect.names)))
    columns = found.columns
    if columns is not None and not effect.acts_on_body:
        columns = columns.copy()
        columns[..., -1, :] = 0.0  # the plate distance is not measured in the images
    return columns


def _not_scanned(points: FloatArray, of: InterfacePoints) -> tuple[FloatArray, FloatArray]:
    raise InputError("This scan is only planned, so it cannot be compared with a model.")


@dataclass(frozen=True, slots=True, eq=False)
class Detectability:
    """Detectability of one effect.

    Parameters
    ----------
    name : str
    minimum : ndarray, shape (q,)
        Smallest magnitude of each parameter that is detected with 80 % power at 1 % false alarms.
    absorbed : float
        Share of the effect that the nominal parameters absorb; median over the places.
    nearest : str or None
        The effect with the most similar visible part.
    cosine : float
        Similarity to that effect, 0 to 1.
    """

    name: str
    minimum: FloatArray
    absorbed: float
    nearest: str | None
    cosine: float


def detectability(
    problem: Linearised, sensitivities: Sequence[EffectSensitivity], cosines: FloatArray
) -> tuple[Detectability, ...]:
    """Return a row for each effect, in the order given, from their `confusion`."""
    rows = []
    others = cosines - np.eye(len(sensitivities))
    for sensitivity, cosine in zip(sensitivities, others, strict=True):
        shares = [absorbed_share(problem, B) for B in sensitivity.whitened(problem)]
        near = int(cosine.argmax())
        rows.append(
            Detectability(
                sensitivity.name,
                minimum_detectable(problem, sensitivity),
                float(np.median(shares)),
                sensitivities[near].name if cosine[near] > 0 else None,
                float(cosine[near]),
            )
        )
    return tuple(rows)


def separation(problem: Linearised, sensitivities: Sequence[EffectSensitivity]) -> FloatArray:
    """Return the expected log Bayes factor of an acting effect against each other effect.

    Returns
    -------
    ndarray, shape (effects, effects)
        Entry ``[k, j]`` is for k acting, in nats; median over the places of k, against the best
        place of j.
    """
    columns = [np.stack([*one.whitened(problem)]) for one in sensitivities]
    projected = [np.stack([problem.project(B) for B in places]) for places in columns]
    log_factors = np.zeros((len(columns), len(columns)))
    for j, other in enumerate(projected):
        for k, acting in enumerate(columns):
            if k != j:
                table = _divergences(acting, projected[k], columns[j], other)
                log_factors[k, j] = np.median(table.min(axis=1))
    return log_factors


def _divergences(
    acting: FloatArray, projected: FloatArray, other: FloatArray, rival: FloatArray
) -> FloatArray:
    """Return the divergences of an effect at g places from a rival at h places, shape (g, h).

    Parameters
    ----------
    acting, projected : ndarray, shape (g, m, q)
        Columns of the effect, and their projection.
    other, rival : ndarray, shape (h, m, r)
        The same of the rival.
    """
    kk, jj = acting.transpose(0, 2, 1) @ projected, other.transpose(0, 2, 1) @ rival
    kj = np.tensordot(acting, rival, axes=(1, 1)).transpose(0, 2, 1, 3)
    own, theirs = np.eye(kk.shape[1]) + kk, np.eye(jj.shape[1]) + jj
    inverse = np.linalg.inv(theirs)
    trace = np.trace(kk, axis1=1, axis2=2)[:, None] - np.trace(inverse @ jj, axis1=1, axis2=2)
    trace = trace - ((kj @ inverse) * kj).sum(axis=(2, 3))
    logs = np.linalg.slogdet(theirs)[1] - np.linalg.slogdet(own)[1][:, None]
    return np.asarray(0.5 * (trace + logs))


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
        return (self.evidence > SETTINGS.selection.first) & ~self.hidden

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
        return np.array(sunk, np.bool_) | (mostly & (self.evidence <= SETTINGS.selection.first))

    def apart(self) -> set[frozenset[str]]:
        """Return the pairs of effects that can be distinguished."""
        return {pair for pair, worst in self.pairs().items() if worst > SETTINGS.selection.tie}

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
        See `workers.diagnosis.problem.planned_acquisition.inverse_problem_of`.
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
    cosines = confusion(problem, sensitivities)
    rows = detectability(problem, sensitivities, cosines)
    return DesignEvaluation(rows, table[:-1, -1], cosines, table[:-1, :-1])


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
    inverse = replace(unloaded, noise=noise, scans=[_NOISE_ONLY] * len(design.states))
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
