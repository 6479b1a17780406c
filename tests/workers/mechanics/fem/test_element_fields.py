"""Reported stresses agree with the forces balanced by the solver."""

import numpy as np
import pytest

from palpate.storage.values import FloatArray, Tissue
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.discretisation import Stage, State
from palpate.workers.mechanics.fem.loads_and_regions import NoPlates
from palpate.workers.mechanics.fem.mesh_level import Level
from palpate.workers.mechanics.fem.stress_fields import element_fields
from palpate.workers.mechanics.materials.ogden import Ogden
from tests.workers.mechanics.fem.solids import body, box, nominal_mpa

MODEL = body([(3, 3, 3)], box(30.0, 30.0, 30.0), jitter=0.2)
FULL = Stage(None, None, 1.0, NoPlates().device)


def level_of(plain: bool = False, **constants: object) -> Level:
    options = {"literal_fibre": bool(constants.pop("literal", False))}
    options["isochoric_fibre"] = bool(constants.pop("isochoric", False))
    fat = Constants(0.01, 0.45, **constants)  # type: ignore[arg-type]
    problem = Problem({Tissue.FAT: fat}, NoPlates(), plain_elements=plain, **options)
    return Level.build(MODEL.finest, problem)


def stirred(size: float) -> FloatArray:
    """Return random positions, out of equilibrium."""
    rng = np.random.default_rng(3)
    return MODEL.finest.nodes + rng.uniform(-size, size, MODEL.finest.nodes.shape)


def nodal_forces(level: Level, piola_mpa: FloatArray) -> FloatArray:
    """Sum V P g_a over the elements around each node."""
    elements = level.model.elements
    g = np.concatenate([-elements.gradients.sum(axis=1, keepdims=True), elements.gradients], axis=1)
    share = np.einsum("e,eij,eaj->eai", elements.volumes, piola_mpa, g)
    force = np.zeros_like(level.model.nodes)
    np.add.at(force, elements.tets, share)
    return force


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize(
    "constants",
    [
        {},
        {"stiffening": 3.0},
        {"fibre_mpa": 0.1},
        {"fibre_mpa": 0.1, "second_fibre_mpa": 0.05, "isochoric": True},
        {"fibre_mpa": 0.1, "literal": True},
        {"law": Ogden((0.004, 0.001), (2.0, -3.0))},
    ],
)
@pytest.mark.parametrize("height", [1.0, 0.5])
def test_stress_reproduces_the_forces_of_the_solver(
    plain: bool, constants: dict[str, object], height: float
) -> None:
    level = level_of(plain, **constants).with_barrier()
    state = State(stirred(1.0) * [1, 1, height], 0.0)
    at = level.energy(state, FULL)
    internal = level.force(state, at, FULL) - level.outer_force(state, at.contact, FULL)
    found = nodal_forces(level, element_fields(level, state.x).piola_mpa)
    np.testing.assert_allclose(found, internal, atol=1e-9 * np.abs(internal).max())


def test_stretched_block_has_the_analytic_stress() -> None:
    level, stretch = level_of(), np.array([1.3, 0.9, 0.8])
    fields = element_fields(level, MODEL.finest.nodes * stretch)
    J = stretch.prod()
    cauchy = nominal_mpa(level.problem.constants[Tissue.FAT], *stretch) * stretch / J
    shape = (len(fields.volume_ratio), 3, 3)
    np.testing.assert_allclose(
        fields.cauchy_mpa, np.broadcast_to(np.diag(cauchy), shape), atol=1e-12
    )
    np.testing.assert_allclose(fields.volume_ratio, J)
    np.testing.assert_allclose(fields.node_volume_ratio, J)
    np.testing.assert_allclose(fields.node_pressure_mpa, -cauchy.mean())
    np.testing.assert_allclose(
        np.diagonal(fields.green_strain, axis1=1, axis2=2),
        np.broadcast_to((stretch**2 - 1) / 2, (shape[0], 3)),
    )
    a, b, c = cauchy
    mises = np.sqrt(((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) / 2)
    np.testing.assert_allclose(fields.von_mises_mpa, mises)
