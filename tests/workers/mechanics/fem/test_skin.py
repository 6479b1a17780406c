"""Skin as a sheet, with and without a body under it."""

import numpy as np
import pytest
from scipy.optimize import brentq

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Membrane, Problem
from palpate.workers.mechanics.fem.discretisation import Stage, State
from palpate.workers.mechanics.fem.loads_and_regions import Box, Device, Hold, NoPlates, Pressure
from palpate.workers.mechanics.fem.mesh_level import Level
from tests.workers.mechanics.fem.solids import FAR, MIRRORS, ball, body, box, nominal_mpa, symmetric

SIZE = (8.0, 10.0, 6.0)
SKIN = Membrane(0.3, 0.5)
SHEET = SKIN.young_mpa / 3 * SKIN.thickness_mm


def energy_per_area(l1: float, l2: float) -> float:
    """Return the energy of a taut, wrinkled or slack sheet (Pipkin 1986), in mJ/mm^2."""
    l1, l2 = max(l1, l2), min(l1, l2)
    if l2 >= l1**-0.5:
        return SHEET / 2 * (l1**2 + l2**2 + (l1 * l2) ** -2 - 3)
    return SHEET / 2 * (l1**2 + 2 / l1 - 3) if l1 > 1 else 0.0


@pytest.mark.parametrize(
    ("lx", "ly", "tension"),
    [
        pytest.param(1.0, 1.3, (1 - 1.3**-2, 1.3 - 1.3**-3), id="taut"),
        pytest.param(1.0, 1.6, (1 - 1.6**-2, 1.6 - 1.6**-3), id="taut and long"),
        pytest.param(0.8, 1.3, (0, 1.3 - 1.3**-2), id="wrinkled"),
        pytest.param(0.8, 0.9, (0, 0), id="slack"),
    ],
)
def test_stresses_of_sheet_and_body_add_up(lx, ly, tension):
    """Stretched along x and y, free along z, with skin on the face z = max.

    The body carries P(lx, ly, lz) with P_z = 0. The sheet carries, in mu t, lx - lx^-3 ly^-2
    and the same along y where it is taut, ly - ly^-2 along y alone where it is wrinkled,
    and nothing where it is slack.
    """
    c = Constants(0.02, 0.4)
    model = body([(3, 3, 3)], box(*SIZE), jitter=0.2, bare=lambda unit: unit[:, 2] < 1 - 1e-9)
    x, y = SIZE[0], SIZE[1]
    ends = (
        Hold(
            Box((x - 1e-6, -FAR, -FAR), (FAR, FAR, FAR)), (x * (lx - 1), 0, 0), (True, False, False)
        ),
        Hold(
            Box((-FAR, y - 1e-6, -FAR), (FAR, FAR, FAR)), (0, y * (ly - 1), 0), (False, True, False)
        ),
    )
    problem = Problem(
        {Tissue.FAT: c}, NoPlates(), membrane=SKIN, holds=(*MIRRORS, *ends), tolerance_mm=1e-7
    )
    found = equilibrium(model, problem)
    assert found.solution.outcome.converged, found.solution.outcome.reason
    lz = brentq(lambda l: nominal_mpa(c, lx, ly, l)[2], 0.5, 2, xtol=1e-14)
    X = model.finest.nodes
    np.testing.assert_allclose(found.states[-1].x, X * [lx, ly, lz], atol=2e-5)
    level, state = found.levels[-1], found.states[-1]
    force = level.force(state, level.energy(state, found.stage), found.stage)
    for axis, width in ((0, y), (1, x)):
        at_end = X[:, axis] > SIZE[axis] - 1e-9
        in_body = width * SIZE[2] * nominal_mpa(c, lx, ly, lz)[axis]
        in_sheet = width * SHEET * tension[axis]
        assert in_sheet == 0 or abs(in_sheet) > 0.4 * abs(in_body)
        assert force[at_end, axis].sum() == pytest.approx(in_body + in_sheet, rel=2e-5)


@pytest.mark.parametrize("l", [(1.2, 0.9, 1.1), (0.95, 0.9, 1.1)], ids=["no slack face", "slack"])
def test_energy_of_a_covered_body_is_the_sum_over_its_faces(l):
    """Affine deformation: each face except the wall has its own energy."""
    model = body([(2, 2, 2)], box(*SIZE)).finest
    c = {Tissue.FAT: Constants(0.02, 0.4)}
    stage = Stage(None, None, 1.0, Device())
    state = State(model.nodes * np.array(l), 0.0)
    bare, covered = (
        Level.build(model, Problem(c, NoPlates(), membrane=skin)).energy(state, stage).elastic
        for skin in (None, SKIN)
    )
    exact = 0.0
    for normal, faces in ((0, 2), (1, 2), (2, 1)):
        a, b = (axis for axis in range(3) if axis != normal)
        exact += faces * SIZE[a] * SIZE[b] * energy_per_area(l[a], l[b])
    assert covered - bare == pytest.approx(exact, rel=1e-12)


def test_inflated_ball_with_skin_matches_the_closed_form():
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
