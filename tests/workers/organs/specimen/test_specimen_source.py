"""An experiment on a known body: files, residuals and diagnosis."""

from functools import cache

import meshio
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.diagnosis.fits.gauss_newton import fit
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.diagnosis.problem.scan_prediction import derivatives, predict_scan
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.fem.loads_and_regions import Box, DeadForce, NoPlates, Wall
from palpate.workers.organs.specimen.block_lattice import lattice, lattices
from palpate.workers.organs.specimen.experiment_files import files_of, read_experiment
from palpate.workers.organs.specimen.specimen_keys import read_spec
from palpate.workers.tasks.diagnosis_sources import check_source
from tests.workers.organs.specimen.experiments import (
    LOADS_N,
    MARKERS,
    SIZE,
    described,
    record,
    write,
)
from tests.workers.tasks.one_process import diagnosed_store, diagnosis_in

# The true body has weight, and its markers are on stalks.
YOUNG, DENSITY, STALK_MM = 0.12, 1.2e-9, 3.0
TURN = Rotation.from_euler("xyz", [20, -50, 100], degrees=True).as_matrix()
NODES = 700


def shown(force_n, gravity=1.0, stalk_mm=STALK_MM):
    """Return displacements of markers on stalks, extrapolated from two finer meshes."""
    rough, fine = (meshed(n, force_n, gravity, stalk_mm) for n in (4, 6))
    return fine + (fine - rough) / ((6 / 4) ** 2 - 1)


@cache
def meshed(across, force_n, gravity, stalk_mm):
    """Return displacements of markers on stalks on one mesh."""
    hierarchy = lattices(SIZE, (across, across, 4 * across))
    tip = Box((-1, -1, SIZE[2] - 1e-3), (99, 99, SIZE[2] + 1e-3))
    problem = Problem(
        {Tissue.FAT: Constants(YOUNG, 0.45, density_t_per_mm3=DENSITY)},
        NoPlates(),
        wall=Wall((True, True, True)),
        gravity_g=(0.0, -gravity, 0.0),
        forces=(DeadForce((0.0, -force_n, 0.0), tip),) if force_n else (),
    )
    u = solve(prepare(hierarchy), problem).displacement_mm
    mesh, moved = hierarchy.finest.mesh, []
    for at, out in MARKERS.values():
        foot, n = np.array(at), np.array(out)
        here, below = (interpolation_at_points(mesh, p[None]) @ u for p in (foot, foot - 2 * n))
        moved.append((here + stalk_mm * (here - below) / 2)[0])
    return np.array(moved)


def experiment(folder, rng=None, sd=0.0, **body):
    data = described()
    for state in data["states"]:
        moved = shown(LOADS_N[state["name"]], **body)
        names = [f"{state['name']}{r}.csv" for r in range(2)]
        for name in names:
            record(folder / name, moved, TURN, rng, sd)
        state["files"] = names
    return write(folder, data)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path = experiment(tmp_path_factory.mktemp("beam"), np.random.default_rng(0), 0.02)
    return read_experiment(path)


def test_recordings_are_rotated_into_the_frame_of_the_body(source):
    for moved, force in zip(source.observed.moved_mm, LOADS_N.values(), strict=True):
        np.testing.assert_allclose(moved, shown(force), atol=0.08)
    assert source.observed.misfit_mm == pytest.approx(0, abs=1e-6)


def test_residual_of_the_true_model_is_noise(source):
    """With weight and stalks the residual is within the scatter and the error of the mesh."""
    inverse = source.inverse_problem(NODES, 0.0)
    chosen = [e for e in source.effects if e.name in ("self_weight", "marker_standoff")]
    free = unknowns(inverse.free, chosen)
    z = np.array([np.log(YOUNG), 1.0, STALK_MM])
    for scan in inverse.scans:
        found = predict_scan(inverse, scan, free, z, None)
        moved = np.linalg.norm(found.points - inverse.points.points, axis=1)
        assert np.abs(found.residual).max() < 0.05 + 0.02 * moved.max()


