"""Experiments on a thin sheet: its stiffness from fields or markers in its plane."""

import numpy as np
import pytest
import yaml

import palpate
from palpate.storage.errors import InputError
from palpate.workers.diagnosis.outcome.summarising import summarise
from palpate.workers.mechanics.fem.boundary_value_problem import Change
from palpate.workers.organs.specimen.experiment_files import READER, read_experiment
from palpate.workers.organs.specimen.load_cells import SheetForward
from palpate.workers.tasks.diagnosis_sources import check_source
from palpate.workers.tasks.diagnosis_tasks import model_displacements
from tests.workers.tasks.one_process import diagnosed_store, diagnosis_in

LENGTH, WIDTH, THICKNESS, E_KPA = 40.0, 20.0, 0.5, 80.0
STRETCHES = {"little": 1.1, "more": 1.2}
NODES = 200


def force_n(stretch):
    """Return the force on an incompressible neo-Hookean strip."""
    return E_KPA * 1e-3 / 3 * (stretch - stretch**-2) * WIDTH * THICKNESS


def described(**changes):
    """Return a strip that is pulled along x and free to narrow, with a load cell."""
    moves = {
        name: [{"region": "right", "axes": ["x"], "displacement_mm": [(s - 1) * LENGTH, 0, 0]}]
        for name, s in (STRETCHES | {"most": 1.4}).items()
    }
    data = {
        "organ": "specimen",
        "name": "strip",
        "body": {"sheet": {"size_mm": [LENGTH, WIDTH], "thickness_mm": THICKNESS}},
        "regions": {
            "left": {"plane": {"axis": "x", "at_mm": 0}},
            "right": {"plane": {"axis": "x", "at_mm": LENGTH}},
            "low": {"plane": {"axis": "y", "at_mm": 0}},
        },
        "materials": {"rubber": {"E_kpa": [20, 400], "nu": 0.4999, "density_kg_per_m3": 1000}},
        "holds": [{"region": "left", "axes": ["x"]}, {"region": "low", "axes": ["y"]}],
        "down": [0, 0, -1],
        "field": {"sd_mm": 0.01},
        "states": [
            {
                "name": name,
                "files": [f"{name}.csv"],
                "moves": moves[name],
                "reactions": [
                    {"region": "right", "axis": "x", "force_n": force_n(s), "sd_n": 0.001}
                ],
            }
            for name, s in STRETCHES.items()
        ],
        "predict": [{"name": "most", "moves": moves["most"]}],
    }
    return data | changes


def points():
    return np.stack(np.meshgrid([4.0, 15, 25, 36], [3.0, 10, 17], indexing="ij"), -1).reshape(-1, 2)


def moved(stretch):
    return points() * [stretch - 1, stretch**-0.5 - 1]


def written(folder, data, slip=0.0):
    """Write the file of an experiment and its tables without z."""
    rng = np.random.default_rng(3)
    for name, stretch in STRETCHES.items():
        noisy = moved(1 + (1 - slip) * (stretch - 1)) + 0.01 * rng.standard_normal((12, 2))
        rows = np.hstack([points(), noisy])
        head = "x_mm,y_mm,ux_mm,uy_mm"
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header=head, comments="")
    path = folder / "strip.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def test_diagnosis_finds_the_stiffness_and_predicts_the_force(tmp_path):
    source = read_experiment(written(tmp_path, described()))
    check_source(source)
    assert ("body", "sheet of 40 x 20 mm, 0.5 mm thick") in READER.understood(
        tmp_path / "strip.yaml"
    )
    again = type(source).from_content(source.content)
    assert again.spec == source.spec
    names = ["stiffness_gradient", "compressibility"]
    store = diagnosed_store(source, tmp_path / "store", NODES, effects=names)
    diagnosis = diagnosis_in(store)
    displacements = model_displacements(diagnosis, map)
    summary = summarise(diagnosis, store.effects, source.name)
    drawn, summary = source.describe(diagnosis, displacements, summary, None)
    found = diagnosis.analysis.nominal.values()["E"]
    assert 1e3 * found == pytest.approx(E_KPA, rel=0.02)
    ((force,),) = (one.reactions for one in summary.predictions)
    assert force.force_n == pytest.approx(force_n(1.4), rel=0.02)
    assert all(np.isnan(p.displacement_mm[2]) for p in summary.markers[0].points)
    assert drawn["edges_before"].shape[1:] == drawn["edges_rest"].shape
    assert drawn["edges_rest"].shape[1:] == (2, 3)
    assert any("bending" in name for name, _ in summary.not_simulated)
    assert "uz_mm was not measured and is not compared." in summary.data_notes


def diagnosed(source, folder, names):
    """Return the summary of a diagnosis with some effects."""
    store = diagnosed_store(source, folder / "store", NODES, effects=names)
    return summarise(diagnosis_in(store), store.effects, source.name)


def with_forces(data, force):
    """Set the readings of the load cell."""
    for state, stretch in zip(data["states"], STRETCHES.values(), strict=True):
        state["reactions"][0]["force_n"] = force(stretch)
    return data


GRIPS = ["grip_slip", "load_cell_offset", "stiffness_gradient", "frame_turn"]


def test_slip_of_the_moving_grip_is_found(tmp_path):
    data = with_forces(described(), lambda stretch: force_n(1 + 0.7 * (stretch - 1)))
    source = read_experiment(written(tmp_path, data, slip=0.3))
    summary = diagnosed(source, tmp_path, GRIPS)
    assert summary.primary == ("grip_slip",)
    assert summary.effect("grip_slip").magnitude == pytest.approx(0.3, abs=0.01)
    assert summary.constants["E_kpa"].after == pytest.approx(E_KPA, rel=0.02)


