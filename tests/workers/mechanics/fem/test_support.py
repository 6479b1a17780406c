"""Numerical supports: weak springs act only where nothing else holds a body."""

import numpy as np
import pytest

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.external_forces import spring_stiffness
from palpate.workers.mechanics.fem.loads_and_regions import Box, ForceControl, Hold, NoPlates, Wall
from tests.workers.mechanics.fem.solids import FAR, body, box

SIZE = 20.0
LOW = Box((-FAR, -FAR, -FAR), (1e-6, FAR, FAR))
HIGH = Box((SIZE - 1e-6, -FAR, -FAR), (FAR, FAR, FAR))
PULL = (3.0, 0.5, 0.0)
# As soft as the softest tissue in use.
SOFT = {Tissue.FAT: Constants(0.0005, 0.45)}
LOOSE = Wall((False, False, False))


@pytest.fixture(scope="module")
def block():
    return body([(4, 3, 3)], box(SIZE, 12.0, 12.0), jitter=0.2)


def reactions(block, fixed, moved, sign):
    """Return the forces on the fixed and on the moved end in N."""
    pull = tuple(sign * v for v in PULL)
    problem = Problem(
        SOFT, NoPlates(), wall=LOOSE, holds=(Hold(fixed), Hold(moved, pull)), tolerance_mm=1e-6
    )
    found = equilibrium(block, problem)
    assert found.solution.outcome.converged
    level, state = found.levels[-1], found.states[-1]
    force = level.force(state, level.energy(state, found.stage), found.stage)
    ends = (end.contains(block.finest.nodes) for end in (fixed, moved))
    return [force[end].sum(axis=0) for end in ends]


def test_forces_on_both_ends_balance_whichever_is_fixed(block):
    low, high = reactions(block, LOW, HIGH, 1.0)
    np.testing.assert_allclose(low, -high, atol=1e-6 * np.abs(high).max())
    high_fixed, low_moved = reactions(block, HIGH, LOW, -1.0)
    np.testing.assert_allclose(low_moved, low, atol=1e-6 * np.abs(low).max())
    np.testing.assert_allclose(high_fixed, high, atol=1e-6 * np.abs(high).max())


CORNER = Box((-FAR, -FAR, -FAR), (1e-6, 1e-6, 1e-6))


@pytest.mark.parametrize(
    ("holds", "loose"),
    [
        ((), (True, True, True)),
        ((Hold(LOW),), (False, False, False)),
        ((Hold(LOW, axes=(True, False, False)),), (False, True, True)),
        # A body that is pinned may still turn.
        ((Hold(CORNER),), (True, True, True)),
    ],
)
def test_springs_act_along_the_axes_of_rigid_motions(block, holds, loose):
    problem = Problem(SOFT, NoPlates(), wall=LOOSE, holds=holds)
    springs = spring_stiffness(block.finest, problem)
    assert tuple((springs > 0).any(axis=0)) == loose


def test_flat_plates_keep_a_body_from_tilting(block):
    """Between plates along y, and held along z at one end, it slides along x alone."""
    low_z = Box((-FAR, -FAR, -FAR), (FAR, FAR, 1e-6))
    plates = ForceControl(1.0, 0.0, 12.0)
    problem = Problem(SOFT, plates, wall=LOOSE, holds=(Hold(low_z, axes=(False, False, True)),))
    springs = spring_stiffness(block.finest, problem)
    assert tuple((springs > 0).any(axis=0)) == (True, False, False)
