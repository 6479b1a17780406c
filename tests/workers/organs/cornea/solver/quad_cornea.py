"""An independent cornea of 9-node quadrilaterals in plane stress, for blind eyes.

It shares nothing with the tested solver: other elements, stresses from eigenvalues with a
difference tangent, a carried prestretch (the stress-free shape is iterated, E. Sellier, C. R.
Mecanique 339 (2011) 636), sparse elimination.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

GAUSS, WEIGHT = np.polynomial.legendre.leggauss(3)
DIFFERENCE = 1e-6


@dataclass
class Eye:
    """A simulated eye and its hidden deviations; mm, MPa, radians."""

    anterior: np.ndarray
    posterior: np.ndarray
    mu: tuple
    alpha: tuple
    iop: float
    bulk: float = 10.0
    jet: float = 0.015
    jet_centre: float = 0.0
    jet_radius: float = 1.5
    jet_edge: float = 0.0  # width of its soft edge
    shift: tuple = (0.0, 0.0)
    tilt: float = 0.0
    limbus_softness: float = 0.0  # mm/MPa, twice as soft at the outer surface as at the inner one
    stiffer: object = field(default=lambda x, y: np.ones_like(x))


def lagrange(s):
    """Return the quadratic shape functions on (-1, 0, 1) and their slopes."""
    s = np.asarray(s)
    shape = np.stack([s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2])
    return shape, np.stack([s - 0.5, -2 * s, s + 0.5])


class Quads:
    """The grid of an eye: `nx` by `ny` elements, with lines at the edges of the jet."""

    def __init__(self, eye, nx=72, ny=2):
        stations = self._stations(eye, nx)
        top, bottom = (_along(line, stations) for line in (eye.anterior, eye.posterior))
        depth = np.linspace(0, 1, 2 * ny + 1)[:, None, None]
        self.X = ((1 - depth) * top + depth * bottom).reshape(-1, 2)
        self.columns, self.rows = len(stations), 2 * ny + 1
        number = np.arange(len(self.X)).reshape(self.rows, self.columns)
        self.elements = np.array(
            [
                number[2 * j : 2 * j + 3, 2 * i : 2 * i + 3].ravel()
                for j in range(ny)
                for i in range((self.columns - 1) // 2)
            ]
        )
        self.top, self.bottom = number[0], number[-1]
        self.sides = (number[:, 0], number[:, -1])
        self.shape, self.slopes, self.weights = self._points()

    @staticmethod
    def _stations(eye, nx):
        """Return an odd number of fractions of the surfaces' length: corners and midsides."""
        x = eye.anterior[:, 0]
        arc = np.concatenate(
            [[0], np.cumsum(np.linalg.norm(np.diff(eye.anterior, axis=0), axis=1))]
        )
        edges = np.interp(
            [eye.jet_centre - eye.jet_radius, eye.jet_centre + eye.jet_radius], x, arc / arc[-1]
        )
        fixed = np.array([0.0, *edges, 1.0])
        counts = np.maximum(1, np.rint(nx * np.diff(fixed)).astype(int))
        parts = [
            np.linspace(a, b, 2 * n + 1)[1:]
            for a, b, n in zip(fixed[:-1], fixed[1:], counts, strict=True)
        ]
        return np.concatenate([[0.0], *parts])

    def _points(self):
        shape, slopes, weights = [], [], []
        for b, wb in zip(GAUSS, WEIGHT, strict=True):
            for a, wa in zip(GAUSS, WEIGHT, strict=True):
                (Na, da), (Nb, db) = lagrange(a), lagrange(b)
                shape.append(np.outer(Nb, Na).ravel())
                slopes.append(np.stack([np.outer(Nb, da).ravel(), np.outer(db, Na).ravel()]))
                weights.append(wa * wb)
        return np.array(shape), np.array(slopes), np.array(weights)


def _along(line, parts):
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return np.stack([np.interp(parts * arc[-1], arc, line[:, k]) for k in range(2)], axis=1)


