"""Forward simulations of a cornea from Python: equilibrium and derivatives."""

import json
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, LocalCluster

import palpate
import palpate.cornea
from palpate.service.cli import main
from palpate.workers.organs.cornea.corneal_model import MPA_PER_MMHG


@pytest.fixture(scope="module")
def model() -> palpate.Cornea:
    return palpate.Cornea(elements=300)


@pytest.fixture(scope="module")
def result(model: palpate.Cornea) -> palpate.CorneaSimulation:
    return model.simulate()


def test_arrays_have_the_documented_shapes(result: palpate.CorneaSimulation) -> None:
    n, m = len(result.nodes_mm), len(result.triangles)
    assert result.converged
    assert result.nodes_mm.shape == result.displacement_mm.shape == (n, 2)
    assert result.triangles.shape == (m, 6)
    F, stress = result.deformation_gradient, result.cauchy_stress_mpa
    assert F.shape == stress.shape == (m, F.shape[1], 3, 3)
    np.testing.assert_allclose(stress[..., 2, 2], 0, atol=1e-9)  # plane stress
    np.testing.assert_allclose(stress, stress.swapaxes(-1, -2), atol=1e-12)
    anterior = result.deformed.anterior_mm
    highest = anterior[:, 1].max()
    assert highest < result.nodes_mm[:, 1].max()
    assert len(repr(result)) < 200
    mesh = result.to_meshio()
    np.testing.assert_array_equal(mesh.points, result.deformed_nodes_mm)
    assert mesh.cells_dict["triangle6"].shape == (m, 6)
    np.testing.assert_array_equal(mesh.cell_data["cauchy_mpa"][0], stress.mean(axis=1))


def test_wall_force_balances_pressure() -> None:
    """Without a jet the section is an arc of a thin ring: stress = pressure x radius / thickness.

    The stress varies over the thickness; its mean is the value at the middle surface.
    """
    radius, thickness, mmhg = 7.8, 0.45, 15.0
    section = {"radius_mm": radius, "central_mm": thickness, "peripheral_mm": thickness}
    model = palpate.Cornea(elements=600, iop_mmhg=mmhg, jet={"pressure_kpa": 0}, section=section)
    result = model.simulate()
    assert np.abs(result.displacement_mm).max() < 1e-4  # it is imaged under this pressure
    middle = np.abs(result.nodes_mm[result.triangles][:, :, 0].mean(axis=1)) < 1.5
    stress = result.cauchy_stress_mpa[middle][..., 0, 0].mean()
    expected = mmhg * MPA_PER_MMHG * (radius - thickness / 2) / thickness
    assert stress == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("name", ["mu1_pa", "alpha1", "bulk_kpa", "iop_mmhg", "depth_gradient"])
def test_gradient_is_the_limit_of_differences(
    model: palpate.Cornea, result: palpate.CorneaSimulation, name: str
) -> None:
    value = result.constants[name]
    h = 1e-3 * (value or 1.0)
    ends = [
        model.simulate(**{**result.constants, name: one}).displacement_mm
        for one in (value + h, value - h)
    ]
    difference = (ends[0] - ends[1]) / (2 * h)
    error = np.linalg.norm(result.gradient(name) - difference)
    assert error < 1e-4 * np.linalg.norm(difference)


def test_python_agrees_with_the_command(
    result: palpate.CorneaSimulation,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("case.yaml").write_text("case: {organ: cornea, mesh: {elements: 300}}\n")
    assert main(["simulate", "case.yaml", "--json"]) == 0
    stored = json.loads(capsys.readouterr().out)
    assert stored["outcome"]["apex_displacement_um"] == result.apex_displacement_um


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::UserWarning")
def test_client_workers_give_equal_results(
    model: palpate.Cornea, result: palpate.CorneaSimulation, tmp_path: Path
) -> None:
    one = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with LocalCluster(**one) as cluster, Client(cluster, set_as_default=False) as client:
        there = palpate.Cornea(elements=300).simulate(client=client, store=tmp_path / "store")
    np.testing.assert_array_equal(there.displacement_mm, result.displacement_mm)
    np.testing.assert_array_equal(there.cauchy_stress_mpa, result.cauchy_stress_mpa)
    np.testing.assert_array_equal(there.gradient("mu1_pa"), result.gradient("mu1_pa"))
    assert there.outcome == result.outcome
    assert (there.constants, there.reason) == (result.constants, "")


def test_rejects_invalid_keys_and_constants(model: palpate.Cornea) -> None:
    with pytest.raises(palpate.InputError, match="did you mean 'mu1_pa'"):
        palpate.Cornea(mu1=3)
    with pytest.raises(palpate.InputError, match=r"mesh\.elements"):
        palpate.Cornea(elements=2)
    with pytest.raises(palpate.InputError, match="at least 0 Pa"):
        model.simulate(mu1_pa=-1)
