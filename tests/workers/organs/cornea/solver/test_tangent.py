"""The tangent of the whole cornea against differences of its out-of-balance force."""

import numpy as np
import pytest

from palpate.workers.organs.cornea.cornea_equations import system_of
from palpate.workers.organs.cornea.cornea_problem import prepare
from palpate.workers.organs.cornea.corneal_model import (
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
    JetProfile,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import advance
from tests.workers.organs.cornea.solver.structured_t6 import corneal_arc

KINDS = ("plane stress", "plane strain", "axisymmetric")
METHODS = ("additive", "mulf", "inverse", "none")
CONVENTIONS = ("mu/alpha", "2mu/alpha^2", "mu/alpha^2")
PROFILE = JetProfile((0.0, 0.7, 1.6), (1.0, 0.6, 0.1))


def smooth(nodes_mm, size_mm, seed):
    """Return a displacement that varies over about a millimetre, zero on the axis."""
    rng = np.random.default_rng(seed)
    x, y = nodes_mm.T
    u = np.zeros_like(nodes_mm)
    for _ in range(3):
        a, b, c, d = rng.normal(size=4)
        u += np.stack([x * np.cos(a * y + b), np.cos(c * x + d * y)], axis=1)
    return size_mm * u / np.abs(u).max()


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", KINDS)
def test_tangent_is_the_slope_of_the_force(kind, method, convention):
    """With prestress, pressures on both sides and an elastic limbus, to an accuracy of 1e-7."""
    mesh = corneal_arc(16, 2)
    model = CorneaModel(kind=kind, prestress=method, limbus_mpa_per_mm=0.3, side_gradient=0.4)
    prepared = prepare(mesh, model)
    centre = 0.0 if kind == "axisymmetric" else 0.13
    load = CorneaLoad(0.01, 0.02, centre, jet_profile=PROFILE, eye_shift_mm=(0, 0.1))
    constants = CorneaConstants((0.011, 0.035), (30.0, 80.0), convention=convention)
    system = system_of(prepared, constants, load)
    if method != "none":
        system = system.with_prestress(advance(system, smooth(mesh.nodes_mm, 0.02, 0)))
    stage = system.jet_stage
    u = smooth(mesh.nodes_mm, 0.03, 1)
    _, min_j, values = system.tangent(u, stage)
    assert min_j > 0.9
    starts, first, last = prepared.envelope.row_starts, *prepared.envelope[:2]

    def times_tangent(v):
        product = np.zeros(prepared.unknowns)
        for i in range(prepared.unknowns):
            a = 8 * first[i // 8]
            b = min(8 * (last[i // 8] + 1), prepared.unknowns)
            product[i] = values[starts[i] + a : starts[i] + b] @ v[a:b]
        return product

    rng = np.random.default_rng(2)
    for direction in (rng.normal(size=prepared.unknowns), np.ones(prepared.unknowns)):
        h = 4e-6
        step = prepared.spread(direction)

        def force(part, step=step):
            return system.residual(u + part * step, stage)[0]

        slope = (8 * (force(h) - force(-h)) - (force(2 * h) - force(-2 * h))) / (12 * h)
        expected = times_tangent(direction)
        error = np.linalg.norm(slope - expected) / np.linalg.norm(expected)
        assert error < 1e-7