def first_stress(F, eye, factor):
    """Return the first Piola stress in plane stress, (..., 2, 2), of deformation gradients."""
    values, vectors = np.linalg.eigh(np.swapaxes(F, -1, -2) @ F)
    log = 0.5 * np.log(values)
    thick = -0.4 * log.sum(-1)
    tau = None
    for _ in range(30):
        logs = np.concatenate([log, thick[..., None]], axis=-1)
        J = np.exp(logs.sum(-1))
        bar = logs - logs.mean(-1, keepdims=True)
        tau, slope = np.zeros_like(logs), np.zeros_like(J)
        for mu, alpha in zip(eye.mu, eye.alpha, strict=True):
            q = np.exp(alpha * bar)
            tau += mu * factor[..., None] * (q - q.mean(-1, keepdims=True))
            slope += mu * factor * alpha * (4 * q[..., 2] + q[..., 0] + q[..., 1]) / 9
        terms = len(eye.mu)
        p = eye.bulk * (J - 1) + (2 * eye.bulk * (J - 1) ** 3 if terms > 1 else 0)
        dp = eye.bulk + (6 * eye.bulk * (J - 1) ** 2 if terms > 1 else 0)
        tau += (J * p)[..., None]
        slope += J * p + J**2 * dp
        step = tau[..., 2] / slope
        thick = thick - np.clip(step, -0.05, 0.05)
        if np.abs(step).max() < 1e-12:
            break
    S = np.einsum("...ia,...a,...ja->...ij", vectors, tau[..., :2] / values, vectors)
    return F @ S


def solve(eye, grid, X0, start, iop, jet, fraction):
    """Return the node positions in equilibrium, given a stress-free shape and an initial guess."""
    x = start.copy()
    fixed = np.concatenate(grid.sides)
    motion = _carried(grid.X[fixed], eye, fraction)
    free = np.ones(len(x), bool)
    soft = eye.limbus_softness > 0
    if not soft:
        free[fixed] = False
        x = x + _spread_motion(grid, eye, fraction, start)
        x[fixed] = motion
    unknown = np.flatnonzero(np.repeat(free, 2))
    for _ in range(60):
        force, K = _internal(eye, grid, X0, x)
        for line, pressure, sign in ((grid.bottom, iop, 1.0), (grid.top, jet, -1.0)):
            if pressure:
                f, k = _pressure(eye, grid, x, line, pressure, sign, line is grid.top)
                force, K = force - f, K - k
        if soft:
            f, k = _springs(eye, grid, x, motion, fixed)
            force, K = force + f, K + k
        r = force[unknown]
        step = np.zeros(2 * len(x))
        step[unknown] = spsolve(K.tocsc()[np.ix_(unknown, unknown)], -r)
        longest = np.abs(step).max()
        x = x + (step * min(1.0, 0.15 / longest)).reshape(-1, 2)
        if longest < 1e-8:
            return x
    raise ArithmeticError("no equilibrium")


def deformed(eye, steps=6):
    """Return both surfaces under the jet, corners and midsides of the elements."""
    grid = Quads(eye)
    X0, x = grid.X.copy(), grid.X.copy()
    for _ in range(8):
        x = solve(eye, grid, X0, x, eye.iop, 0.0, 0.0)
        off = x - grid.X
        X0 = X0 - off
        if np.abs(off).max() < 1e-6:
            break
    for part in np.linspace(0, 1, steps + 1)[1:]:
        x = solve(eye, grid, X0, x, eye.iop, part * eye.jet, part)
    return x[grid.top], x[grid.bottom]


