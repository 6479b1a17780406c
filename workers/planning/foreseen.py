r"""What one loaded scan will show of constants and effects, from the model alone.

The normals of the loaded interfaces are those of the model's own: with the deformation
gradient F a normal n of the body at rest becomes

.. math:: n' = F^{-T} n / |F^{-T} n|

(E. J. Nanson, Messenger of Math. 7 (1878) 182). One more row stands for the distance
between the plates: how the contact areas move apart when something changes, each node
weighted by its contact stiffness. Under a given force of flat plates that is by how much
less the plates travel, up to what they press into the penalty.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, vstack

from storage.errors import InputError
from storage.values import FloatArray
from workers.diagnosis.fingerprints import fingerprints
from workers.diagnosis.fit import Fit
from workers.diagnosis.subject import Scan, Subject, Unknowns, unknowns
from workers.diagnosis.views import LOG_STEP, View, columns_of
from workers.effects.base import Effect
from workers.fem.fields import frame_of
from workers.fem.loads import NoPlates
from workers.fem.model import LevelModel, prepare
from workers.fem.sensitivity import Change
from workers.fem.solve import Equilibrium, equilibrium
from workers.observation.interface import GLANDULAR, OUTLINE, InterfacePoints, interface_points
from workers.observation.locate import interpolation
from workers.observation.noise import covariance
from workers.planning.prospect import Builder, Prospect

# As for scans that are there, see `workers.cases.build`.
INTERFACES = (OUTLINE, GLANDULAR)
WALL_MARGIN_MM = 4.0
CLEAR_NOISES = 5.0
# The number of the row that is the plates' distance, among interfaces.
PLATES = len(INTERFACES)


@dataclass(frozen=True, eq=False)
class Foreseen:
    """Derivatives of what a scan shows, at the prior middle of the constants.

    Rows are the k points of the interfaces, in mm along their normals, and a last one for
    the distance between the plates in mm.

    Parameters
    ----------
    nominal : ndarray, shape (k + 1, p)
        By the logarithms of the constants.
    columns : dict of str to ndarray, shape (k + 1, q) or (g, k + 1, q)
        By the parameters of each effect; zero for one that does not act on this load.
    travel_mm : float
        By how much the plates have come closer; 0 for plates that are put at a distance.
    """

    nominal: FloatArray
    columns: dict[str, FloatArray]
    travel_mm: float


def ground_of(prospect: Prospect, nodes: int, spacing_mm: float) -> Subject:
    """The body at rest with its points, and no scans.

    Parameters
    ----------
    prospect : Prospect
    nodes : int
        Of the mesh.
    spacing_mm : float
        Between neighbouring points on the interfaces.

    Raises
    ------
    InputError
        If the reference scan shows no body or no glandular tissue.
    """
    hierarchy = prospect.mesh(nodes)
    model = prepare(hierarchy)
    points = interface_points(
        prospect.reference,
        INTERFACES,
        spacing_mm,
        WALL_MARGIN_MM,
        CLEAR_NOISES * prospect.noise.sd_mm,
    )
    return Subject(
        model=model,
        frame=frame_of(model.finest.nodes),
        points=points,
        at_points=interpolation(hierarchy.finest.mesh, points.points),
        free=prospect.free,
        scans=(),
        noise=prospect.noise,
        covariance=covariance(points, prospect.noise, 1),
        bias=np.zeros(len(points)),
    )


def foresee(
    ground: Subject, name: str, problem: Builder, effects: Sequence[Effect]
) -> Foreseen | None:
    """Simulate one load and differentiate what its scan will show.

    Parameters
    ----------
    ground : Subject
        See `ground_of`.
    name : str
        Of the load.
    problem : callable
    effects : sequence of Effect

    Returns
    -------
    Foreseen or None
        None if the nominal model does not converge under this load. An effect that cannot
        be simulated has no columns.
    """
    free = unknowns(ground.free, [])
    nominal = problem(free.constants(free.mean))
    at = equilibrium(ground.model, nominal)
    if not at.solution.outcome.converged:
        return None
    scan = Scan(name, problem, _unseen)
    subject, seen = _with_plates(ground, scan, at)
    fit = Fit(free, free.mean, (seen,), np.empty((0, 0)), 0.0, True, 0)
    columns = {}
    for effect in effects:
        found = _columns(subject, fit, effect)
        if found is not None:
            columns[effect.name] = found
    jacobian = columns_of(subject, seen, _changes(problem, free))
    return Foreseen(jacobian, columns, at.states[-1].travel_mm)


def deformed_normals(ground: Subject, displacement_mm: FloatArray) -> FloatArray:
    """Normals of the interfaces after a displacement of the nodes, shape (k, 3)."""
    gradients = nodal_gradients(ground.model.finest, displacement_mm)
    at_points = ground.at_points @ gradients.reshape(len(gradients), 9)
    F = at_points.reshape(-1, 3, 3)
    turned = np.linalg.solve(F.transpose(0, 2, 1), ground.points.normals[:, :, None])[:, :, 0]
    return np.asarray(turned / np.linalg.norm(turned, axis=1)[:, None])


def nodal_gradients(level: LevelModel, displacement_mm: FloatArray) -> FloatArray:
    """Deformation gradients, each the mean over the elements around a node, shape (n, 3, 3)."""
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
    """How the contact areas of both plates move apart, as a row for the nodes.

    Returns
    -------
    csr_matrix, shape (1, n)
        Weights of the nodes: those of the upper plate sum to 1, those of the lower to -1;
        all zero without plates.
    ndarray, shape (3,)
        The axis from the lower to the upper plate.
    """
    level, state, load = at.levels[-1], at.states[-1], at.problem.load
    n = len(level.model.nodes)
    if isinstance(load, NoPlates):
        return csr_matrix((1, n)), np.array([0.0, 1.0, 0.0])
    presses, _ = level.contact(state, at.stage)
    weights = np.zeros(n)
    for press, sign in zip(presses, (-1.0, 1.0), strict=True):
        touching = press.pads.stiffness * (press.gap < 0)
        if touching.any():
            weights[press.pads.nodes] += sign * touching / touching.sum()
    axis = np.asarray(load.device.axis)
    return csr_matrix(weights[None]), axis / np.linalg.norm(axis)


def _changes(problem: Builder, free: Unknowns) -> list[Change]:
    """Of the logarithm of each constant, about the prior mean."""
    found = []
    for step in LOG_STEP * np.eye(len(free.mean)):
        ahead, behind = (problem(free.constants(free.mean + s)) for s in (step, -step))
        found.append(Change(ahead, behind, 2 * LOG_STEP))
    return found


def _with_plates(ground: Subject, scan: Scan, at: Equilibrium) -> tuple[Subject, View]:
    """The points and the distance of the plates as one list, and where they have gone."""
    row, axis = plate_row(at)
    u, p = at.solution.displacement_mm, ground.points
    points = InterfacePoints(
        np.vstack([p.points, ground.frame.centre_mm]),
        np.vstack([p.normals, axis]),
        np.append(p.interface, np.int32(PLATES)),
        np.append(p.area_mm2, 0.0),
        np.append(p.part, p.part.max() + np.int32(1)),
    )
    to_points = csr_matrix(vstack([ground.at_points, row]))
    subject = replace(ground, points=points, at_points=to_points, scans=(scan,))
    normals = np.vstack([deformed_normals(ground, u), axis])
    return subject, View(at, points.points + to_points @ u, np.zeros(len(points)), normals)


def _columns(subject: Subject, fit: Fit, effect: Effect) -> FloatArray | None:
    """Of one effect, zero where it does not act; None if it cannot be simulated."""
    problem = fit.views[0].at.problem
    if not effect.acts_on(problem, subject.frame):
        return np.zeros((len(subject.points), len(effect.names)))
    found, _ = fingerprints(subject, fit, [effect])
    if not found:
        return None
    columns = found[0].columns
    if effect.observation is not None:
        columns = columns.copy()
        columns[..., -1, :] = 0.0  # the plates' distance is not read off the images
    return columns


def _unseen(points: FloatArray, of: InterfacePoints) -> tuple[FloatArray, FloatArray]:
    raise InputError("This scan is not made yet: nothing can be compared with it.")
