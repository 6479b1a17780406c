"""Laws and deformations shared by the tests of this folder."""

import numpy as np

from palpate.workers.mechanics.materials.fung import Fung
from palpate.workers.mechanics.materials.ogden import Ogden
from palpate.workers.mechanics.materials.polynomial_laws import MooneyRivlin, NeoHookean, Yeoh
from tests.workers.mechanics.materials.fibre_laws import Fibres

ISOCHORIC = {
    "neo-hookean": NeoHookean(0.003),
    "mooney": MooneyRivlin(0.16, 0.05),
    "mooney-of-brain": MooneyRivlin(-0.0038, 0.0048),
    "mooney-rivlin-5": MooneyRivlin(0.2, 0.1, 0.3, -0.25, 0.15),
    "yeoh-of-rubber": Yeoh(0.175, -7.5e-4, 3.3e-5),
    "yeoh-stiffening": Yeoh(0.002, 0.01, 0.3),
    "fung-soft": Fung(0.02, 0.1),
    "fung-steep": Fung(0.0009, 4.0),
    "ogden-treloar": Ogden((0.63, 0.0012, -0.01), (1.3, 5.0, -2.0)),
    "ogden-of-brain": Ogden.from_convention("abaqus", (0.0015,), (-18.9,)),
    "ogden-1": Ogden((0.4,), (1.0,)),
    "ogden-near-zero": Ogden((8.0, 0.1), (0.01, 3.0)),
}

ALONG = np.array([0.6, -0.3, 2.0])
FIBRES = {
    "plain": Fibres(0.02, ALONG, tension_only=False),
    "plain-tension": Fibres(0.02, ALONG),
    "isochoric": Fibres(0.02, ALONG, tension_only=False, isochoric=True),
    "isochoric-tension": Fibres(0.02, ALONG, isochoric=True),
}


def rotation(seed: int) -> np.ndarray:
    """Return a random rotation."""
    Q, R = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    Q *= np.sign(np.diag(R))
    return Q * np.linalg.det(Q)


def deformations() -> np.ndarray:
    """Return large and small deformations, with and without volume change, shape (n, 3, 3).

    The first is rest; the next ones have two or three equal or nearly equal stretches.
    """
    rng = np.random.default_rng(7)
    diagonals = [
        [1.0, 1.0, 1.0],
        [1.3, 1.3, 1.3],
        [1.8, 1.8**-0.5, 1.8**-0.5],
        [0.6, 0.6, 1.7],
        [1.4, 1.4 + 1e-9, 0.8],
        [0.9, 0.9 + 1e-5, 0.9 - 2e-7],
    ]
    special = [np.diag(d) for d in diagonals]
    turned = [rotation(k) @ F @ rotation(k + 20) for k, F in enumerate(special[1:])]
    drawn = np.eye(3) + rng.uniform(-0.5, 0.5, (60, 3, 3))
    drawn = drawn[np.linalg.det(drawn) > 0.25][:30]
    assert len(drawn) == 30
    return np.concatenate([special, turned, drawn])


def complex_step(f, F: np.ndarray) -> np.ndarray:
    """Return the derivative of an analytic f with respect to F, exact to rounding."""
    return _by_entries(lambda E: np.imag(f(F + 1e-30j * E)) / 1e-30)


def differences(f, F: np.ndarray, h: float = 2e-4) -> np.ndarray:
    """Return the derivative of f with respect to F by five points, of fourth order in h."""

    def along(E: np.ndarray) -> np.ndarray:
        near, far = f(F + h * E) - f(F - h * E), f(F + 2 * h * E) - f(F - 2 * h * E)
        return (8 * near - far) / (12 * h)

    return _by_entries(along)


def _by_entries(along) -> np.ndarray:
    columns = [along(E) for E in np.eye(9).reshape(9, 3, 3)]
    stacked = np.stack(columns, axis=-1)
    return stacked.reshape(*stacked.shape[:-1], 3, 3)


def assert_close(
    computed: np.ndarray, expected: np.ndarray, tolerance: float, scale: float
) -> None:
    """Check every entry, relative to the largest of its point and to `scale`."""
    assert computed.shape == expected.shape
    axes = tuple(range(1, computed.ndim))
    size = np.abs(expected).max(axis=axes, initial=0) if axes else np.abs(expected)
    error = (
        np.abs(computed - expected).max(axis=axes, initial=0) if axes else abs(computed - expected)
    )
    assert np.all(error <= tolerance * (size + scale)), (error / (size + scale)).max()
