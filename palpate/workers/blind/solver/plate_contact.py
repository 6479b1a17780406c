r"""Contact of two rigid plates with the points of the skin, with Coulomb friction.

A plate is a height h over the plane normal to the axis of compression d,

.. math:: g(x, t) = \pm c\, (p + h(s_1, s_2) - t - d \cdot x) , \quad
          h = a_1 s_1 + a_2 s_2 + \tfrac{f}{2} (1 - \cos \tfrac{\pi s_1}{l}) ,

and presses with the penalty ``w k <-g>`` at six points of every face. If a plate starts at some
z, w grows from 0 there to 1 a few mm further as a polynomial of degree 5; the forces at this
rounded edge follow from the energy ``w k <-g>^2 / 2``. Friction is a return mapping from one
load to the next (J. C. Simo, T. A. Laursen, Comput. Struct. 42 (1992) 97-116): elastic slip up
to the coefficient times the pressure, then sliding; within an iteration the limit uses the
pressure of the previous iteration, so that the increment has a potential.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.blind.solver.quadratic_mesh import (
    FACE_WEIGHTS,
    QuadraticMesh,
    face_areas,
    face_shapes,
)
from palpate.workers.kernels_and_threads import CONTRACTED

PENALTY_N_PER_MM3 = 1.0
SLIP_N_PER_MM3 = 0.3
EDGE_FADE_MM = 4.0  # width of the rounded edge of a short plate


class Plate(NamedTuple):
    """A compression plate.

    Parameters
    ----------
    frame : ndarray, shape (3, 3)
        In-plane axes s1 and s2 and the axis d from the lower to the upper plate.
    Point with s1 = s2 = 0.
        Where s1 = s2 = 0.
    Initial position along d.
        Along d, before it moves.
    1 for the upper plate, which moves by -t; -1 for the lower, which is fixed.
        1 for the upper plate, which moves by -t; -1 for the lower, which does not move.
    slopes : ndarray, shape (2,)
        a1 and a2.
    sag_mm, length_mm : float
        f and l; the plate bends away from the body by f at a distance l from its pivot.
    edge_mm : float
        Edge of the plate: the least ``s2 . x`` at which it presses.
    """

    frame: FloatArray
    pivot_mm: FloatArray
    start_mm: float
    side: float
    slopes: FloatArray
    sag_mm: float
    length_mm: float
    edge_mm: float = -np.inf


class Skin(NamedTuple):
    """Points of the free surface that may touch a plate.

    Parameters
    ----------
    faces : ndarray of int32, shape (k, 6)
    shapes : ndarray, shape (6 points, 6 nodes)
    areas : ndarray, shape (k, 6)
        Area of each point, in mm^2.
    places : ndarray, shape (k, 6, 3)
        Positions in the undeformed body, in mm.
    friction : ndarray, shape (k, 6)
        Coulomb coefficient.
    """

    faces: IntArray
    shapes: FloatArray
    areas: FloatArray
    places: FloatArray
    friction: FloatArray


class FrictionState(NamedTuple):
    """History of friction at the points of one plate.

    Parameters
    ----------
    origin : ndarray, shape (k, 6, 2)
        In-plane displacement without elastic slip, in mm.
    pressure : ndarray, shape (k, 6)
        Pressure that limits friction, in MPa.
    """

    origin: FloatArray
    pressure: FloatArray


def skin_of(mesh: QuadraticMesh) -> Skin:
    """Return the points of the free surface of a mesh, without friction."""
    shapes = face_shapes()
    areas = face_areas(mesh, mesh.skin)[:, None] * FACE_WEIGHTS
    places = np.einsum("qa,kai->kqi", shapes, mesh.nodes[mesh.skin])
    return Skin(np.ascontiguousarray(mesh.skin), shapes, areas, places, np.zeros_like(areas))


def no_friction_yet(skin: Skin) -> FrictionState:
    """Return the initial state of friction, before contact."""
    return FrictionState(np.zeros((*skin.areas.shape, 2)), np.zeros(skin.areas.shape))


@njit(**CONTRACTED)
def _displacement(skin: Skin, f: int, q: int, u: FloatArray, out: FloatArray) -> None:
    for i in range(3):
        out[i] = 0.0
        for a in range(6):
            out[i] += skin.shapes[q, a] * u[skin.faces[f, a], i]


@njit(**CONTRACTED)
def _place(
    skin: Skin, f: int, q: int, u: FloatArray, displacement: FloatArray, x: FloatArray
) -> None:
    """Store the displacement of a point and its deformed position x, both (3,)."""
    _displacement(skin, f, q, u, displacement)
    for i in range(3):
        x[i] = skin.places[f, q, i] + displacement[i]


@njit(**CONTRACTED)
def _gap(plate: Plate, x: FloatArray, t: float, slope: FloatArray) -> tuple[float, float]:
    """Return the gap at x and the scaled second derivative of h in s1; store its slope."""
    s1, s2, along = 0.0, 0.0, 0.0
    for i in range(3):
        s1 += plate.frame[0, i] * (x[i] - plate.pivot_mm[i])
        s2 += plate.frame[1, i] * (x[i] - plate.pivot_mm[i])
        along += plate.frame[2, i] * x[i]
    k = np.pi / plate.length_mm
    c = plate.side / np.sqrt(1 + plate.slopes[0] ** 2 + plate.slopes[1] ** 2)
    moved = t if plate.side > 0 else 0.0
    h = plate.slopes[0] * s1 + plate.slopes[1] * s2
    h += 0.5 * plate.sag_mm * (1 - np.cos(k * s1))
    h1 = plate.slopes[0] + 0.5 * plate.sag_mm * k * np.sin(k * s1)
    for i in range(3):
        slope[i] = c * (
            h1 * plate.frame[0, i] + plate.slopes[1] * plate.frame[1, i] - plate.frame[2, i]
        )
    bend = c * 0.5 * plate.sag_mm * k * k * np.cos(k * s1)
    return c * (plate.start_mm + h - moved - along), bend


@njit(**CONTRACTED)
def _share_of_plate(plate: Plate, x: FloatArray) -> tuple[float, float, float]:
    """Return w at x, and its first and second derivatives along s2."""
    s = -plate.edge_mm
    for i in range(3):
        s += plate.frame[1, i] * x[i]
    s /= EDGE_FADE_MM
    if s >= 1:
        return 1.0, 0.0, 0.0
    if s <= 0:
        return 0.0, 0.0, 0.0
    share = s**3 * (10 - 15 * s + 6 * s * s)
    slope = 30 * (s * (1 - s)) ** 2 / EDGE_FADE_MM
    return share, slope, 60 * s * (1 - s) * (1 - 2 * s) / EDGE_FADE_MM**2


@njit(**CONTRACTED)
def _press(
    plate: Plate,
    x: FloatArray,
    t: float,
    slope: FloatArray,
    push: FloatArray,
    H: FloatArray,
    mixed: FloatArray,
) -> tuple[float, float]:
    """Differentiate the penalty energy per area; store the slope of the gap too.

    Derivatives in x go into `push` (3,) and `H` (3, 3), those in x and t into `mixed` (3,). Return
    the first and second derivatives in t.
    """
    gap, bend = _gap(plate, x, t, slope)
    share, share1, share2 = _share_of_plate(plate, x)
    k = PENALTY_N_PER_MM3 if gap < 0 else 0.0
    # The gap shrinks with the travel of the upper plate times its own cosine.
    rate = 0.0
    if plate.side > 0:
        for i in range(3):
            rate += slope[i] * plate.frame[2, i]
    for i in range(3):
        push[i] = k * gap * (share * slope[i] + 0.5 * gap * share1 * plate.frame[1, i])
        mixed[i] = k * rate * (share * slope[i] + gap * share1 * plate.frame[1, i])
        for j in range(3):
            across = slope[i] * plate.frame[1, j] + plate.frame[1, i] * slope[j]
            H[i, j] = k * (
                share * (slope[i] * slope[j] + gap * bend * plate.frame[0, i] * plate.frame[0, j])
                + gap * share1 * across
                + 0.5 * gap * gap * share2 * plate.frame[1, i] * plate.frame[1, j]
            )
    return k * share * gap * rate, k * share * rate * rate


@njit(**CONTRACTED)
def _drag(
    plate: Plate,
    s: FloatArray,
    length: float,
    limit: float,
    exact: bool,
    push: FloatArray,
    H: FloatArray,
) -> None:
    """Add the traction of the elastic slip `s` (2,) and its derivatives in x, per area."""
    sticks = SLIP_N_PER_MM3 * length <= limit
    secant = SLIP_N_PER_MM3 if sticks else limit / length
    for c in range(2):
        for e in range(2):
            stiffness = secant if c == e else 0.0
            if exact and not sticks:
                stiffness -= secant * s[c] * s[e] / length**2
            for i in range(3):
                for j in range(3):
                    H[i, j] += stiffness * plate.frame[c, i] * plate.frame[e, j]
        for i in range(3):
            push[i] += secant * s[c] * plate.frame[c, i]


@njit(**CONTRACTED)
def _elastic_slip(
    plate: Plate,
    friction_state: FrictionState,
    friction: FloatArray,
    f: int,
    q: int,
    d: FloatArray,
    s: FloatArray,
) -> tuple[float, float]:
    """Store the elastic slip `s` (2,); return its length and the limit of its traction."""
    for k in range(2):
        s[k] = -friction_state.origin[f, q, k]
        for i in range(3):
            s[k] += plate.frame[k, i] * d[i]
    return np.sqrt(s[0] ** 2 + s[1] ** 2), friction[f, q] * friction_state.pressure[f, q]


@njit(**CONTRACTED)
def contact_energy(
    skin: Skin, plate: Plate, friction_state: FrictionState, u: FloatArray, t: float
) -> float:
    """Return the energy of the penalty and of friction at fixed pressure, in mJ."""
    d, x, slope, s = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    total = 0.0
    for f in range(skin.areas.shape[0]):
        for q in range(6):
            _place(skin, f, q, u, d, x)
            gap, _ = _gap(plate, x, t, slope)
            share, _, _ = _share_of_plate(plate, x)
            density = 0.5 * PENALTY_N_PER_MM3 * share * min(gap, 0.0) ** 2
            length, limit = _elastic_slip(plate, friction_state, skin.friction, f, q, d, s)
            if limit > 0:
                if SLIP_N_PER_MM3 * length <= limit:
                    density += 0.5 * SLIP_N_PER_MM3 * length**2
                else:
                    density += limit * (length - 0.5 * limit / SLIP_N_PER_MM3)
            total += skin.areas[f, q] * density
    return total


@njit(**CONTRACTED)
def add_contact(
    skin: Skin,
    plate: Plate,
    friction_state: FrictionState,
    u: FloatArray,
    t: float,
    slots: IntArray,
    exact: bool,
    force: FloatArray,
    border: FloatArray,
    blocks: FloatArray,
) -> tuple[float, float]:
    """Add the derivatives with respect to nodal displacements and travel.

    `force` (n, 3) receives the first, `blocks` (b, 3, 3) the second and `border` (n, 3) the
    mixed one. Unless `exact`, sliding points have their secant stiffness, an upper bound of the
    energy. Return the derivatives in the travel: force in N, stiffness in N/mm.
    """
    d, x, slope, s = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    push, H, mixed = np.empty(3), np.empty((3, 3)), np.empty(3)
    closing, stiffness = 0.0, 0.0
    for f in range(skin.areas.shape[0]):
        for q in range(6):
            _place(skin, f, q, u, d, x)
            area = skin.areas[f, q]
            by_travel, twice_by_travel = _press(plate, x, t, slope, push, H, mixed)
            closing += area * by_travel
            stiffness += area * twice_by_travel
            length, limit = _elastic_slip(plate, friction_state, skin.friction, f, q, d, s)
            if limit > 0:
                _drag(plate, s, length, limit, exact, push, H)
            elif not push.any():
                continue
            for a in range(6):
                n, weight = skin.faces[f, a], area * skin.shapes[q, a]
                for i in range(3):
                    force[n, i] += weight * push[i]
                    border[n, i] += weight * mixed[i]
                for b in range(6):
                    both = weight * skin.shapes[q, b]
                    for i in range(3):
                        for j in range(3):
                            blocks[slots[f, a, b], i, j] += both * H[i, j]
    return closing, stiffness


@njit(**CONTRACTED)
def renew_pressure(
    skin: Skin, plate: Plate, friction_state: FrictionState, u: FloatArray, t: float
) -> None:
    """Set the pressure that limits friction to the current plate pressure."""
    d, x, slope = np.empty(3), np.empty(3), np.empty(3)
    for f in range(skin.areas.shape[0]):
        for q in range(6):
            _place(skin, f, q, u, d, x)
            gap, _ = _gap(plate, x, t, slope)
            share, _, _ = _share_of_plate(plate, x)
            friction_state.pressure[f, q] = -PENALTY_N_PER_MM3 * share * min(gap, 0.0)


@njit(**CONTRACTED)
def update_friction_origin(
    skin: Skin, plate: Plate, friction_state: FrictionState, u: FloatArray
) -> None:
    """End a load step: points that slid, or do not touch, get a new origin."""
    d, s = np.empty(3), np.empty(2)
    for f in range(skin.areas.shape[0]):
        for q in range(6):
            _displacement(skin, f, q, u, d)
            length, limit = _elastic_slip(plate, friction_state, skin.friction, f, q, d, s)
            reach = limit / SLIP_N_PER_MM3
            if length > reach:
                for k in range(2):
                    friction_state.origin[f, q, k] += s[k] * (1 - reach / length)
