"""Equilibrium of a cornea with the intraocular pressure, by three methods."""

import numpy as np
import pytest

from palpate.workers.organs.cornea.cornea_equations import system_of
from palpate.workers.organs.cornea.cornea_problem import prepare
from palpate.workers.organs.cornea.corneal_model import (
    MPA_PER_MMHG,
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import prestressed
from tests.workers.organs.cornea.solver.solved import solve_cornea
from tests.workers.organs.cornea.solver.structured_t6 import corneal_arc

IOP = 10.5 * MPA_PER_MMHG
X1 = CorneaConstants((0.011, 0.035), (30.0, 80.0))
SOFT = CorneaConstants((0.011, 0.035), (30.0, 80.0), convention="2mu/alpha^2")
KINDS = ("plane stress", "plane strain", "axisymmetric")
METHODS = ("additive", "mulf", "inverse")


def apex_um(constants=X1, jet_mmhg=112.5, mesh=None, **options):
    mesh = mesh or corneal_arc(60, 2)
    load = CorneaLoad(IOP, jet_mmhg * MPA_PER_MMHG)
    solution = solve_cornea(mesh, constants, load, CorneaModel(**options))
    assert solution.converged, solution.reason
    return solution.apex_displacement_um


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("limbus", [None, 0.5])
def test_image_is_in_equilibrium_with_the_pressure(kind, method, limbus):
    """No node moves by more than the tolerance, and the stress is not zero."""
    model = CorneaModel(kind=kind, prestress=method, limbus_mpa_per_mm=limbus)
    mesh = corneal_arc(40, 2)
    prepared = prepare(mesh, model)
    rest = prestressed(system_of(prepared, X1, CorneaLoad(IOP)))
    assert rest.reason == ""
    assert np.abs(rest.u).max() < model.prestress_tolerance_mm
    first = np.abs(rest.iterates[0].u).max()
    assert first > 100 * model.prestress_tolerance_mm
    # The pressure alone, without the prestress, is far from equilibrium.
    _, _, factors = rest.system.linearise(rest.u, rest.system.image_stage)
    unbalanced = system_of(prepared, X1, CorneaLoad(IOP)).residual(rest.u, rest.system.image_stage)
    assert np.abs(factors.solve(unbalanced[0])).max() > 100 * model.prestress_tolerance_mm


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("limbus", [None, 0.5])
def test_mulf_and_the_inverse_method_agree(kind, limbus):
    """Their physics is the same: the apex agrees within 0.5 %, unlike with additive stress."""
    mulf, inverse, additive = (
        apex_um(kind=kind, prestress=method, limbus_mpa_per_mm=limbus)
        for method in ("mulf", "inverse", "additive")
    )
    assert mulf == pytest.approx(inverse, rel=5e-3)
    assert abs(additive - inverse) > 2 * abs(mulf - inverse)


def test_mulf_and_the_inverse_method_agree_at_large_prestretch():
    """Abaqus' convention makes X1 thirty times softer: the pressure moves the image by 400 um."""
    values = [
        apex_um(SOFT, 15.0, kind="plane strain", prestress=method) for method in ("mulf", "inverse")
    ]
    assert values[0] == pytest.approx(values[1], rel=5e-3)


def test_inverse_section_deforms_into_the_image():
    """By the definition of the inverse problem: a plain simulation of the resulting section."""
    mesh = corneal_arc(40, 2)
    model = CorneaModel(kind="plane strain", prestress="inverse", prestress_tolerance_mm=1e-8)
    rest = prestressed(system_of(prepare(mesh, model), X1, CorneaLoad(IOP)))
    assert rest.reason == ""
    found = rest.system.prestress.rest_mm
    assert np.abs(found - mesh.nodes_mm).max() > 0.02
    section = type(mesh)(
        found, mesh.triangles, mesh.anterior, mesh.posterior, mesh.left, mesh.right
    )
    plain = solve_cornea(
        section, X1, CorneaLoad(IOP, 0.0), CorneaModel(kind="plane strain", prestress="none")
    )
    assert plain.converged
    np.testing.assert_allclose(found + plain.displacement_mm, mesh.nodes_mm, atol=1e-6)


def test_divergent_prestress_is_an_ordinary_outcome():
    """The thesis' steps in Abaqus' convention, which fail in the inventory, too."""
    solution = solve_cornea(
        corneal_arc(120, 4), SOFT, CorneaLoad(IOP), CorneaModel(prestress="additive")
    )
    assert not solution.converged
    assert "prestress did not converge" in solution.reason
    assert solution.jet_fraction == 0


def test_bursting_pressure_is_an_ordinary_outcome():
    weak = CorneaConstants((1e-5,), (2.0,), bulk_mpa=1e-3)
    for method in (*METHODS, "none"):
        solution = solve_cornea(
            corneal_arc(20, 2), weak, CorneaLoad(10 * IOP), CorneaModel(prestress=method)
        )
        assert not solution.converged
        assert "under the pressure of the eye" in solution.reason
        assert np.isfinite(solution.displacement_mm).all()
