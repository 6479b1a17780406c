"""Assertions of the plug-in checks, and the small asymmetric breast that they deform."""

import pickle
from typing import Any

import numpy as np

from palpate.storage.values import Tissue, Volume
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Membrane, Problem
from palpate.workers.mechanics.fem.loads_and_regions import Device, ForceControl, Plate, Wall


def claim(holds: object, text: str) -> None:
    """Raise an `AssertionError` with `text` unless a condition holds."""
    if not holds:
        raise AssertionError(text)


def check_pickles(value: Any, name: str) -> None:
    """Check that a value can be pickled and sent to workers.

    Raises
    ------
    AssertionError
        If it cannot; a lambda, for example.
    """
    try:
        pickle.loads(pickle.dumps(value))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise AssertionError(
            f"{name} cannot be pickled, so workers cannot use it: {error}. Use functions of a "
            "module instead of lambdas and inner functions."
        ) from error


HALF_MM = np.array([38.0, 32.0, 40.0])
NU = 0.49


def small_breast(spacing_mm: float = 2.0) -> Volume:
    """Return a bent half ellipsoid on the chest wall z = 0 with an off-centre gland."""
    along = np.arange(-44.0, 44.1, spacing_mm)
    x, y, z = np.meshgrid(along, along, np.arange(spacing_mm / 2, 44.0, spacing_mm), indexing="ij")
    place = np.stack([x - 0.10 * z, y + 0.06 * z, z], axis=-1)
    body = ((place / HALF_MM) ** 2).sum(axis=-1) < 1
    gland = (((place - [7.0, 4.0, 14.0]) / [17.0, 13.0, 13.0]) ** 2).sum(axis=-1) < 1
    labels = np.where(body, np.where(gland, Tissue.GLANDULAR, Tissue.FAT), Tissue.AIR)
    origin = (-44.0, -44.0, spacing_mm / 2)
    return Volume(labels.astype(np.uint8).transpose(2, 1, 0), (spacing_mm,) * 3, origin)


def plain_problem() -> Problem:
    """Return a problem with two flat plates and an elastic chest wall."""
    return Problem(
        constants={
            Tissue.FAT: Constants(0.010, NU, 0.02),
            Tissue.GLANDULAR: Constants(0.030, NU, 0.03),
        },
        load=ForceControl(20.0, -33.0, 33.0),
        wall=Wall((False, False, True), (2e-4, 1e-4, 0.0)),
    )


def busy_problem() -> Problem:
    """Return a problem with nearly every field set to a non-default value."""
    tilted = Plate(tilt_deg=(1.0, -2.0), bow_per_mm=(1e-3, 2e-3))
    plain = plain_problem()
    return Problem(
        constants=plain.constants,
        load=ForceControl(20.0, -33.0, 33.0, Device(upper=tilted, friction=0.1, lower_share=0.3)),
        membrane=Membrane(0.5, 1.5),
        wall=Wall((False, False, False), (1e-4, 2e-4, 3e-3)),
        gravity_g=(0.1, 0.2, 0.3),
        imaged_gravity_g=(0.0, 0.1, 0.2),
    )
