r"""Press two rigid plates against the points of the skin, with Coulomb's friction.

A plate is a height h over the plane normal to the axis of compression d,

.. math:: g(x, t) = \pm c\, (p + h(s_1, s_2) - t - d \cdot x) , \quad
          h = a_1 s_1 + a_2 s_2 + \tfrac{f}{2} (1 - \cos \tfrac{\pi s_1}{l}) ,

and presses with the penalty ``k <-g>`` at six points of every face. Friction is a
return mapping from one load to the next (J. C. Simo, T. A. Laursen, Comput. Struct.
42 (1992) 97-116): elastic slip up to the coefficient times the pressure, then sliding;
within an iteration the pressure that limits it is that of the iteration before, so that
the increment has a potential.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from storage.values import FloatArray, IntArray
from workers.blind.quadratic_element import FACE_WEIGHTS, QuadraticMesh, face_areas, face_shapes
from workers.compile_flags import CONTRACTED

PENALTY_N_PER_MM3 = 1.0
SLIP_N_PER_MM3 = 0.3


class Plate(NamedTuple):
    """Describe one plate.

    Parameters
    ----------
    frame : ndarray, shape (3, 3)
        In-plane axes s1 and s2 and the axis d from the lower to the upper plate.
    pivot_mm : ndarray, shape (3,)
        Where s1 = s2 = 0.
    start_mm : float
        Along d, before it moves.
    side : float
        1 for the upper plate, which moves by -t; -1 for the lower, which stands still.
    slopes : ndarray, shape (2,)
        a1 and a2.
    sag_mm, length_mm : float
        f and l; the plate bends away from the body by f at a distance l from its pivot.
    """

    frame: FloatArray
    pivot_mm: FloatArray
    start_mm: float
    side: float
    slopes: FloatArray
    sag_mm: float
    length_mm: float


class Skin(NamedTuple):
    """Hold the points of the free surface that may touch.

    Parameters
    ----------
    faces : ndarray of int32, shape (k, 6)
    shapes : ndarray, shape (6 points, 6 nodes)
    areas : ndarray, shape (k, 6)
        In mm^2, of each point.
    places : ndarray, shape (k, 6, 3)
        In the undeformed body, in mm.
    friction : ndarray, shape (k, 6)
        Coulomb's coefficient.
    """

    faces: IntArray
    shapes: FloatArray
    areas: FloatArray
    places: FloatArray
    friction: FloatArray


class FrictionState(NamedTuple):
    """Hold what friction remembers, for the points of one plate.

    Parameters
    ----------
    origin : ndarray, shape (k, 6, 2)
        In-plane displacement at which the skin is not dragged, in mm.
    pressure : ndarray, shape (k, 6)
        That limits it, in MPa.
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
    """Return the state of friction before anything has touched."""
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
    """Fill the displacement of a point and its deformed position x, both (3,)."""
    _displacement(skin, f, q, u, displacement)
    for i in range(3):
        x[i] = skin.places[f, q, i] + displacement[i]


@njit(**CONTRACTED)
def _gap(plate: Plate, x: FloatArray, t: float, slope: FloatArray) -> tuple[float, float]:
    """Return the gap at x and the scaled second derivative of h by s1; fill its slope."""
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
def _elastic_slip(
    plate: Plate,
    friction_state: FrictionState,
    friction: FloatArray,
    f: int,
    q: int,
    d: FloatArray,
    s: FloatArray,
) -> tuple[float, float]:
    """Fill the elastic slip `s` (2,); return its length and the traction that it can reach."""
    for k in range(2):
        s[k] = -friction_state.origin[f, q, k]
        for i in range(3):
            s[k] += plate.frame[k, i] * d[i]
    return np.sqrt(s[0] ** 2 + s[1] ** 2), friction[f, q] * friction_state.pressure[f, q]


@njit(**CONTRACTED)
def contact_energy(
    skin: Skin, plate: Plate, friction_state: FrictionState, u: FloatArray, t: float
) -> float:
    """Return the energy of the penalty and of the held friction, in mJ."""
    d, x, slope, s = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    total = 0.0
    for f in range(skin.areas.shape[0]):
        for q in range(6):
            _place(skin, f, q, u, d, x)
            gap, _ = _gap(plate, x, t, slope)
            density = 0.5 * PENALTY_N_PER_MM3 * min(gap, 0.0) ** 2
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
    """Add the derivatives by nodes and travel.

    `force` (n, 3) gets the first, `blocks` (b, 3, 3) the second and `border` (n, 3) the
    mixed one. Without `exact` what slides has its secant stiffness, above the energy.
    Returns the derivatives by the travel: force in N, stiffness in N/mm.
    """
    d, x, slope, s = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    push, H = np.empty(3), np.empty((3, 3))
    closing, stiffness = 0.0, 0.0
    for f in range(skin.areas.shape[0]):
        for q in range(6):
            _place(skin, f, q, u, d, x)
            gap, bend = _gap(plate, x, t, slope)
            length, limit = _elastic_slip(plate, friction_state, skin.friction, f, q, d, s)
            if gap >= 0 and not limit > 0:
                continue
            area = skin.areas[f, q]
            k = area * PENALTY_N_PER_MM3 if gap < 0 else 0.0
            # The gap shrinks with the travel of the upper plate by its own cosine.
            rate = 0.0
            if plate.side > 0:
                for i in range(3):
                    rate += slope[i] * plate.frame[2, i]
            for i in range(3):
                push[i] = k * gap * slope[i]
                for j in range(3):
                    H[i, j] = k * (
                        slope[i] * slope[j] + gap * bend * plate.frame[0, i] * plate.frame[0, j]
                    )
            closing += k * gap * rate
            stiffness += k * rate * rate
            if limit > 0:
                sticks = SLIP_N_PER_MM3 * length <= limit
                secant = area * (SLIP_N_PER_MM3 if sticks else limit / length)
                for i in range(3):
                    for c in range(2):
                        push[i] += secant * s[c] * plate.frame[c, i]
                        for j in range(3):
                            H[i, j] += secant * plate.frame[c, i] * plate.frame[c, j]
                            if exact and not sticks:
                                for e in range(2):
                                    H[i, j] -= (
                                        secant
                                        * s[c]
                                        * s[e]
                                        / length**2
                                        * plate.frame[c, i]
                                        * plate.frame[e, j]
                                    )
            for a in range(6):
                n, weight = skin.faces[f, a], skin.shapes[q, a]
                for i in range(3):
                    force[n, i] += weight * push[i]
                    border[n, i] += weight * k * rate * slope[i]
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
    """Let friction be limited by the pressure that the plate has now."""
    d, x, slope = np.empty(3), np.empty(3), np.empty(3)
    for f in range(skin.areas.shape[0]):
        for q in range(6):
            _place(skin, f, q, u, d, x)
            gap, _ = _gap(plate, x, t, slope)
            friction_state.pressure[f, q] = -PENALTY_N_PER_MM3 * min(gap, 0.0)


@njit(**CONTRACTED)
def update_friction_origin(
    skin: Skin, plate: Plate, friction_state: FrictionState, u: FloatArray
) -> None:
    """End a load step: drag what slid, or does not touch, from a new origin."""
    d, s = np.empty(3), np.empty(2)
    for f in range(skin.areas.shape[0]):
        for q in range(6):
            _displacement(skin, f, q, u, d)
            length, limit = _elastic_slip(plate, friction_state, skin.friction, f, q, d, s)
            reach = limit / SLIP_N_PER_MM3
            if length > reach:
                for k in range(2):
                    friction_state.origin[f, q, k] += s[k] * (1 - reach / length)
