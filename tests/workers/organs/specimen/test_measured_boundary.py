"""Regions that move as measured, and fitted Poisson's ratios."""

import json
from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.diagnosis.problem.inverse_problem import Tetrahedra
from palpate.workers.mechanics.fem.body_equilibrium import equilibrium
from palpate.workers.mechanics.fem.boundary_value_problem import Problem
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.fem.loads_and_regions import (
    EVERYWHERE,
    DisplacementField,
    Hold,
    NoPlates,
)
from palpate.workers.organs.specimen.experiment_files import read_experiment
from palpate.workers.organs.specimen.mesh_and_boundary_errors import (
    affine_changes,
    boundary_covariance,
)
from palpate.workers.organs.specimen.specimen_source import SpecimenSource
from tests.workers.organs.specimen.experiments import SIZE, described, write

NODES = 700
# Slender bodies under a small strain: u = (-nu e x, -nu e y, e z) and a force E e A, exactly.
STRAIN, NU, YOUNG_KPA = -0.004, 0.35, 120.0
FORCE_N = YOUNG_KPA * 1e-3 * STRAIN * SIZE[0] * SIZE[1]
ENDS = {
    "bottom": {"box_mm": {"lower": [0, 0, 0], "upper": [12, 12, 8]}},
    "top": {"box_mm": {"lower": [0, 0, 40], "upper": [12, 12, 48]}},
}
MEASURED = [{"region": "bottom", "measured": True}, {"region": "top", "measured": True}]


def grid(step=4.0):
    """Return points of the body as in image correlation: none on its faces."""
    axes = [np.arange(step / 2, side, step) for side in SIZE]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def moved(points, size=1.0):
    """Return the displacements of points under uniaxial compression."""
    x, y, z = (points - [SIZE[0] / 2, SIZE[1] / 2, 0]).T
    return size * STRAIN * np.column_stack([-NU * x, -NU * y, z])


def experiment(folder, moves=MEASURED, nu=(0.2, 0.45), forces=()):
    """Write two states of a field, the second with half the strain."""
    data = described(field={"sd_mm": 0.001}, regions=ENDS, predict=[])
    del data["markers"], data["holds"]
    data["materials"]["rubber"]["nu"] = list(nu) if isinstance(nu, tuple) else nu
    for state, size in zip(data["states"], (1.0, 0.5), strict=True):
        rows = np.hstack([grid(), moved(grid(), size)])
        head = "x_mm,y_mm,z_mm,ux_mm,uy_mm,uz_mm"
        np.savetxt(folder / state["files"][0], rows, delimiter=",", header=head, comments="")
        state["moves"] = moves
        state["forces"] = [{"region": f, "force_n": [0, 0, size * FORCE_N]} for f in forces]
    return data


@pytest.mark.parametrize("thickness", [0.0, 3.0], ids=["of a plane", "of a layer"])
def test_extrapolates_an_affine_motion_exactly(thickness):
    rng = np.random.default_rng(4)
    points = rng.uniform([0, 0, 0], [20, 20, thickness], (30, 3))
    A, b = rng.normal(0, 0.1, (3, 3)), np.array([1.0, -2.0, 0.5])
    field = DisplacementField(*(tuple(map(tuple, p)) for p in (points, points @ A.T + b)))
    asked = rng.uniform([0, 0, 0], [20, 20, thickness], (50, 3))
    np.testing.assert_allclose(field.at(asked), asked @ A.T + b, atol=1e-9)


def test_interpolates_a_field_smoothly_between_points():
    points = grid(3.0)
    waves = 0.2 * np.sin(points / 6.0)
    hold = Hold(EVERYWHERE, DisplacementField(*(tuple(map(tuple, p)) for p in (points, waves))))
    np.testing.assert_allclose(hold.at(points), waves, atol=1e-8)
    between = points[np.all(points < np.array(SIZE) - 4, axis=1)] + 1.5
    np.testing.assert_allclose(hold.at(between), 0.2 * np.sin(between / 6.0), atol=0.01)


