"""Bench specimens from Python agree with textbook solutions."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from distributed import Client, LocalCluster

import palpate
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
from palpate.workers.organs.specimen.block_lattice import lattice

LENGTH, WIDTH, FORCE = 60.0, 20.0, 2.0
BAR: dict[str, Any] = {
    "organ": "specimen",
    "name": "bar",
    "body": {"box_mm": [WIDTH, WIDTH, LENGTH]},
    "down": [0, 0, -1],
    "regions": {
        "base": {"plane": {"axis": "z", "at_mm": 0}},
        "top": {"plane": {"axis": "z", "at_mm": LENGTH}},
    },
    "materials": {"gel": {"E_kpa": [50, 500], "nu": 0.3, "density_kg_per_m3": 1000}},
    "holds": [{"region": "base"}],
    "field": {"sd_mm": 0.01},
    "states": [
        {
            "name": "pulled",
            "files": ["never-read.csv"],
            "forces": [{"region": "top", "force_n": [0, 0, FORCE]}],
        }
    ],
    "predict": [
        {"name": "stretched", "moves": [{"region": "top", "displacement_mm": [0, 0, 1.5]}]}
    ],
}

SHEET = BAR | {
    "body": {"sheet": {"size_mm": [40, 20], "thickness_mm": 0.5}},
    "regions": {
        "base": {"plane": {"axis": "x", "at_mm": 0}},
        "top": {"plane": {"axis": "x", "at_mm": 40}},
    },
    "predict": [{"name": "drawn", "moves": [{"region": "top", "displacement_mm": [2, 0, 0]}]}],
    "states": [
        {
            "name": "pulled",
            "files": ["never-read.csv"],
            "forces": [{"region": "top", "force_n": [0.2, 0, 0]}],
        }
    ],
}


@pytest.fixture(scope="module")
def bar() -> palpate.Specimen:
    return palpate.Specimen(BAR, nodes=1200)


def test_a_pulled_bar_lengthens_by_force_over_stiffness(bar: palpate.Specimen) -> None:
    """u = F L / (E A); the clamped end, which cannot narrow, is a little stiffer."""
    assert bar.states == ("pulled", "stretched")
    assert bar.constants == ("E_kpa",)
    result = bar.simulate("pulled", E_kpa=200)
    top = result.nodes_mm[:, 2] > LENGTH - 1e-6
    expected = FORCE * LENGTH / (0.2 * WIDTH**2)
    assert result.displacement_mm[top, 2].mean() == pytest.approx(expected, rel=0.05)
    middle = np.abs(result.nodes_mm[result.tetrahedra][:, :, 2].mean(axis=1) - LENGTH / 2) < 10
    stress = result.cauchy_stress_mpa[middle, 2, 2].mean()
    assert stress == pytest.approx(FORCE / WIDTH**2, rel=0.05)
    # Only the stiffness opposes the force: du/dE is about -u / E.
    gradient = result.gradient("E_kpa")[top, 2].mean()
    assert gradient == pytest.approx(-expected / 200, rel=0.1)


def test_hold_reaction_balances_stretching_force(bar: palpate.Specimen) -> None:
    result = bar.simulate("stretched", E_kpa=200)
    base = result.nodes_mm[:, 2] < 1e-6
    force = -result.reaction_n[base, 2].sum()
    assert abs(force) == pytest.approx(0.2 * WIDTH**2 * 1.5 / LENGTH, rel=0.1)
    np.testing.assert_allclose(result.reaction_n.sum(axis=0), 0, atol=0.01 * abs(force))
    assert result.plate_force_n == 0
    with pytest.raises(palpate.InputError, match="not made of voxels"):
        _ = result.deformed


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::UserWarning")
@pytest.mark.parametrize("form", ["block", "mesh file", "sheet"])
def test_client_workers_give_equal_results(form: str, tmp_path: Path) -> None:
    keys = SHEET if form == "sheet" else BAR
    if form == "mesh file":
        mesh = lattice((WIDTH, WIDTH, LENGTH), (3, 3, 5))
        faces = [("triangle", boundary_triangles(mesh.tets))]
        meshio.write(tmp_path / "bar.stl", meshio.Mesh(mesh.nodes, faces))
        keys = BAR | {"body": {"mesh": str(tmp_path / "bar.stl"), "voxel_mm": 2}}
    bar = palpate.Specimen(keys, nodes=900)
    here = bar.simulate("pulled", E_kpa=200)
    one = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with LocalCluster(**one) as cluster, Client(cluster, set_as_default=False) as client:
        there, again = (
            bar.simulate("pulled", E_kpa=200, client=client, store=tmp_path / "store")
            for _ in range(2)
        )
    np.testing.assert_array_equal(there.displacement_mm, here.displacement_mm)
    np.testing.assert_array_equal(again.displacement_mm, here.displacement_mm)
    np.testing.assert_allclose(there.cauchy_stress_mpa, here.cauchy_stress_mpa, rtol=1e-12)
    np.testing.assert_array_equal(there.gradient("E_kpa"), here.gradient("E_kpa"))
    assert len(list((tmp_path / "store" / "evaluations").iterdir())) == 1


def test_error_names_unknown_or_missing_constants(bar: palpate.Specimen) -> None:
    with pytest.raises(palpate.InputError, match="did you mean 'pulled'"):
        bar.simulate("puled", E_kpa=200)
    with pytest.raises(palpate.InputError, match="needs E_kpa"):
        bar.simulate("pulled")
    with pytest.raises(palpate.InputError, match="unknown parameter"):
        bar.simulate("pulled", E_fat_kpa=200)
    with pytest.raises(palpate.InputError, match="did you mean 'holds'"):
        palpate.Specimen(BAR | {"hold": []})
