"""Skin as a sheet, with and without a body under it."""

import numpy as np
import pytest
from scipy.optimize import brentq
from solids import FAR, MIRRORS, ball, body, box, nominal_mpa, symmetric

from storage.values import Tissue
from workers.fem.level import Level, Stage, State
from workers.fem.loads import Device, Hold, NoPlates, Pressure
from workers.fem.problem import Constants, Membrane, Problem
from workers.fem.regions import EVERYWHERE, Box
from workers.fem.solve import equilibrium

SIZE = (8.0, 10.0, 6.0)
SKIN = Membrane(0.3, 0.5)
SHEET = SKIN.young_mpa / 3 * SKIN.thickness_mm


@pytest.mark.parametrize("stretch", [1.3, 1.6])
def test_sheet_and_body_add_up_in_pure_shear(stretch):
    """Stretched along y, held along x, free along z, with skin on the face z = max.

    The body carries P_y(1, l, lz) with P_z = 0, the sheet mu t (l - l^-3).
    """
    c = Constants(0.02, 0.4)
    model = body([(3, 3, 3)], box(*SIZE), jitter=0.2, bare=lambda unit: unit[:, 2] < 1 - 1e-9)
    ends = [
        Hold(Box((-FAR, y - 1e-6, -FAR), (FAR, y + 1e-6, FAR)), (0, u, 0), (False, True, False))
        for y, u in ((0.0, 0.0), (SIZE[1], SIZE[1] * (stretch - 1)))
    ]
    problem = Problem(
        {Tissue.FAT: c},
        NoPlates(),
        membrane=SKIN,
        holds=(Hold(EVERYWHERE, axes=(True, False, False)), *ends),
        tolerance_mm=1e-7,
    )
    found = equilibrium(model, problem)
    assert found.solution.outcome.converged, found.solution.outcome.reason
    lz = brentq(lambda l: nominal_mpa(c, 1, stretch, l)[2], 0.5, 2, xtol=1e-14)
    X = model.finest.nodes
    np.testing.assert_allclose(found.states[-1].x, X * [1, stretch, lz], atol=2e-5)
    level, state = found.levels[-1], found.states[-1]
    force = level.force(state, level.energy(state, found.stage), found.stage)
    at_end = X[:, 1] > SIZE[1] - 1e-9
    in_body = SIZE[0] * SIZE[2] * nominal_mpa(c, 1, stretch, lz)[1]
    in_sheet = SIZE[0] * SHEET * (stretch - stretch**-3)
    assert abs(in_sheet) > 0.5 * abs(in_body)
    assert force[at_end, 1].sum() == pytest.approx(in_body + in_sheet, rel=2e-5)


def test_energy_of_a_covered_body_is_the_sum_over_its_faces():
    """Affine deformation: mu t A/2 (l1^2 + l2^2 + (l1 l2)^-2 - 3) for each face but the wall."""
    model = body([(2, 2, 2)], box(*SIZE)).finest
    c = {Tissue.FAT: Constants(0.02, 0.4)}
    stage = Stage(None, None, 1.0, Device())
    l = np.array([1.2, 0.9, 1.1])
    state = State(model.nodes * l, 0.0)
    bare, covered = (
        Level(model, Problem(c, NoPlates(), membrane=skin)).energy(state, stage).elastic
        for skin in (None, SKIN)
    )
    exact = 0.0
    for normal, faces in ((0, 2), (1, 2), (2, 1)):
        a, b = (axis for axis in range(3) if axis != normal)
        density = l[a] ** 2 + l[b] ** 2 + (l[a] * l[b]) ** -2 - 3
        exact += faces * SIZE[a] * SIZE[b] * SHEET / 2 * density
    assert covered - bare == pytest.approx(exact, rel=1e-12)


def test_inflated_skin_of_a_ball():
    """Pull outwards by q on a ball with skin, of radius R.

    The ball dilates evenly, so q = kappa (l^3 - 1) + (2 mu t / R) (1/l - l^-7): its own
    bulk, and the membrane of a balloon (Holzapfel 2000, section 6.5).
    """
    c, R, pull = Constants(1e-4, 0.2), 20.0, 1.8e-3
    tension = 2 * SHEET / R

    def missing(l: float) -> float:
        return c.kappa_mpa * (l**3 - 1) + tension * (1 / l - l**-7) - pull

    exact = brentq(missing, 1.0, 1.4)
    assert c.kappa_mpa * (exact**3 - 1) < 0.05 * pull
    assert exact > 1.05
    errors = []
    for n in (3, 6):
        model = body([(n, n, n)], ball(R), bare=symmetric)
        problem = Problem(
            {Tissue.FAT: c},
            NoPlates(),
            membrane=SKIN,
            holds=MIRRORS,
            pressures=(Pressure(-pull),),
            tolerance_mm=1e-4,
        )
        found = equilibrium(model, problem)
        assert found.solution.outcome.converged, found.solution.outcome.reason
        X = model.finest.nodes
        at = np.linalg.norm(X, axis=1) > R - 1e-6
        stretch = float(np.linalg.norm(found.states[-1].x[at], axis=1).mean() / R)
        errors.append(stretch / exact - 1)
    assert abs(errors[1]) < 0.01 * (exact - 1)
