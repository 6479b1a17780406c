"""Force and tangent are the derivatives of the energy, for every part of it."""

import numpy as np
import pytest
from blocks import cube, loose_level, model_of

from storage.values import Tissue
from workers.fem import membrane, operators
from workers.fem.contact import Gap
from workers.fem.level import Level
from workers.fem.problem import Constants, DistanceControl, Membrane, Problem

FAT = Constants(0.01, 0.49, fibre_mpa=0.02)
OPEN = Gap(-1e6, 1e6)


@pytest.fixture(scope="module")
def model():
    return model_of(cube(2, jitter=0.2)).finest


def level_with(model, kind: str) -> tuple[Level, Gap]:
    gap = Gap(0.3, 9.5) if kind == "plates" else OPEN
    options = {"plain_elements": kind == "plain", "literal_fibre": kind == "literal fibre"}
    if kind == "tilted fibre":
        options["fibre"] = (1.0, 2.0, -0.5)
    skin = Membrane(0.5, 1.5) if kind == "skin" else None
    problem = Problem({Tissue.FAT: FAT}, DistanceControl(0, 10), membrane=skin, **options)
    level = Level(model, problem)
    level.free[:] = 1
    return level, gap


KINDS = ["nodal volume", "plain", "literal fibre", "tilted fibre", "skin", "plates"]


@pytest.mark.parametrize("kind", KINDS)
def test_force_is_the_derivative_of_the_energy(model, kind):
    level, gap = level_with(model, kind)
    rng = np.random.default_rng(1)
    x = model.nodes + rng.uniform(-0.5, 0.5, model.nodes.shape)
    force, _ = level.linearise(x, level.energy(x, gap), moving_plate=False)
    direction = rng.standard_normal(x.shape)
    h = 1e-5
    slope = (
        level.energy(x + h * direction, gap).stored - level.energy(x - h * direction, gap).stored
    ) / (2 * h)
    assert np.vdot(force, direction) == pytest.approx(slope, rel=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_tangent_is_the_derivative_of_the_force(model, kind):
    level, gap = level_with(model, kind)
    rng = np.random.default_rng(2)
    x = model.nodes + rng.uniform(-0.5, 0.5, model.nodes.shape)
    direction = rng.standard_normal(x.shape)
    h = 1e-6

    def force_at(y):
        return level.linearise(y, level.energy(y, gap), moving_plate=False)[0]

    expected = (force_at(x + h * direction) - force_at(x - h * direction)) / (2 * h)
    _, t = level.linearise(x, level.energy(x, gap), moving_plate=False)
    g, product = model.graph, np.empty_like(x)
    operators.multiply(
        g.start, g.neighbour, t.K, t.B, t.D, level.free, direction, np.empty(len(x)), product
    )
    # The blocks are stored in single precision.
    assert np.abs(product - expected).max() < 3e-6 * np.abs(expected).max()


@pytest.mark.parametrize("kind", KINDS)
def test_dense_tangent_is_the_sparse_one(model, kind):
    level, gap = level_with(model, kind)
    x = model.nodes * [1.1, 0.8, 1.05]
    _, t = level.linearise(x, level.energy(x, gap), moving_plate=False)
    g = model.graph
    A = operators.dense(g.start, g.neighbour, t.K, t.B, t.D, level.free)
    np.testing.assert_allclose(A, A.T, atol=1e-6 * np.abs(A).max())
    v = np.random.default_rng(3).standard_normal(x.shape)
    product = np.empty_like(x)
    operators.multiply(
        g.start, g.neighbour, t.K, t.B, t.D, level.free, v, np.empty(len(x)), product
    )
    np.testing.assert_allclose(A @ v.ravel(), product.ravel(), atol=1e-9 * np.abs(product).max())


def test_a_turned_body_stores_nothing(model):
    level = loose_level(model, FAT)
    c, s = np.cos(0.7), np.sin(0.7)
    turned = model.nodes @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) + [3, -2, 1]
    at = level.energy(turned, OPEN)
    assert at.stored == pytest.approx(0, abs=1e-12)
    force, _ = level.linearise(turned, at, moving_plate=False)
    assert np.abs(force).max() < 1e-12


def test_an_inverted_element_has_finite_energy(model):
    level = loose_level(model, FAT)
    x = model.nodes.copy()
    x[13] += 12.0
    assert np.isfinite(level.energy(x, OPEN).stored)


def test_stretched_sheet_stores_the_closed_form():
    """W = mu t A / 2 (l1^2 + l2^2 + 1 / (l1 l2)^2 - 3) for an incompressible sheet."""
    nodes = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]], float)
    sheet = membrane.sheet_of(nodes, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    l1, l2, stiffness = 1.3, 0.9, 0.25
    energy = membrane.sheet_energy(
        nodes * [l1, l2, 1], sheet.triangles, sheet.metric, sheet.area, stiffness
    )
    exact = stiffness * 6 / 2 * (l1**2 + l2**2 + 1 / (l1 * l2) ** 2 - 3)
    assert energy == pytest.approx(exact, rel=1e-12)