def test_recovers_poisson_ratio_from_moved_ends(tmp_path):
    """Both ends move as measured; nu is recovered within 0.003."""
    source = read_experiment(write(tmp_path, experiment(tmp_path)))
    _, found = calibrate(source.inverse_problem(NODES), None)
    assert (1 - found.values()["compressibility"]) / 2 == pytest.approx(NU, abs=0.003)
    assert "compressibility" not in [e.name for e in source.effects]


def test_recovers_stiffness_from_a_force_at_one_end(tmp_path):
    """One end moves as measured, and the other carries a measured force."""
    data = experiment(tmp_path, MEASURED[:1], forces=["face"])
    data["regions"] = ENDS | {"face": {"plane": {"axis": "z", "at_mm": SIZE[2]}}}
    source = read_experiment(write(tmp_path, data))
    _, found = calibrate(source.inverse_problem(NODES), None)
    values = found.values()
    assert values["E"] == pytest.approx(YOUNG_KPA * 1e-3, rel=0.02)
    # Nodes of the face carry equal forces, also at its edges, which affects points near it.
    assert (1 - values["compressibility"]) / 2 == pytest.approx(NU, abs=0.015)


def test_poisson_ratio_stays_positive_after_a_long_step(tmp_path):
    """A fit that tries 1 - 2 nu > 1 continues."""
    source = read_experiment(write(tmp_path, experiment(tmp_path)))
    tried = source.problem(source.spec.states[0])({"E": 0.1, "compressibility": 2.6})
    (constants,) = tried.constants.values()
    assert 0 < constants.poisson < 0.002


def test_boundary_points_are_not_compared(tmp_path):
    source = read_experiment(write(tmp_path, experiment(tmp_path)))
    z = grid()[:, 2]
    own = grid()[(z > 8) & (z < 40)]
    np.testing.assert_array_equal(source.observed.points_mm, own)
    assert len(source.observed.covariance) == 2 * 3 * len(own)
    assert [int(n) for n in source.observed.names] == np.flatnonzero((z > 8) & (z < 40)).tolist()
    assert source.observed.boundary_moved_mm.shape == (2, len(z) - len(own), 3)


def test_content_restores_the_boundary(tmp_path):
    source = read_experiment(write(tmp_path, experiment(tmp_path)))
    content = source.content
    json.dumps(content.record)
    again = SpecimenSource.from_content(content)
    constants = {f.name: np.exp(f.log_mean) for f in source.free}
    for before, after in zip(source.spec.states, again.spec.states, strict=True):
        assert again.problem(after)(constants) == source.problem(before)(constants)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"predict": [{"name": "more", "moves": MEASURED}]}, "but there is no recording"),
        ({"regions": ENDS | {"top": {"plane": {"axis": "z", "at_mm": 48}}}}, "0 points of the"),
        ({"predict": [{"name": "free"}]}, "nothing holds the body"),
    ],
)
def test_rejects_unmeasured_boundaries(tmp_path, change, words):
    with pytest.raises(InputError, match=words):
        read_experiment(write(tmp_path, experiment(tmp_path) | change))


def test_rejects_invalid_moves_and_fields(tmp_path):
    both = [{"region": "top", "measured": True, "displacement_mm": [0, 0, 1]}]
    with pytest.raises(InputError, match="exactly one of displacement_mm and measured"):
        read_experiment(write(tmp_path, experiment(tmp_path, both)))
    with pytest.raises(InputError, match="none is left to compare"):
        data = experiment(tmp_path)
        data["regions"] = {n: {"box_mm": {"lower": [0] * 3, "upper": list(SIZE)}} for n in ENDS}
        read_experiment(write(tmp_path, data))
    with pytest.raises(InputError, match="listed twice"):
        data = experiment(tmp_path)
        for state in data["states"]:
            lines = (tmp_path / state["files"][0]).read_text().splitlines()
            (tmp_path / state["files"][0]).write_text("\n".join([*lines, lines[1]]) + "\n")
        read_experiment(write(tmp_path, data))
    with pytest.raises(InputError, match="nu needs"):
        read_experiment(write(tmp_path, experiment(tmp_path, nu=(0.4, 0.3))))


