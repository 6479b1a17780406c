"""The strain energy of the thesis, implemented independently for complex numbers."""

import numpy as np

STEP = 1e-30


def energy(stretches, constants):
    """Return W of Eq. 5.1 in MPa; stretches (..., 3) may be complex."""
    J = stretches.prod(axis=-1)
    isochoric = stretches * J[..., None] ** (-1 / 3)
    total = 0.0
    for i, (mu, alpha) in enumerate(zip(constants.mu_mpa, constants.alpha, strict=True), start=1):
        factor = {
            "mu/alpha": mu / alpha,
            "2mu/alpha^2": 2 * mu / alpha**2,
            "mu/alpha^2": mu / alpha**2,
        }[constants.convention]
        total = total + factor * ((isochoric**alpha).sum(axis=-1) - 3)
        total = total + constants.bulk_mpa / 2 * (J - 1) ** (2 * i)
    return total


def nominal_stress(stretches, constants):
    """Return dW/d lambda_a by the complex step, (..., 3)."""
    stretches = np.asarray(stretches, dtype=complex)
    columns = []
    for a in range(3):
        shifted = stretches.copy()
        shifted[..., a] += 1j * STEP
        columns.append(np.imag(energy(shifted, constants)) / STEP)
    return np.stack(columns, axis=-1)


def young_and_poisson(constants):
    G, K = constants.shear_modulus_mpa, constants.bulk_mpa
    return 9 * K * G / (3 * K + G), (3 * K - 2 * G) / (2 * (3 * K + G))
