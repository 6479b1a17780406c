"""Forces of pressures against values calculated by hand."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.corneal_model import CorneaLoad, JetProfile
from palpate.workers.organs.cornea.envelope_lu import envelope_of
from palpate.workers.organs.cornea.t6_elements import (
    NOTHING,
    add_pressure,
    jet_points,
    posterior_points,
)
from tests.workers.organs.cornea.solver.structured_t6 import corneal_arc, mapped


def force(points, x, pressure):
    """Return the external forces at the nodes, (n, 2)."""
    equations = np.arange(x.size, dtype=np.int32).reshape(-1, 2)
    residual = np.zeros(x.size)
    envelope = envelope_of(equations, x.size)
    add_pressure(x, points, pressure, equations, residual, envelope, NOTHING)
    return -residual.reshape(-1, 2)


def block(cells=10):
    """Return a block of 10 mm by 1 mm."""
    x, y = np.meshgrid(np.linspace(-5, 5, 2 * cells + 1), np.linspace(0, 1, 3), indexing="ij")
    return mapped(np.stack([x, y], axis=-1), cells, 1)


@pytest.mark.parametrize("centre", [0.0, 0.4, -1.37])
@pytest.mark.parametrize("diameter", [0.2, 3.0, 4.123])
def test_jet_on_a_flat_block_exerts_pressure_times_width(centre, diameter):
    """Independent of the element edges; the moment about the centre of the jet vanishes, too."""
    mesh = block()
    load = CorneaLoad(0.0, 0.015, centre, diameter)
    points = jet_points(mesh.nodes_mm, mesh.anterior, load, axisymmetric=False)
    f = force(points, mesh.nodes_mm, 0.015)
    assert f.sum(axis=0) == pytest.approx([0, -0.015 * diameter], rel=1e-12, abs=1e-16)
    moment = (f[:, 1] * (mesh.nodes_mm[:, 0] - centre)).sum()
    assert abs(moment) < 1e-15


def test_jet_loads_only_the_edges_below_it():
    mesh = block()
    points = jet_points(mesh.nodes_mm, mesh.anterior, CorneaLoad(0.0, jet_diameter_mm=2.0), False)
    f = force(points, mesh.nodes_mm, 1.0)
    assert (f[np.abs(mesh.nodes_mm[:, 0]) > 1] == 0).all()
    assert (f[mesh.nodes_mm[:, 1] < 1] == 0).all()


def test_a_measured_profile_is_integrated_exactly():
    """Trapezoids: 2 (0.5 (1 + 0.6) 0.7 + 0.5 (0.6 + 0.1) 0.9) = 1.75 mm, and times 1.3."""
    mesh = corneal_arc(31, 2)
    profile = JetProfile((0.0, 0.7, 1.6), (1.0, 0.6, 0.1))
    for factor in (1.0, 1.3):
        load = CorneaLoad(0.0, 1.0, 0.2, jet_profile=profile, jet_width_factor=factor)
        points = jet_points(mesh.nodes_mm, mesh.anterior, load, axisymmetric=False)
        # The vertical component of a pressure acts on the projected width.
        assert force(points, mesh.nodes_mm, 1.0)[:, 1].sum() == pytest.approx(
            -1.75 * factor, rel=1e-9
        )


@pytest.mark.parametrize("cells", [7, 40])
def test_axial_force_of_an_axisymmetric_jet_is_pressure_times_area(cells):
    """p r^2 / 2 per radian and half, on a curved surface whose nodes are not at the edge."""
    mesh = corneal_arc(2 * cells, 2)
    points = jet_points(mesh.nodes_mm, mesh.anterior, CorneaLoad(0.0), axisymmetric=True)
    f = force(points, mesh.nodes_mm, 0.015)
    for side in (-1, 1):
        half = np.sign(mesh.nodes_mm[:, 0]) == side
        on_axis = mesh.nodes_mm[:, 0] == 0
        total = f[half, 1].sum() + f[on_axis, 1].sum() / 2
        assert total == pytest.approx(-0.015 * 1.5**2 / 2, rel=1e-9)


def test_internal_pressure_follows_the_deformed_surface():
    """The force is that on the chord, rotated by a quarter turn, whatever the shape between."""
    mesh = corneal_arc(20, 2)
    points = posterior_points(mesh.nodes_mm, mesh.posterior, axisymmetric=False)
    rng = np.random.default_rng(0)
    x = mesh.nodes_mm + 0.05 * rng.normal(size=mesh.nodes_mm.shape)
    chord = x[mesh.posterior[-1]] - x[mesh.posterior[0]]
    expected = 0.002 * np.array([-chord[1], chord[0]])
    assert expected[1] > 0
    np.testing.assert_allclose(force(points, x, 0.002).sum(axis=0), expected, rtol=1e-12)


def test_rejects_a_jet_beyond_the_cornea():
    mesh = corneal_arc(20, 2)
    for load in (CorneaLoad(0.0, jet_diameter_mm=13.0), CorneaLoad(0.0, jet_centre_mm=5.0)):
        with pytest.raises(InputError, match=r"The air jet covers .* anterior surface only"):
            jet_points(mesh.nodes_mm, mesh.anterior, load, axisymmetric=False)
    with pytest.raises(InputError, match="axisymmetric cornea must be centred"):
        jet_points(mesh.nodes_mm, mesh.anterior, CorneaLoad(0.0, jet_centre_mm=0.1), True)


@pytest.mark.parametrize(
    ("r_mm", "fraction"),
    [((), ()), ((0.0, 1.0), (1.0,)), ((1.0, 0.5), (1.0, 0.5)), ((0.0,), (1.0,)), ((1.0,), (-1.0,))],
)
def test_rejects_invalid_profiles(r_mm, fraction):
    with pytest.raises(InputError, match="profile of an air jet"):
        JetProfile(r_mm, fraction)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"iop_mpa": -0.001}, "cannot be negative"),
        ({"iop_mpa": 0.0, "jet_pressure_mpa": -1.0}, "cannot be negative"),
        ({"iop_mpa": 0.0, "jet_diameter_mm": 0.0}, "positive diameter"),
        ({"iop_mpa": float("inf")}, "finite"),
    ],
)
def test_rejects_invalid_loads(bad, message):
    with pytest.raises(InputError, match=message):
        CorneaLoad(**bad)
