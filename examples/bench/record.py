"""Write the recordings of the block experiment, from theory.

::

    python examples/bench/record.py

A block of 30 x 30 x 60 mm is pulled with 18 N along its axis. Its motion is homogeneous, so every
marker follows from the stretches that balance the force: for W = mu/2 (I1bar - 3) +
kappa/2 (J - 1)^2 the lateral faces are free and the nominal axial stress is the force over the
undeformed area. The camera has 0.02 mm of noise.
"""

from pathlib import Path

import numpy as np
from scipy.optimize import fsolve

HERE = Path(__file__).parent
YOUNG_MPA, POISSON, FORCE_N = 0.2, 0.49, 18.0
SIZE_MM = np.array([30.0, 30.0, 60.0])
NOISE_MM = 0.02
MARKERS = {
    "M1": (15.0, 30.0, 55.0),
    "M2": (0.0, 15.0, 45.0),
    "M3": (15.0, 30.0, 30.0),
    "M4": (30.0, 20.0, 15.0),
}
TIMES_S = np.arange(13) * 0.5
LOADED_FROM_S = 3.0


def stretches() -> tuple[float, float]:
    """Return the lateral and the axial stretch under the full force."""
    mu = YOUNG_MPA / (2 * (1 + POISSON))
    kappa = YOUNG_MPA / (3 * (1 - 2 * POISSON))

    def unbalanced(stretch: np.ndarray) -> tuple[float, float]:
        side, axial = stretch
        volume = side**2 * axial
        mean = (2 * side**2 + axial**2) / 3
        shape = mu * volume ** (-2 / 3)
        pressure = kappa * (volume - 1) * volume
        nominal = FORCE_N / (SIZE_MM[0] * SIZE_MM[1])
        return (
            shape * (side**2 - mean) + pressure,
            (shape * (axial**2 - mean) + pressure) / axial - nominal,
        )

    side, axial = fsolve(unbalanced, (0.95, 1.1), xtol=1e-12)
    return float(side), float(axial)


def record(seed: int) -> np.ndarray:
    """Return a row for each moment: the time and the places of all markers."""
    side, axial = stretches()
    scale = np.array([side, side, axial])
    noise = np.random.default_rng(seed).normal(0, NOISE_MM, (len(TIMES_S), len(MARKERS), 3))
    rest = np.array(list(MARKERS.values()))
    loaded = TIMES_S >= LOADED_FROM_S
    places = np.where(loaded[:, None, None], rest * scale, rest) + noise
    return np.column_stack([TIMES_S, places.reshape(len(TIMES_S), -1)])


if __name__ == "__main__":
    names = ["t_s", *(f"{marker}_{axis}_mm" for marker in MARKERS for axis in "xyz")]
    for seed, file in enumerate(("pull_a.csv", "pull_b.csv")):
        table = record(seed)
        np.savetxt(HERE / file, table, "%.3f", ",", header=",".join(names), comments="")
