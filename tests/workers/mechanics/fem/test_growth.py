"""Tissue that has grown since the undeformed body was imaged."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.loads_and_regions import Box, NoPlates, Pressure, Wall
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.stress_fields import element_fields
from palpate.workers.mechanics.materials.fung import Fung
from tests.workers.mechanics.fem.solids import FAR, MIRRORS, body, box

SIZE = 10.0
NOTHING = Constants(0.01, 0.49, fibre_mpa=0.05, stiffening=0.3)
LAW = replace(NOTHING, stiffening=0.0, law=Fung(0.0034, 2.0))


def problem_of(constants, isochoric_fibre, **more):
    """Return a problem with two planes of symmetry, resting on a third."""
    return Problem(
        {Tissue.FAT: constants},
        NoPlates(),
        wall=Wall((False, False, True)),
        holds=MIRRORS,
        isochoric_fibre=isochoric_fibre,
        literal_fibre=True,
        tolerance_mm=1e-6,
        **more,
    )


@pytest.mark.parametrize("growth", [1.2, 0.9])
@pytest.mark.parametrize("isochoric_fibre", [False, True])
@pytest.mark.parametrize("constants", [NOTHING, LAW], ids=["Yeoh", "Fung"])
def test_free_body_grows_isotropically_without_stress(constants, isochoric_fibre, growth):
    """x = g^(1/3) X."""
    model = body([(3, 3, 3)], box(SIZE, SIZE, SIZE), jitter=0.2)
    problem = problem_of(replace(constants, growth=growth), isochoric_fibre)
    solution = solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    nodes = model.finest.nodes
    expected = (growth ** (1 / 3) - 1) * nodes
    np.testing.assert_allclose(solution.displacement_mm, expected, atol=1e-5)
    fields = element_fields(Level.build(model.finest, problem), nodes + expected)
    np.testing.assert_allclose(fields.volume_ratio, growth, rtol=1e-12)
    np.testing.assert_allclose(fields.cauchy_mpa, 0.0, atol=1e-12)


@pytest.mark.parametrize("isochoric_fibre", [False, True])
def test_grown_body_equals_a_larger_body(isochoric_fibre):
    """Under the same pressure both have the same final shape."""
    growth, cells = 1.25, [(4, 4, 4)]
    larger = SIZE * growth ** (1 / 3)

    def pressed(size, constants):
        model = body(cells, box(size, size, size))
        top = Box((-FAR, -FAR, size - 1e-6), (FAR, FAR, FAR))
        pressure = (Pressure(2e-3, top),)
        solution = solve(model, problem_of(constants, isochoric_fibre, pressures=pressure))
        assert solution.outcome.converged, solution.outcome.reason
        return model.finest.nodes + solution.displacement_mm

    grown = pressed(SIZE, replace(NOTHING, growth=growth))
    np.testing.assert_allclose(grown, pressed(larger, NOTHING), atol=1e-5)


def test_rejects_growth_of_plain_elements():
    with pytest.raises(InputError, match="cannot grow"):
        problem_of(replace(NOTHING, growth=1.1), False, plain_elements=True)


def test_rejects_growth_of_zero():
    with pytest.raises(InputError, match="growth > 0"):
        replace(NOTHING, growth=0.0)