@pytest.mark.slow
def test_boundary_covariance_matches_random_draws(tmp_path):
    """Compared with 40 solved draws of the noise, at points at least two layers above the slab."""
    sd_mm, rng = 0.01, np.random.default_rng(5)
    source = read_experiment(write(tmp_path, experiment(tmp_path, MEASURED[:1])))
    mesh = source.body.mesh(NODES)
    model = prepare(mesh)
    problem = source.problem(source.spec.states[0])({"E": 0.1, "compressibility": 0.3})
    points = grid()[grid()[:, 2] > 16]
    at = interpolation_at_points(mesh.finest.mesh, points)
    expected = boundary_covariance(
        Tetrahedra(), model, lambda u: (at @ u).ravel(), [problem], sd_mm
    )
    (hold,) = problem.holds
    known = np.array(hold.displacement_mm.displacement_mm)
    start, moved = equilibrium(model, problem), []
    for _ in range(40):
        noisy = known + sd_mm * rng.standard_normal(known.shape)
        field = replace(hold.displacement_mm, displacement_mm=tuple(map(tuple, noisy)))
        drawn = replace(problem, holds=(replace(hold, displacement_mm=field),))
        solved = equilibrium(model, drawn, start).solution.displacement_mm
        moved.append(at @ (solved - start.solution.displacement_mm))
    shown = np.mean(np.square(moved), axis=0)  # (k, 3)
    said = np.diag(expected).reshape(-1, 3)
    # 40 draws determine a sum of two modes within a fifth; tilt adds five times sd sideways.
    assert np.sqrt(shown.mean(axis=0)) == pytest.approx(np.sqrt(said.mean(axis=0)), rel=0.25)
    assert np.sqrt(said[:, 0].max()) > 2 * sd_mm
    assert np.corrcoef(shown.ravel(), said.ravel())[0, 1] > 0.9


def test_boundary_noise_is_limited_to_measured_states(tmp_path):
    data = experiment(tmp_path, MEASURED[:1])
    stated = {"region": "bottom", "displacement_mm": [0, 0, 0]}
    data["states"][1]["moves"] = [stated]
    source = read_experiment(write(tmp_path, data))
    added = source.inverse_problem(NODES).covariance - source.observed.covariance
    size = len(added) // 2
    assert added[:size, :size].diagonal().min() > 0
    assert not added[size:].any()


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 2, 3)], ids=["along z", "oblique"])
def test_plane_has_three_affine_modes_along_each_axis(normal):
    """Their squares sum to the hat matrix of a plane: a trace of three for each axis."""
    rng, sd_mm = np.random.default_rng(6), 0.02
    across = np.linalg.svd(np.array([normal], float))[2][1:]
    points = rng.uniform(-5, 5, (20, 2)) @ across
    rows = tuple(map(tuple, points))
    field = DisplacementField(rows, tuple((0.0, 0.0, 0.0) for _ in rows))
    problem = Problem({}, NoPlates(), holds=(Hold(EVERYWHERE, field),))
    changes = affine_changes(problem, 0, field, sd_mm)
    steps = [
        np.subtract(*(side.holds[0].displacement_mm.displacement_mm for side in (c.plus, c.minus)))
        for c in changes
    ]
    modes = np.array(steps).reshape(len(steps), -1) / 2
    A = np.column_stack([np.ones(20), points @ across.T])
    hat = A @ np.linalg.inv(A.T @ A) @ A.T
    np.testing.assert_allclose(modes.T @ modes, sd_mm**2 * np.kron(hat, np.eye(3)), atol=1e-12)
