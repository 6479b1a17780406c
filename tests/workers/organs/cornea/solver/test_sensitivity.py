"""Derivatives against differences of whole solutions, including the prestress iteration."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.cornea_problem import (
    Candidate,
    changed,
    parameter_names,
    prepare,
    scale_of,
)
from palpate.workers.organs.cornea.corneal_model import (
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
    JetProfile,
)
from palpate.workers.organs.cornea.prestressed_equilibrium import (
    CandidateChange,
    sensitivity,
    solve_prepared,
)
from tests.workers.organs.cornea.solver.structured_t6 import corneal_arc

X1 = CorneaConstants((0.011, 0.035), (30.0, 80.0))
MESH = corneal_arc(30, 2)
UNSYMMETRIC = ("jet_centre_mm", "eye_tilt_rad", "eye_shift_x_mm", "side_gradient")
# An iteration that stops slightly earlier on one side would spoil the differences.
TIGHT = {"tolerance_mm": 1e-12, "prestress_tolerance_mm": 1e-11}


def candidate_of(kind, method, load=None, **options):
    centred = kind == "axisymmetric"
    load = load or CorneaLoad(
        0.0014,
        0.0075,
        jet_centre_mm=0.0 if centred else 0.1,
        jet_diameter_mm=3.07,
        eye_shift_mm=(0.0 if centred else 0.01, 0.02),
    )
    model = CorneaModel(kind=kind, prestress=method, **TIGHT, **options)
    return Candidate(prepare(MESH, model), X1, load)


def displacement(candidate):
    solution = solve_prepared(candidate.prepared, candidate.constants, candidate.load)
    assert solution.converged, solution.reason
    return solution.displacement_mm


def by_differences(at, step):
    """Return central differences of two steps, extrapolated; `at` takes a signed step."""
    wide, narrow = (
        (displacement(at(h)) - displacement(at(-h))) / (2 * h) for h in (step, step / 2)
    )
    return (4 * narrow - wide) / 3


METHODS = ("additive", "mulf", "inverse", "none")
KINDS = (
    ("plane stress", None), ("plane stress", 0.5), ("plane strain", None), ("axisymmetric", 0.5),
)  # fmt: skip
# Each kind and each method once; the other pairs are slow.
QUICK = {(*kind, method) for kind, method in zip(KINDS, METHODS, strict=True)}


@pytest.mark.parametrize(
    ("kind", "limbus", "method"),
    [
        pytest.param(*pair, marks=() if pair in QUICK else pytest.mark.slow)
        for kind in KINDS
        for method in METHODS
        for pair in [(*kind, method)]
    ],
)
def test_derivatives_with_respect_to_every_parameter_match_differences(kind, limbus, method):
    """To a relative accuracy of 1e-6."""
    candidate = candidate_of(kind, method, limbus_mpa_per_mm=limbus)
    names = [
        n for n in parameter_names(candidate) if kind != "axisymmetric" or n not in UNSYMMETRIC
    ]
    result = sensitivity(candidate, names)
    assert result.solution.converged
    assert len(names) >= 11
    for name, derivative in zip(names, result.derivatives, strict=True):
        expected = by_differences(
            lambda h, name=name: changed(candidate, name, h), 2e-3 * scale_of(candidate, name)
        )
        error = np.linalg.norm(derivative - expected) / np.linalg.norm(expected)
        assert error < 1e-6, name


def test_derivatives_with_a_measured_jet_profile_match_differences():
    load = CorneaLoad(0.0014, 0.01, 0.1, jet_profile=JetProfile((0.0, 0.8, 1.7), (1.0, 0.7, 0.2)))
    candidate = candidate_of("plane stress", "additive", load)
    names = ("jet_centre_mm", "jet_width_factor", "jet_pressure_mpa")
    result = sensitivity(candidate, names)
    for name, derivative in zip(names, result.derivatives, strict=True):
        expected = by_differences(lambda h, name=name: changed(candidate, name, h), 1e-3)
        assert np.linalg.norm(derivative - expected) < 1e-6 * np.linalg.norm(expected)


@pytest.mark.parametrize("method", ["additive", "mulf", "inverse"])
def test_derivative_with_respect_to_the_thickness_matches_differences(method):
    """For any change to the mesh that keeps its triangles."""
    candidate = candidate_of("plane stress", method)

    def thicker(by_mm):
        mesh = corneal_arc(30, 2, thickness_mm=(0.595 + by_mm, 0.70 + by_mm))
        return replace(candidate, prepared=prepare(mesh, candidate.prepared.model))

    step = 1e-5
    result = sensitivity(candidate, [CandidateChange(thicker(step), thicker(-step), step)])
    expected = by_differences(thicker, 2e-3)
    assert np.linalg.norm(result.derivatives[0] - expected) < 1e-6 * np.linalg.norm(expected)


def test_scaling_moduli_and_loads_together_keeps_the_shape():
    """Scaling W and all pressures keeps the shape: sum mu d/dmu + K d/dK = - sum p d/dp."""
    candidate = candidate_of("plane stress", "mulf")
    names = ("mu1_mpa", "mu2_mpa", "bulk_mpa", "iop_mpa", "jet_pressure_mpa")
    d = dict(zip(names, sensitivity(candidate, names).derivatives, strict=True))
    stiffer = sum(scale_of(candidate, n) * d[n] for n in names[:3])
    load = candidate.load
    loaded = load.iop_mpa * d["iop_mpa"] + load.jet_pressure_mpa * d["jet_pressure_mpa"]
    np.testing.assert_allclose(stiffer, -loaded, atol=1e-6 * np.abs(loaded).max())


def test_diverged_cornea_has_no_derivatives():
    candidate = candidate_of("plane stress", "none", CorneaLoad(0.0, 0.5))
    weak = replace(candidate, constants=CorneaConstants((1e-4,), (2.0,), bulk_mpa=1e-3))
    result = sensitivity(weak, ["mu1_mpa"])
    assert not result.solution.converged
    assert np.isnan(result.derivatives).all()


def test_rejects_unknown_parameters():
    candidate = candidate_of("plane stress", "additive")
    with pytest.raises(InputError, match=r"no parameter 'mu3_mpa'. It has mu1_mpa"):
        sensitivity(candidate, ["mu3_mpa"])
    still = replace(candidate, load=CorneaLoad(0.0))
    with pytest.raises(InputError, match="non-zero pressure"):
        sensitivity(still, ["iop_mpa"])
