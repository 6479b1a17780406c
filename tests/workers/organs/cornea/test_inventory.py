"""Figures for the thesis' cornea, measured with an independent prototype.

The section has an outer radius of 7.8 mm and a chord of 11.7 mm, and is 0.595 mm thick in the
middle and 0.70 mm at the limbus; 960 triangles, constants X1 of Table 5.1. The prototype's meshes
differed by 0.5 to 1 %, because the edge of the jet was inside triangles.
"""

import numpy as np
import pytest

from palpate.workers.organs.cornea.cornea_problem import Candidate, prepare, scale_of
from palpate.workers.organs.cornea.corneal_model import (
    MPA_PER_MMHG,
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import sensitivity
from palpate.workers.organs.cornea.section_mesh import mesh_section
from palpate.workers.organs.cornea.section_outline import generated_section
from tests.workers.organs.cornea.solver.solved import solve_cornea
from tests.workers.organs.cornea.solver.structured_t6 import corneal_arc

X1 = ((0.011, 0.035), (30.0, 80.0))
# Kind, prestress, pressure of the jet in mmHg, displacement of the apex in um.
MEASURED = [
    ("plane stress", "additive", 112.5, 861.9),
    ("plane stress", "mulf", 112.5, 880.7),
    ("plane stress", "inverse", 112.5, 882.4),
    ("plane stress", "no pressure", 112.5, 1012.0),
    ("plane stress", "additive", 15.0, 72.1),
    ("plane stress", "mulf", 15.0, 65.1),
    ("plane stress", "no pressure", 15.0, 82.4),
    ("plane strain", "additive", 112.5, 522.7),
    ("plane strain", "additive", 180.0, 995.1),
    ("plane strain", "mulf", 180.0, 1031.3),
    ("plane strain", "inverse", 180.0, 1031.7),
    ("plane strain", "additive", 15.0, 56.0),
    ("plane strain", "mulf", 15.0, 55.1),
    ("plane strain", "no pressure", 15.0, 61.7),
    ("axisymmetric", "additive", 15.0, 15.3),
    ("axisymmetric", "mulf", 15.0, 15.3),
    ("axisymmetric", "no pressure", 15.0, 15.7),
    ("axisymmetric", "additive", 400.0, 470.0),
]
MEASURED_ABAQUS = [
    ("plane strain", "mulf", 15.0, 404.3),
    ("plane strain", "inverse", 15.0, 405.7),
    ("plane stress", "mulf", 15.0, 422.0),
    ("axisymmetric", "additive", 60.0, 801.9),
    ("axisymmetric", "additive", 15.0, 248.0),
    ("axisymmetric", "mulf", 15.0, 168.0),
]
MEASURED_FEBIO = [("axisymmetric", "additive", 15.0, 339.0), ("axisymmetric", "mulf", 15.0, 181.0)]
MESH = corneal_arc(120, 4)


def apex_um(kind, prestress, jet_mmhg, convention="mu/alpha", mesh=MESH, **options):
    iop_mmhg = 0.0 if prestress == "no pressure" else 10.5
    method = "none" if prestress == "no pressure" else prestress
    load = CorneaLoad(iop_mmhg * MPA_PER_MMHG, jet_mmhg * MPA_PER_MMHG)
    constants = CorneaConstants(*X1, convention=convention)
    solution = solve_cornea(mesh, constants, load, CorneaModel(kind, method, **options))
    assert solution.converged, solution.reason
    assert solution.stable
    return solution.apex_displacement_um


@pytest.mark.parametrize(("kind", "prestress", "jet_mmhg", "expected_um"), MEASURED)
def test_apex_in_the_convention_of_the_thesis_matches_the_inventory(
    kind, prestress, jet_mmhg, expected_um
):
    assert apex_um(kind, prestress, jet_mmhg) == pytest.approx(expected_um, rel=0.01, abs=0.1)


@pytest.mark.parametrize(("kind", "prestress", "jet_mmhg", "expected_um"), MEASURED_ABAQUS)
def test_apex_in_the_convention_of_abaqus_matches_the_inventory(
    kind, prestress, jet_mmhg, expected_um
):
    apex = apex_um(kind, prestress, jet_mmhg, "2mu/alpha^2")
    assert apex == pytest.approx(expected_um, rel=0.01)


@pytest.mark.parametrize(("kind", "prestress", "jet_mmhg", "expected_um"), MEASURED_FEBIO)
def test_apex_in_the_convention_of_febio_matches_the_inventory(
    kind, prestress, jet_mmhg, expected_um
):
    apex = apex_um(kind, prestress, jet_mmhg, "mu/alpha^2")
    assert apex == pytest.approx(expected_um, rel=0.01)


def test_additive_stress_differs_from_mulf_as_in_the_inventory():
    """-2.3 % at 112.5 mmHg, +10 % at 15 mmHg."""
    for jet_mmhg, expected in ((112.5, -0.0213), (15.0, 0.1075)):
        additive, mulf = (apex_um("plane stress", m, jet_mmhg) for m in ("additive", "mulf"))
        assert additive / mulf - 1 == pytest.approx(expected, abs=0.005)


def test_mesh_of_960_triangles_is_converged():
    """To 0.1 %, with or without nodes at the edges of the jet, and with either quadrature."""
    finest = apex_um("plane stress", "additive", 112.5, mesh=corneal_arc(240, 6))
    at_edges = corneal_arc(120, 4, at_x_mm=(-1.5, 1.5))
    for mesh in (MESH, at_edges):
        for points in (3, 7):
            apex = apex_um("plane stress", "additive", 112.5, mesh=mesh, quadrature_points=points)
            assert apex == pytest.approx(finest, rel=1e-3)


@pytest.mark.parametrize("kind", ["plane stress", "axisymmetric"])
def test_generated_section_matches_the_inventory(kind):
    """Its posterior surface is an arc, not a parabola in thickness: 1 % of the apex motion."""
    mesh = mesh_section(generated_section(), 960, nodes_at_x_mm=(-1.5, 0.0, 1.5))
    structured = apex_um(kind, "additive", 112.5)
    assert apex_um(kind, "additive", 112.5, mesh=mesh) == pytest.approx(structured, rel=0.01)


@pytest.mark.parametrize(
    ("kind", "jet_mmhg", "expected_um"),
    [
        ("plane stress", 112.5, (834, 7.6, 0.135, 0.0094)),
        ("plane strain", 112.5, (333, 2.2, 0.048, 0.0014)),
        ("plane strain", 180.0, (959, 3.6, 0.12, 0.006)),
    ],
)
def test_singular_values_match_the_inventory(kind, jet_mmhg, expected_um):
    """Singular values of the shift of both surfaces along their normals by ln(constant).

    The inventory gives two or three digits, from differences of whole solutions.
    """
    model = CorneaModel(kind, prestress_tolerance_mm=1e-8, tolerance_mm=1e-10)
    load = CorneaLoad(10.5 * MPA_PER_MMHG, jet_mmhg * MPA_PER_MMHG)
    candidate = Candidate(prepare(MESH, model), CorneaConstants(*X1), load)
    names = ("mu1_mpa", "alpha1", "mu2_mpa", "alpha2")
    result = sensitivity(candidate, names)
    x = MESH.nodes_mm + result.solution.displacement_mm
    columns = []
    for name, derivative in zip(names, result.derivatives, strict=True):
        shifts = []
        for surface in (MESH.anterior, MESH.posterior):
            tangent = np.gradient(x[surface], axis=0)
            normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            shifts.append((derivative[surface] * normal).sum(axis=1))
        columns.append(1e3 * scale_of(candidate, name) * np.concatenate(shifts))
    matrix = np.stack(columns, axis=1)
    values = np.linalg.svd(matrix / np.sqrt(len(matrix)), compute_uv=False)
    assert values == pytest.approx(expected_um, rel=0.06)
