"""Forward simulations from Python: equilibrium, and agreement with `palpate simulate`."""

import json
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from distributed import Client, LocalCluster

import palpate
import palpate.forward
from palpate.service.cli import main
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import load_volume
from palpate.testing.plugin_claims import small_breast

FORCE_N = 20.0


@pytest.fixture(scope="module")
def model() -> palpate.Breast:
    return palpate.Breast(small_breast(), nodes=400, force_n=FORCE_N)


@pytest.fixture(scope="module")
def result(model: palpate.Breast) -> palpate.Simulation:
    return model.simulate(E_fat_kpa=8, E_glandular_kpa=24)


def volumes(x: np.ndarray, tets: np.ndarray) -> np.ndarray:
    return np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]]) / 6


def test_arrays_have_the_documented_shapes(result: palpate.Simulation) -> None:
    n, m = len(result.nodes_mm), len(result.tetrahedra)
    assert result.converged
    assert not result.reason
    assert result.nodes_mm.shape == result.displacement_mm.shape == (n, 3)
    assert result.tetrahedra.shape == (m, 4)
    assert result.tissue.shape == result.von_mises_mpa.shape == result.volume_ratio.shape == (m,)
    tensors = (result.deformation_gradient, result.green_lagrange_strain, result.cauchy_stress_mpa)
    assert {tensor.shape for tensor in tensors} == {(m, 3, 3)}
    assert result.constants["E_fat_kpa"] == pytest.approx(8)
    assert len(repr(result)) < 200


def test_stress_balances_plate_force(result: palpate.Simulation) -> None:
    """The stress along y integrated over the body is force times height, the only load along y.

    The elastic wall takes a small part of the load along y.
    """
    assert result.plate_force_n == pytest.approx(FORCE_N, rel=1e-3)
    x = result.deformed_nodes_mm
    carried = -(result.cauchy_stress_mpa[:, 1, 1] * volumes(x, result.tetrahedra)).sum()
    assert carried == pytest.approx(FORCE_N * np.ptp(x[:, 1]), rel=0.03)


def test_strain_follows_from_the_deformation(result: palpate.Simulation) -> None:
    F = result.deformation_gradient
    strain = (np.einsum("eki,ekj->eij", F, F) - np.eye(3)) / 2
    np.testing.assert_allclose(result.green_lagrange_strain, strain, atol=1e-12)
    before = volumes(result.nodes_mm, result.tetrahedra)
    after = volumes(result.deformed_nodes_mm, result.tetrahedra)
    np.testing.assert_allclose(result.volume_ratio, after / before, rtol=1e-9)
    edges = result.nodes_mm[result.tetrahedra]
    moved = np.einsum("eij,ej->ei", F, edges[:, 1] - edges[:, 0])
    edges = result.deformed_nodes_mm[result.tetrahedra]
    np.testing.assert_allclose(moved, edges[:, 1] - edges[:, 0], atol=1e-9)


def test_wall_reaction_balances_load(result: palpate.Simulation) -> None:
    held = np.abs(result.reaction_n).sum(axis=1) > 0
    wall = result.nodes_mm[:, 2] < result.nodes_mm[:, 2].min() + 1e-6
    assert held.any()
    assert not (held & ~wall).any()
    # Frictionless plates along y give nothing along z.
    assert abs(result.reaction_n[:, 2].sum()) < 0.02 * FORCE_N


@pytest.mark.parametrize("name", ["E_fat_kpa", "E_glandular_kpa", "nu", "gravity_z_g"])
def test_gradient_is_the_limit_of_differences(
    model: palpate.Breast, result: palpate.Simulation, name: str
) -> None:
    if name not in result.constants:
        name = next(n for n in result.constants if n.startswith("gravity"))
    value = result.constants[name]
    h = 5e-4 * (value or 1.0)
    stated = {"E_fat_kpa": 8.0, "E_glandular_kpa": 24.0}
    ends = [model.simulate(**{**stated, name: v}).displacement_mm for v in (value + h, value - h)]
    difference = (ends[0] - ends[1]) / (2 * h)
    gradient = result.gradient(name)
    assert gradient.shape == result.displacement_mm.shape
    assert np.linalg.norm(gradient - difference) < 0.01 * np.linalg.norm(difference)


def test_friction_gradient_agrees_with_differences(model: palpate.Breast) -> None:
    result = model.simulate(friction=0.2)
    difference = (
        model.simulate(friction=0.22).displacement_mm
        - model.simulate(friction=0.18).displacement_mm
    ) / 0.04
    gradient = result.gradient("friction")
    assert np.linalg.norm(gradient - difference) < 0.1 * np.linalg.norm(difference)