def test_offset_of_a_load_cell_is_found(tmp_path):
    offset_n = 0.02
    data = with_forces(described(), lambda stretch: force_n(stretch) + offset_n)
    summary = diagnosed(read_experiment(written(tmp_path, data)), tmp_path, GRIPS)
    assert summary.primary == ("load_cell_offset",)
    assert summary.effect("load_cell_offset").magnitude == pytest.approx(offset_n, rel=0.25)
    assert summary.constants["E_kpa"].after == pytest.approx(E_KPA, rel=0.04)


def test_reads_markers_without_z(tmp_path):
    markers = {
        "rest_s": [0, 1],
        "loaded_s": [-1, 0],
        "sd_mm": 0.01,
        "markers": {f"M{k}": {"at_mm": [x, y, 0]} for k, (x, y) in enumerate(points().tolist())},
    }
    data = described(markers=markers)
    del data["field"]
    path = written(tmp_path, data)
    head = "t_s," + ",".join(f"M{k}_{a}_mm" for k in range(12) for a in "xy")
    for name, stretch in STRETCHES.items():
        rest = points().ravel()
        rows = [[t, *(rest + (t > 2) * moved(stretch).ravel())] for t in np.arange(0, 4.1, 0.5)]
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header=head, comments="")
    source = read_experiment(path)
    check_source(source)
    np.testing.assert_allclose(source.observed.moved_mm[1, :, :2], moved(STRETCHES["more"]))
    assert np.isnan(source.observed.moved_mm[..., 2]).all()
    assert source.inverse_problem(NODES).arms is None
    assert "marker_standoff" not in [effect.name for effect in source.effects]


def test_derivatives_of_points_and_readings_match_finite_differences(tmp_path):
    source = read_experiment(written(tmp_path, described()))
    inverse = source.inverse_problem(NODES)
    assert isinstance(inverse.forward, SheetForward)
    build = inverse.scans[1].problem
    ahead, at, behind = (
        inverse.forward.equilibrium(inverse.model, build({"E": e})) for e in (0.081, 0.08, 0.079)
    )
    (slope,) = inverse.forward.tangents(at, [Change(ahead.problem, behind.problem, 0.002)], 1e-9)
    by_hand = (ahead.solution.displacement_mm - behind.solution.displacement_mm) / 0.002
    np.testing.assert_allclose(slope, by_hand, atol=1e-6 * np.abs(by_hand).max())
    again = inverse.forward.equilibrium(inverse.model, at.problem, ahead)
    difference = again.solution.displacement_mm - at.solution.displacement_mm
    assert np.abs(difference).max() < 1e-6


def test_sheet_from_python_has_stress_thickness_and_derivatives():
    strip = palpate.Specimen(described(), nodes=NODES)
    result = strip.simulate("most", E_kpa=E_KPA)
    assert result.converged
    right = result.nodes_mm[:, 0] > LENGTH - 1e-6
    assert result.reaction_n[right, 0].sum() == pytest.approx(force_n(1.4), rel=1e-3)
    assert result.thickness_mm == pytest.approx(THICKNESS * 1.4**-0.5, rel=1e-3)
    area = WIDTH * THICKNESS / 1.4
    assert result.cauchy_stress_mpa[:, 0, 0] == pytest.approx(force_n(1.4) / area, rel=1e-3)
    assert np.abs(result.cauchy_stress_mpa[:, 1]).max() < 1e-4
    assert np.abs(result.gradient("E_kpa")).max() < 1e-9
    assert result.to_meshio().cells[0].type == "triangle6"
    assert repr(result).startswith(f"<SheetSimulation of {len(result.nodes_mm)} nodes, ")
    assert len(repr(result)) < 200


def test_pressure_inflates_a_sheet():
    angle = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    outline = (10 * np.column_stack([np.cos(angle), np.sin(angle)])).tolist()
    data = described(
        body={"sheet": {"outline_mm": outline, "thickness_mm": 0.1}},
        regions={"rim": {"outside_circle_mm": {"centre": [0, 0], "radius": 9.9}}},
        holds=[{"region": "rim"}],
        states=[{"name": "blown", "files": ["never-read.csv"], "pressure_kpa": 0.01}],
        predict=[],
    )
    result = palpate.Specimen(data, nodes=400).simulate("blown", E_kpa=100)
    assert result.converged
    height = result.displacement_mm[:, 2].max()
    # w = 0.595 a (p a / E t)^(1/3), H. Hencky, Z. Math. Phys. 63 (1915) 311, and a little more.
    assert height == pytest.approx(0.595 * 10 * np.cbrt(1e-5 * 10 / 0.01), rel=0.06)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ({}, "give exactly one of box_mm, mesh and sheet, found none"),
        (
            {"box_mm": [1, 1, 1], "sheet": {"size_mm": [1, 1], "thickness_mm": 1}},
            "give exactly one of box_mm, mesh and sheet, found box_mm and sheet",
        ),
        ({"sheet": {"size_mm": [9, 9]}}, "thickness at rest, in mm"),
        ({"sheet": {"thickness_mm": 1}}, "give exactly one of size_mm and outline_mm"),
        (
            {"sheet": {"size_mm": [9, 9], "thickness_mm": 1}, "voxel_mm": 1},
            "are for a mesh, not for a sheet",
        ),
    ],
)
def test_rejects_invalid_sheets(body, message):
    with pytest.raises(InputError, match=message):
        palpate.Specimen(described(body=body))


def test_rejects_pressure_on_a_block():
    data = described(body={"box_mm": [40, 20, 5]})
    data["states"][0]["pressure_kpa"] = 1.0
    with pytest.raises(InputError, match="pressure_kpa inflates a sheet"):
        palpate.Specimen(data)