def _internal(eye, grid, X0, x):
    nodes = grid.elements
    Xe, xe = X0[nodes], x[nodes]
    jac = np.einsum("qan,enk->eqka", grid.slopes, Xe)
    det = np.abs(np.linalg.det(jac))
    gradient = np.einsum("eqab,qan->eqbn", np.linalg.inv(jac), grid.slopes)
    F = np.einsum("enk,eqbn->eqkb", xe, gradient)
    at = np.einsum("qn,enk->eqk", grid.shape, grid.X[nodes])
    factor = eye.stiffer(at[..., 0], at[..., 1])
    P = first_stress(F, eye, factor)
    A = np.empty((*F.shape, 2, 2))
    for i in range(2):
        for j in range(2):
            dF = np.zeros((2, 2))
            dF[i, j] = DIFFERENCE
            both = first_stress(F + dF, eye, factor), first_stress(F - dF, eye, factor)
            A[..., i, j] = (both[0] - both[1]) / (2 * DIFFERENCE)
    dV = det * grid.weights
    f = np.einsum("eqkb,eqbn,eq->enk", P, gradient, dV)
    K = np.einsum("eqkblc,eqbn,eqcm,eq->enkml", A, gradient, gradient, dV)
    force = np.zeros_like(x)
    np.add.at(force, nodes, f)
    return force.ravel(), _sparse(nodes, K, len(x))


def _sparse(nodes, K, n):
    dofs = (2 * nodes[..., None] + np.arange(2)).reshape(len(nodes), -1)
    size = dofs.shape[1]
    rows, columns = np.repeat(dofs, size, axis=1), np.tile(dofs, (1, size))
    return coo_array(
        (K.reshape(len(nodes), -1).ravel(), (rows.ravel(), columns.ravel())), (2 * n,) * 2
    ).tocsr()


def _pressure(eye, grid, x, line, pressure, sign, is_jet):
    edges = np.stack([line[0:-1:2], line[1::2], line[2::2]], axis=1)
    gauss, weights = np.polynomial.legendre.leggauss(5)
    turn = sign * np.array([[0.0, -1.0], [1.0, 0.0]])
    f, K = np.zeros((len(edges), 3, 2)), np.zeros((len(edges), 3, 2, 3, 2))
    for g, w in zip(gauss, weights, strict=True):
        N, dN = lagrange(g)
        p = np.full(len(edges), pressure)
        if is_jet:
            at = grid.X[edges][:, :, 0] @ N
            p = p * _profile(np.abs(at - eye.jet_centre), eye)
        tangent = np.einsum("n,enk->ek", dN, x[edges])
        f += w * p[:, None, None] * N[:, None] * (tangent @ turn.T)[:, None]
        K += w * p[:, None, None, None, None] * np.einsum("n,kl,m->nkml", N, turn, dN)
    force = np.zeros_like(x)
    np.add.at(force, edges, f)
    return force.ravel(), _sparse(edges, K, len(x))


def _profile(r, eye):
    if eye.jet_edge == 0:
        return (r < eye.jet_radius).astype(float)
    return 1 / (1 + np.exp((r - eye.jet_radius) / eye.jet_edge))


def _carried(points, eye, fraction):
    centre = np.array([points[:, 0].mean(), points[:, 1].mean()])
    angle = fraction * eye.tilt
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return (points - centre) @ turn.T + centre + fraction * np.array(eye.shift)


def _spread_motion(grid, eye, fraction, start):
    """Return an initial guess in which all nodes move with the eye."""
    fixed = np.concatenate(grid.sides)
    before = start[fixed].mean(axis=0)
    after = _carried(grid.X[fixed], eye, fraction).mean(axis=0)
    return np.broadcast_to(after - before, start.shape)


def _springs(eye, grid, x, anchor, fixed):
    f, k = np.zeros_like(x), np.zeros(2 * len(x))
    for number, side in enumerate(grid.sides):
        held = anchor[number * len(side) : (number + 1) * len(side)]
        length = np.linalg.norm(grid.X[side[-1]] - grid.X[side[0]])
        share = np.where(np.arange(len(side)) % 2, 4.0, 2.0)
        share[[0, -1]] = 1.0
        share *= length / share.sum()
        stiffness = share / eye.limbus_softness * np.linspace(2 / 3, 4 / 3, len(side))
        f[side] += stiffness[:, None] * (x[side] - held)
        k[2 * side] = k[2 * side + 1] = stiffness
    dofs = np.arange(len(k))
    return f.ravel(), coo_array((k, (dofs, dofs)), (len(k),) * 2).tocsr()
