"""Springs on a patch of the boundary."""

import numpy as np
import pytest
from scipy.special import erf

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.loads_and_regions import (
    EVERYWHERE,
    Attachment,
    DeadForce,
    NoPlates,
    Wall,
)
from tests.workers.mechanics.fem.solids import body, box

SIZE = 10.0
HALF = SIZE / 2


def shift_mm(attachments, cells=(6, 6, 6)):
    """Return the shift of a nearly rigid body under 0.02 N along x."""
    model = body([cells], box(SIZE, SIZE, SIZE, origin=(-HALF, -HALF, 0.0)))
    problem = Problem(
        {Tissue.FAT: Constants(10.0, 0.3)},
        NoPlates(),
        wall=Wall((False, False, False)),
        attachments=attachments,
        forces=(DeadForce((0.02, 0.0, 0.0), EVERYWHERE),),
        tolerance_mm=1e-7,
    )
    solution = solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    u = solution.displacement_mm
    np.testing.assert_allclose(u, np.broadcast_to(u.mean(axis=0), u.shape), atol=3e-3)
    return u[:, 0].mean()


def test_wide_attachment_holds_skin_and_chest_wall_equally():
    """F = k A u with the area of all six faces."""
    wide = Attachment((1e-4,) * 3, (0.0, 0.0, HALF), 1e5)
    assert shift_mm((wide,)) == pytest.approx(0.02 / (1e-4 * 6 * SIZE**2), rel=1e-4)


def test_attachment_falls_off_as_a_normal_distribution():
    """Integral of exp(-d^2 / 2 r^2) over six faces at 5 mm from its centre."""
    r = 3.0
    across = np.sqrt(2 * np.pi) * r * erf(HALF / np.sqrt(2) / r)
    area = 6 * np.exp(-(HALF**2) / (2 * r**2)) * across**2
    patch = Attachment((1e-3,) * 3, (0.0, 0.0, HALF), r)
    assert shift_mm((patch,), (8, 8, 8)) == pytest.approx(0.02 / (1e-3 * area), rel=0.02)


def test_only_springs_along_the_force_matter():
    """F = k_x A u_x, whatever k_y and k_z are."""
    wide = Attachment((1e-5, 1e-3, 1e-2), (0.0, 0.0, HALF), 1e5)
    assert shift_mm((wide,)) == pytest.approx(0.02 / (1e-5 * 6 * SIZE**2), rel=1e-3)


def test_attachments_add_up():
    wide = Attachment((1e-4,) * 3, (0.0, 0.0, HALF), 1e5)
    assert shift_mm((wide, wide)) == pytest.approx(shift_mm((wide,)) / 2, rel=1e-4)


@pytest.mark.parametrize(("stiffness", "radius"), [(-1.0, 3.0), (1.0, 0.0)])
def test_rejects_invalid_attachments(stiffness, radius):
    with pytest.raises(InputError, match="springs >= 0 and a radius > 0"):
        Attachment((1.0, 0.0, stiffness), (0.0, 0.0, 0.0), radius)
