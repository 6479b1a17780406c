"""A sheet alone: taut, wrinkled along its larger stretch, or slack.

::

    l2
     |   .                taut      l2 >= 1/sqrt(l1)
     |     .
    1 +- - - o            o at rest, where the three meet
     |  slack|  .
     |       |     .      wrinkled  l2 < 1/sqrt(l1), l1 > 1
     +-------+------------- l1 (the greater)
             1
"""

import numpy as np
import pytest
from scipy.optimize import minimize

from palpate.workers.mechanics.fem.membrane import Sheet, sheet_assemble, sheet_energy, sheet_of

STIFFNESS = 0.25
SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]], float)
HALVES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
STRETCHES = {"taut": (1.4, 0.95), "wrinkled": (1.4, 0.6), "slack": (0.95, 0.8)}


def square() -> Sheet:
    """Return a sheet of 2 mm by 3 mm."""
    return sheet_of(SQUARE, HALVES)


def turned(seed: int) -> np.ndarray:
    """Return a random rotation, shape (3, 3)."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return Q * np.linalg.det(Q)


def stretched(l1: float, l2: float, angle: float = 0.0, seed: int | None = None) -> np.ndarray:
    """Stretch the square by l1 along `angle` and by l2 across, then rotate it in space."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    x = SQUARE @ (R @ np.diag([l1, l2, 1.0]) @ R.T).T
    return x if seed is None else x @ turned(seed).T


def energy(x: np.ndarray, wrinkles: bool = True) -> float:
    return sheet_energy(x, *square().arrays, STIFFNESS, wrinkles)