@pytest.mark.slow
def test_derivatives_match_finite_differences(source):
    """Derivatives in constants and in effects on body and observation together."""
    inverse = source.inverse_problem(NODES, 0.0)
    wanted = ("self_weight", "marker_standoff", "frame_turn", "base_motion")
    free = unknowns(inverse.free, [e for e in source.effects if e.name in wanted])
    z = free.mean + 0.3 * free.sd
    z[0] = np.log(YOUNG)
    scan = inverse.scans[1]
    start = predict_scan(inverse, scan, free, z, None)
    jacobian = derivatives(inverse, scan, free, z, start)
    columns = getattr(jacobian, "columns", jacobian)
    for p, sd in enumerate(free.sd):
        h = 0.02 * sd
        ahead, behind = (
            predict_scan(inverse, scan, free, z + s * h * np.eye(len(z))[p], start.at).residual
            for s in (1, -1)
        )
        expected = (ahead - behind) / (2 * h)
        scale = max(1e-3, np.abs(expected).max())
        np.testing.assert_allclose(columns[:, p], expected, atol=0.01 * scale)


@pytest.mark.slow
def test_derivatives_in_shape_constants_match_finite_differences(tmp_path):
    """With Yeoh's law, c2 is a fitted constant and strain stiffening is not a candidate."""
    path = experiment(tmp_path)
    data = yaml.safe_load(path.read_text())
    data["materials"]["rubber"] |= {"law": "yeoh", "constants": {"yeoh_c2": [1, 4]}}
    source = read_experiment(write(tmp_path, data))
    assert "strain_stiffening" not in {e.name for e in source.effects}
    inverse = source.inverse_problem(NODES, 0.0)
    free, scan = unknowns(inverse.free, []), inverse.scans[1]
    z = np.log([YOUNG, 3.0])
    start = predict_scan(inverse, scan, free, z, None)
    jacobian = derivatives(inverse, scan, free, z, start)
    columns, h = getattr(jacobian, "columns", jacobian), 0.02
    for p in range(2):
        step = h * np.eye(2)[p]
        ahead, behind = (
            predict_scan(inverse, scan, free, z + s * step, start.at).residual for s in (1, -1)
        )
        expected = (ahead - behind) / (2 * h)
        assert np.abs(expected).max() > 0.01
        np.testing.assert_allclose(columns[:, p], expected, atol=0.01 * np.abs(expected).max())


def test_recovers_stiffness_with_a_complete_model(tmp_path):
    """A weightless body with markers on its surface, recorded without noise."""
    path = experiment(tmp_path, gravity=0.0, stalk_mm=0.0)
    _, found = calibrate(read_experiment(path).inverse_problem(NODES, 0.0), None)
    assert found.values()["E"] == pytest.approx(YOUNG, rel=0.015)


@pytest.mark.slow
def test_diagnosis_finds_weight_and_stalks(source, tmp_path):
    store = diagnosed_store(source, tmp_path / "store", NODES, 0.0)
    found, nominal = diagnosis_in(store), store.nominal
    assert found.verdict.kind == "effect"
    assert found.verdict.primary == ("self_weight", "marker_standoff")
    values = found.best.fit.values()
    assert values["E"] == pytest.approx(YOUNG, rel=0.02)
    assert values["marker_standoff"] == pytest.approx(STALK_MM, abs=0.2)
    assert nominal.values()["E"] < 0.8 * YOUNG
    left = np.array([v.residual for v in found.best.fit.predictions])
    assert np.sqrt((left**2).mean()) < 1.5 * 0.02


@pytest.mark.slow
def test_predicts_a_held_out_state(source):
    inverse = source.inverse_problem(NODES, 0.0)
    chosen = [e for e in source.effects if e.name in ("self_weight", "marker_standoff")]
    free = unknowns(inverse.free, chosen)
    best = fit(inverse, free, np.array([np.log(YOUNG), 1.0, STALK_MM]), [None, None])
    (heavier,) = source.predictions(inverse, best)
    assert heavier.state == "heavier"
    truth = shown(0.05)
    for point, moved in zip(heavier.points, truth, strict=True):
        sd = np.array(point.sd_mm)
        assert (sd > 0).all()
        away = np.abs(np.array(point.displacement_mm) - moved)
        assert (away < 0.05 + 4 * sd).all(), point.name
    assert [p.name for p in heavier.points] == list(MARKERS)


