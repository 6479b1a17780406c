"""The rotated cylinder, against closed forms and the curves of the thesis."""

import math
from itertools import pairwise

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.thesis.coefficient_choice import (
    CYLINDER_LENGTH_MM,
    CYLINDER_RADIUS_MM,
    CylinderRow,
    cylinder,
    cylinder_experiment,
    cylinder_row,
)


def crossed_overlap(angle_deg: float) -> tuple[float, float]:
    r"""Return the Jaccard and Dice coefficients of two crossed smooth cylinders.

    If neither end takes part, :math:`r |\cos| + r < (L / 2) |\sin|`, the intersection is a
    Steinmetz solid of volume :math:`16 r^3 / 3 \sin`.

    Raises
    ------
    InputError
        If an end takes part.
    """
    turn = math.radians(angle_deg)
    s, c = math.sin(turn), abs(math.cos(turn))
    if not CYLINDER_RADIUS_MM * (1 + c) < CYLINDER_LENGTH_MM / 2 * s:
        raise InputError(f"At {angle_deg:g} degrees the cylinders overlap up to their ends.")
    common = 16 * CYLINDER_RADIUS_MM**3 / (3 * s)
    whole = math.pi * CYLINDER_RADIUS_MM**2 * CYLINDER_LENGTH_MM
    return common / (2 * whole - common), common / whole


@pytest.fixture(scope="module")
def rows() -> dict[float, CylinderRow]:
    return {row.angle_deg: row for row in cylinder_experiment("reduced")}


@pytest.mark.parametrize("angle", [40.0, 60.0, 90.0, 115.0])
def test_overlap_of_crossed_cylinders_converges_to_steinmetz_solid(angle: float) -> None:
    exact = crossed_overlap(angle)
    errors = []
    for voxel in (2.0, 1.0, 0.5):
        row = cylinder_row(angle, voxel)
        errors.append(max(abs(row.jc / exact[0] - 1), abs(row.dc / exact[1] - 1)))
    assert errors[-1] < 0.005
    assert errors[-1] < errors[0]


def test_volume_does_not_depend_on_the_angle() -> None:
    exact = math.pi * CYLINDER_RADIUS_MM**2 * CYLINDER_LENGTH_MM
    for angle in (0.0, 33.0, 90.0):
        volume = cylinder(angle, 0.5)
        assert np.count_nonzero(volume.values) * volume.voxel_mm3 == pytest.approx(exact, rel=0.01)


def test_jaccard_and_dice_are_least_at_90_degrees(rows: dict[float, CylinderRow]) -> None:
    for name in ("jc", "dc"):
        assert min(rows, key=lambda angle: getattr(rows[angle], name)) == 90
    falling = [rows[a].jc for a in sorted(rows) if a <= 90]
    assert all(a > b for a, b in pairwise(falling))


def test_dice_decays_less_than_jaccard(rows: dict[float, CylinderRow]) -> None:
    for angle, row in rows.items():
        if angle not in (0, 180):
            assert 1 - row.dc < 1 - row.jc
            # DC = 2 JC / (1 + JC), here from independent counts.
            assert row.dc == pytest.approx(2 * row.jc / (1 + row.jc))


def test_half_turn_is_the_identity_and_curves_are_symmetric(rows: dict[float, CylinderRow]) -> None:
    for angle in (0, 180):
        assert (rows[angle].jc, rows[angle].mhd_mm, rows[angle].gsf) == (1.0, 0.0, -math.inf)
    for angle in (1, 5, 30, 85):
        assert rows[angle].jc == rows[180 - angle].jc
        assert rows[angle].mhd_mm == pytest.approx(rows[180 - angle].mhd_mm)


def test_gsf_falls_steeply_near_identity(rows: dict[float, CylinderRow]) -> None:
    gsf = [rows[a].gsf for a in (0, 1, 2, 5, 10, 90)]
    assert gsf == sorted(gsf)
    per_degree = (rows[2].gsf - rows[1].gsf, (rows[90].gsf - rows[45].gsf) / 45)
    assert per_degree[0] > 10 * per_degree[1]


def test_rejects_angles_without_a_closed_form() -> None:
    with pytest.raises(InputError, match="up to their ends"):
        crossed_overlap(5.0)
    with pytest.raises(InputError, match="size must be > 0"):
        cylinder(10.0, 0.0)