def derivatives(x: np.ndarray, wrinkles: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return the force, (4, 3), and the dense tangent, (12, 12)."""
    force, K = np.zeros_like(x), np.zeros((16, 9), np.float32)
    edge = (4 * HALVES[:, :, None] + HALVES[:, None, :]).astype(np.int32)
    sheet_assemble(x, *square().arrays, STIFFNESS, wrinkles, edge, force, K)
    return force, K.reshape(4, 4, 3, 3).transpose(0, 2, 1, 3).reshape(12, 12).astype(float)


def force_alone(x: np.ndarray, wrinkles: bool = True) -> np.ndarray:
    force = np.zeros_like(x)
    edge = np.zeros((2, 3, 3), np.int32)
    arrays = square().arrays
    sheet_assemble(x, *arrays, STIFFNESS, wrinkles, edge, force, np.zeros((0, 9), np.float32))
    return force


def taut_density(l1: float, l2: float) -> float:
    return STIFFNESS / 2 * (l1**2 + l2**2 + (l1 * l2) ** -2 - 3)


def strip_density(l: float) -> float:
    """Return the energy density of a strip pulled along its length, with free width."""
    return STIFFNESS / 2 * (l**2 + 2 / l - 3)


def strip_tension(l: float) -> float:
    """Return the tension in N per mm of undeformed width."""
    return STIFFNESS * (l - l**-2)


@pytest.mark.parametrize(
    ("name", "density"),
    [("taut", taut_density(1.4, 0.95)), ("wrinkled", strip_density(1.4)), ("slack", 0.0)],
)
@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, np.pi / 2])
def test_energy_is_the_closed_form_in_any_orientation(name, density, angle):
    x = stretched(*STRETCHES[name], angle, seed=5)
    assert energy(x) == pytest.approx(6 * density, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("l1", [0.7, 0.95, 1.05, 1.3, 2.0])
@pytest.mark.parametrize("l2", [0.3, 0.6, 0.9, 1.1, 1.5])
def test_energy_is_the_minimum_over_all_folds(l1, l2):
    """Folds only shorten: the least of W(a, b) over a >= l1 and b >= l2 (Pipkin 1986)."""
    found = minimize(
        lambda l: taut_density(*l),
        (l1 + 0.5, l2 + 0.5),
        bounds=[(l1, None), (l2, None)],
        options={"ftol": 1e-15, "gtol": 1e-9},
    )
    assert energy(stretched(l1, l2)) == pytest.approx(6 * found.fun, rel=1e-7, abs=1e-8)


@pytest.mark.parametrize("wrinkles", [True, False])
@pytest.mark.parametrize("name", STRETCHES)
def test_force_and_tangent_are_derivatives(name, wrinkles):
    rng, h = np.random.default_rng(7), 1e-6
    x = stretched(*STRETCHES[name], 0.4, seed=5) + rng.uniform(-0.02, 0.02, (4, 3))
    force, tangent = derivatives(x, wrinkles)
    np.testing.assert_array_equal(force_alone(x, wrinkles), force)
    steps = h * np.eye(12).reshape(12, 4, 3)
    slopes = [(energy(x + s, wrinkles) - energy(x - s, wrinkles)) / (2 * h) for s in steps]
    np.testing.assert_allclose(force.ravel(), slopes, atol=2e-9)
    columns = [
        (force_alone(x + s, wrinkles) - force_alone(x - s, wrinkles)).ravel() / (2 * h)
        for s in steps
    ]
    # Blocks are stored in single precision.
    np.testing.assert_allclose(tangent, tangent.T, atol=3e-7)
    np.testing.assert_allclose(tangent, np.transpose(columns), atol=1e-6)


@pytest.mark.parametrize("seed", range(40))
def test_tangent_is_positive_semidefinite(seed):
    """W is convex in the positions, except for a sheet that cannot wrinkle."""
    rng = np.random.default_rng(seed)
    x = SQUARE * rng.uniform(0.4, 1.6) + rng.uniform(-0.6, 0.6, (4, 3))
    force, tangent = derivatives(x)
    assert np.linalg.eigvalsh(tangent).min() >= -1e-6
    y = x + rng.uniform(-0.6, 0.6, (4, 3))
    assert energy(y) >= energy(x) + np.vdot(force, y - x) - 1e-12


def test_sheet_without_wrinkles_buckles_when_compressed():
    _, tangent = derivatives(stretched(*STRETCHES["slack"]), wrinkles=False)
    assert np.linalg.eigvalsh(tangent).min() < -0.1 * STIFFNESS


@pytest.mark.parametrize(
    ("border", "across"),
    [
        pytest.param((1.3, 1.3**-0.5), (0.0, 1.0), id="taut to wrinkled"),
        pytest.param((1.0, 0.7), (1.0, 0.0), id="wrinkled to slack"),
        pytest.param((1.0, 1.0), (1.0, 1.0), id="taut to slack"),
    ],
)
def test_energy_and_force_but_not_the_tangent_are_continuous(border, across):
    border, across = np.array(border), np.array(across)
    jumps = []
    for h in (1e-3, 1e-5):
        ahead, behind = (stretched(*(border + sign * h * across), 0.4) for sign in (1, -1))
        (f1, K1), (f2, K2) = derivatives(ahead), derivatives(behind)
        middle = np.vdot(f1 + f2, ahead - behind) / 2
        missing = energy(ahead) - energy(behind) - middle
        jumps.append((abs(missing), np.abs(f1 - f2).max(), np.abs(K1 - K2).max()))
    (e_far, f_far, _), (e_near, f_near, K_near) = jumps
    assert e_near < 2e-4 * e_far
    assert f_near < 2e-2 * f_far
    assert K_near > 0.1 * STIFFNESS


@pytest.mark.parametrize("narrowed", [1.0, 0.8, 0.3, 0.0])
@pytest.mark.parametrize(("along", "end", "width"), [(0, [1, 2], 3), (1, [2, 3], 2)])
def test_strip_narrower_than_its_free_width_pulls_like_a_free_strip(along, end, width, narrowed):
    """mu t (l - l^-2) along, nothing across; narrowed to a line it is still a strip."""
    l = 1.5
    x = SQUARE * np.where(np.arange(3) == along, l, narrowed * l**-0.5)
    force = force_alone(x)
    assert force[end, along].sum() == pytest.approx(width * strip_tension(l), rel=1e-12)
    assert force[:, along].sum() == pytest.approx(0, abs=1e-14)
    np.testing.assert_allclose(np.delete(force, along, axis=1), 0, atol=1e-14)


@pytest.mark.parametrize("shear", [0.1, 0.5, 1.5])
def test_sheared_strip_is_a_diagonal_tension_field(shear):
    """Between rails at constant distance, x += g y: l1 l2 = 1, so it wrinkles at any g.

    With l1 - 1/l1 = g, a rail carries mu t (l1 - l1^-2) dl1/dg a mm, and as l1 is the
    length of the image of the wrinkles' direction n, it is drawn to the other by
    mu t (1 - l1^-3) n_y^2 a mm.
    """
    x = SQUARE + np.outer(SQUARE[:, 1], [shear, 0, 0])
    l = shear / 2 + np.hypot(1, shear / 2)
    slope = l**2 / (1 + l**2)
    force = force_alone(x)[[2, 3]].sum(axis=0)
    assert force[0] == pytest.approx(2 * strip_tension(l) * slope, rel=1e-12)
    direction = np.array([1, l]) / np.hypot(1, l)
    drawn = STIFFNESS * (1 - l**-3) * direction[1] ** 2
    assert force[1] == pytest.approx(2 * drawn, rel=1e-12)


def test_slack_sheet_has_no_force_or_energy():
    x = stretched(*STRETCHES["slack"], 0.3, seed=2)
    force, tangent = derivatives(x)
    assert energy(x) == 0
    assert not force.any()
    assert not tangent.any()


def test_wrinkling_does_not_affect_a_taut_sheet():
    x = stretched(*STRETCHES["taut"], 0.3, seed=2)
    assert energy(x) == energy(x, wrinkles=False)
    for a, b in zip(derivatives(x), derivatives(x, wrinkles=False), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("seed", range(5))
def test_sheet_at_rest_is_taut_in_any_position(seed):
    """Rounding must not select among the three regimes that meet there."""
    x = SQUARE @ turned(seed).T + [30.0, -40.0, 50.0]
    _, tangent = derivatives(x)
    np.testing.assert_array_equal(tangent, derivatives(x, wrinkles=False)[1])
    # Of 12 motions six are rigid, and one folds the square along its diagonal.
    assert (np.linalg.eigvalsh(tangent) > 1e-3).sum() == 5
