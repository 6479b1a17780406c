"""Checks of elastic laws."""

from collections.abc import Callable

import numpy as np

from palpate.storage.values import FloatArray
from palpate.testing.plugin_claims import check_pickles, claim
from palpate.workers.mechanics.materials.elastic_law import Isochoric

TOLERANCE = 1e-6
STEP = 2e-4


def check_law(law: Isochoric) -> None:
    """Check the contract of an isochoric law.

    It can be pickled; its energy and stress vanish at rest, and it is linear elastic for small
    strains; rotating the body before or after the deformation leaves the energy unchanged, and the
    stress rotates with the body; a change of volume stores no energy; stress and tangent
    agree with fourth-order differences of energy and stress; and the energy of an inverted body is
    nan.

    Parameters
    ----------
    law : Isochoric

    Raises
    ------
    AssertionError
        Naming the first violated condition.
    """
    name = type(law).__name__
    check_pickles(law, name)
    mu = law.shear_modulus_mpa
    claim(np.isfinite(mu) and mu > 0, f"{name} has a shear modulus of {mu} MPa.")
    F = _deformations()
    _check_shapes(law, name, F)
    _check_rest(law, name, mu)
    _check_rotations(law, name, mu, F)
    for s in (0.6, 1.5):
        _close(law.energy(s * F), law.energy(F), mu, f"{name}: a change of volume stores energy")
    text = f"{name}: the stress is not the derivative of the energy"
    _close(law.stress(F), _derivative(law.energy, F), mu, text)
    text = f"{name}: the tangent is not the derivative of the stress"
    _close(law.tangent(F), _derivative(law.stress, F), mu, text)
    inverted = law.energy(np.stack([F[8], np.diag([1.0, 1.0, -1.0])]))
    claim(
        np.isfinite(inverted[0]) and np.isnan(inverted[1]),
        f"{name}: the energy of an inverted body must be nan, found {inverted[1]}.",
    )


def _check_shapes(law: Isochoric, name: str, F: FloatArray) -> None:
    stack = F[:12].reshape(4, 3, 3, 3)
    before = stack.copy()
    for what, shape in (("energy", ()), ("stress", (3, 3)), ("tangent", (3, 3, 3, 3))):
        found = np.shape(getattr(law, what)(stack))
        wanted = (4, 3, *shape)
        claim(found == wanted, f"{name}.{what} must keep leading axes: {wanted}, found {found}.")
    claim(np.array_equal(stack, before), f"{name} changes its argument.")


def _check_rest(law: Isochoric, name: str, mu: float) -> None:
    rest = np.eye(3)
    energy = float(law.energy(rest))
    claim(abs(energy) < 1e-12 * mu, f"{name} stores {energy:g} MPa at rest.")
    stress = float(np.abs(law.stress(rest)).max())
    claim(stress < 1e-12 * mu, f"{name} has a stress of {stress:g} MPa at rest.")
    d = rest
    linear = np.einsum("ik,jl->ijkl", d, d) + np.einsum("il,jk->ijkl", d, d)
    linear -= 2 / 3 * np.einsum("ij,kl->ijkl", d, d)
    text = f"{name}: its tangent at rest does not match its shear modulus of {mu:g} MPa"
    _close(law.tangent(d)[None], mu * linear[None], mu, text)


def _check_rotations(law: Isochoric, name: str, mu: float, F: FloatArray) -> None:
    Q = _rotation(3)
    text = f"{name} is not objective: a rotation changes"
    _close(law.energy(Q @ F), law.energy(F), mu, f"{text} its energy")
    _close(law.stress(Q @ F), Q @ law.stress(F), mu, f"{text} its stress other than by rotating it")
    _close(law.energy(F @ Q), law.energy(F), mu, f"{name} is not isotropic")


def _close(found: FloatArray, expected: FloatArray, mu: float, text: str) -> None:
    axes = tuple(range(1, expected.ndim))
    size = np.abs(expected).max(axis=axes) if axes else np.abs(expected)
    difference = np.abs(found - expected)
    error = difference.max(axis=axes) if axes else difference
    worst = float((error / (size + mu)).max())
    claim(worst <= TOLERANCE, f"{text} (relative error {worst:.1e}).")


def _derivative(f: Callable[[FloatArray], FloatArray], F: FloatArray) -> FloatArray:
    """Return the derivative of `f` with respect to F, by fourth-order differences."""
    columns = []
    for E in np.eye(9).reshape(9, 3, 3):
        near = f(F + STEP * E) - f(F - STEP * E)
        far = f(F + 2 * STEP * E) - f(F - 2 * STEP * E)
        columns.append((8 * near - far) / (12 * STEP))
    stacked = np.stack(columns, axis=-1)
    return stacked.reshape(*stacked.shape[:-1], 3, 3)


def _rotation(seed: int) -> FloatArray:
    Q, R = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    Q = Q * np.sign(np.diag(R))
    turned: FloatArray = Q * np.linalg.det(Q)
    return turned


def _deformations() -> FloatArray:
    """Return deformation gradients, shape (n, 3, 3), some with (nearly) equal stretches."""
    rng = np.random.default_rng(7)
    diagonals = ([1.8, 1.8**-0.5, 1.8**-0.5], [0.7, 0.7, 1.6], [1.4, 1.4 + 1e-9, 0.8])
    special = [_rotation(k) @ np.diag(d) @ _rotation(k + 20) for k, d in enumerate(diagonals)]
    drawn = np.eye(3) + rng.uniform(-0.4, 0.4, (60, 3, 3))
    return np.concatenate([special, drawn[np.linalg.det(drawn) > 0.3][:20]])