def test_files_of_lists_all_inputs(source, tmp_path):
    path = experiment(tmp_path)
    assert [f.name for f in files_of(read_spec(path), path)] == [
        "experiment.yaml",
        "bare0.csv",
        "bare1.csv",
        "loaded0.csv",
        "loaded1.csv",
    ]
    assert source.scans == ["bare", "loaded"]
    check_source(source)


def test_names_a_missing_recording(tmp_path):
    path = write(tmp_path, described())
    with pytest.raises(InputError, match=r"names bare\.csv, which is not in"):
        read_experiment(path)


def test_rejects_markers_in_another_unit(tmp_path):
    data = described()
    data["markers"]["mm_per_unit"] = 1000
    for state in data["states"]:
        record(tmp_path / state["files"][0], np.zeros((3, 3)), TURN)
    with pytest.raises(InputError, match="off its position at rest"):
        read_experiment(write(tmp_path, data))


def test_reads_a_field_of_points(tmp_path):
    """Points inside the body have no stalks, and no frame is fitted."""
    data = described(field={"sd_mm": 0.01, "common_sd_mm": 0.03})
    del data["markers"]
    points = np.random.default_rng(2).uniform([1, 1, 5], [11, 11, 47], (20, 3))
    head = "x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm"
    for state, size in zip(data["states"], (0.5, 1.0), strict=True):
        u = size * np.column_stack([0 * points[:, 0], -points[:, 2] / 48, points[:, 1] / 48])
        np.savetxt(
            tmp_path / state["files"][0],
            np.hstack([points, u]),
            delimiter=",",
            header=head,
            comments="",
        )
    source = read_experiment(write(tmp_path, data))
    check_source(source)
    inverse = source.inverse_problem(NODES, 0.0)
    assert inverse.arms is None
    assert "marker_standoff" not in [e.name for e in source.effects]
    assert len(inverse.points) == 60
    C = source.observed.covariance
    assert C[0, 0] == pytest.approx(0.01**2 + 0.03**2)
    assert C[0, 3] == pytest.approx(0.03**2)
    # A body that moves exactly as observed has no residual.
    nodes = inverse.model.finest.nodes
    u = np.column_stack([0 * nodes[:, 0], -nodes[:, 2] / 48, nodes[:, 1] / 48])
    r, normals = inverse.scans[1].compare(
        inverse.points.points + inverse.at_points @ u, inverse.points
    )
    np.testing.assert_allclose(r, 0, atol=1e-9)
    np.testing.assert_array_equal(normals[:3], np.eye(3))


def test_body_from_a_file_is_clamped_at_its_lowest_plane(tmp_path):
    """A voxelised block of tetrahedra has the wall, arms and loads of the block itself."""
    mesh = lattice(SIZE, (3, 3, 12))
    solid = meshio.Mesh(mesh.nodes / 10, [("tetra", mesh.tets)])
    meshio.write(tmp_path / "beam.vtk", solid)
    body = {"mesh": "beam.vtk", "mm_per_unit": 10, "voxel_mm": 0.7}
    data = described(body=body)
    for state in data["states"]:
        record(tmp_path / state["files"][0], shown(LOADS_N[state["name"]]), TURN)
    source = read_experiment(write(tmp_path, data))
    assert "clamp_compliance" in [e.name for e in source.effects]
    path = tmp_path / "experiment.yaml"
    assert [f.name for f in files_of(read_spec(path), path)][1] == "beam.vtk"
    assert source.finer(2000) is not None
    inverse = source.inverse_problem(1500, 0.0)
    assert inverse.scans[1].problem({"E": YOUNG}).wall == Wall((True, True, True))
    chosen = [e for e in source.effects if e.name in ("self_weight", "marker_standoff")]
    z = np.array([np.log(YOUNG), 1.0, STALK_MM])
    found = predict_scan(inverse, inverse.scans[1], unknowns(inverse.free, chosen), z, None)
    moved = np.linalg.norm(found.points - inverse.points.points, axis=1).max()
    # Rounded edges and stiff elements: rough, but the same body.
    assert np.abs(found.residual).max() < 0.15 * moved