@pytest.mark.slow
def test_diverged_simulation_has_reason(model: palpate.Breast) -> None:
    result = model.simulate(E_fat_kpa=0.001, E_glandular_kpa=0.001, eta_fat_kpa=0)
    assert not result.converged
    assert result.reason
    assert result.displacement_mm.shape == result.nodes_mm.shape
    assert "diverged" in repr(result)
    with pytest.raises(palpate.InputError, match="diverged"):
        _ = result.deformed
    with pytest.raises(palpate.InputError, match="did not converge"):
        result.gradient("E_fat_kpa")


def test_files_contain_the_arrays(result: palpate.Simulation, tmp_path: Path) -> None:
    found = meshio.read(result.to_vtu(tmp_path / "body.vtu"))
    direct = result.to_meshio()
    for mesh in (found, direct):
        np.testing.assert_allclose(mesh.points, result.deformed_nodes_mm)
        np.testing.assert_allclose(mesh.point_data["displacement_mm"], result.displacement_mm)
        pressed = 1e-3 * mesh.cell_data["cauchy_stress_kpa"][0][:, 1]
        np.testing.assert_allclose(pressed, result.cauchy_stress_mpa[:, 1, 1])


def test_error_names_missing_pyvista(
    result: palpate.Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyvista", None)
    with pytest.raises(palpate.InputError, match=r"palpate\[pyvista\]"):
        result.to_pyvista()


PHANTOM = {"preset": "445ml", "spacing_mm": 2.0}
CASE = f"""
name: once
case:
  reference: {{phantom: {json.dumps(PHANTOM)}}}
  mesh: {{nodes: 850}}
  load: {{force_n: 60}}
"""


def test_python_agrees_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file has neither target nor search."""
    monkeypatch.chdir(tmp_path)
    Path("case.yaml").write_text(CASE)
    assert main(["simulate", "case.yaml", "--set", "E_fat_kpa=8", "--json"]) == 0
    stored = json.loads(capsys.readouterr().out)
    body = palpate.phantom(**PHANTOM)
    result = palpate.Breast(body, nodes=850, force_n=60).simulate(E_fat_kpa=8)
    assert result.outcome["plate_displacement_mm"] == stored["outcome"]["plate_displacement_mm"]
    kept = load_volume(open_store("runs/store"), stored["volume"])
    np.testing.assert_array_equal(result.deformed.values, kept.values)
    assert result.deformed.origin_mm == kept.origin_mm


def test_a_case_alone_is_checked_like_a_study(tmp_path: Path) -> None:
    file = tmp_path / "case.yaml"
    file.write_text(CASE.replace("force_n", "forse_n"))
    assert main(["simulate", str(file)]) == 2
    file.write_text(CASE + "serch: {}\n")
    assert main(["simulate", str(file)]) == 2


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::UserWarning")
def test_client_workers_give_equal_results(
    model: palpate.Breast, result: palpate.Simulation, tmp_path: Path
) -> None:
    with (
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        there = model.simulate(
            E_fat_kpa=8, E_glandular_kpa=24, client=client, store=tmp_path / "store"
        )
    np.testing.assert_array_equal(there.displacement_mm, result.displacement_mm)
    np.testing.assert_allclose(there.cauchy_stress_mpa, result.cauchy_stress_mpa, rtol=1e-12)
    gradient = there.gradient("E_fat_kpa")
    np.testing.assert_array_equal(gradient, result.gradient("E_fat_kpa"))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"forse_n": 3}, "did you mean 'force_n'"),
        ({"E_fatt_kpa": 3}, "did you mean 'E_fat_kpa'"),
        ({"yeoh_c2_fat": 3}, "unknown key 'yeoh_c2_fat'"),
        ({"force_n": -3}, r"load\.force_n"),
        ({"nu": 0.6}, "nu must be"),
        ({"force_n": 3, "plate_distance_mm": {"final": 40}}, "found both"),
        ({"force_n": 1e6}, "plausibility"),
    ],
)
def test_rejects_invalid_keys(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(palpate.InputError, match=message):
        palpate.Breast(small_breast(4.0), **keys)


def test_rejects_invalid_constants(model: palpate.Breast) -> None:
    for constants, message in (
        ({"E_fatt_kpa": 8}, "did you mean"),
        ({"E_fat_kpa": -8}, "above 0 kPa"),
        ({"E_skin_kpa": 800}, "has no skin"),
    ):
        with pytest.raises(palpate.InputError, match=message):
            model.simulate(**constants)


def test_keys_of_a_law_reach_the_model() -> None:
    keys = {"nodes": 300, "force_n": 10, "law": "yeoh", "yeoh_c2_fat": 0.3, "nu": 0.48}
    case = palpate.Breast(small_breast(4.0), **keys).case
    assert case.constants == {"yeoh_c2_fat": 0.3, "nu": 0.48}
    assert case.mesh.nodes == 300
