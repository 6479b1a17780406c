"""Valid and invalid files of experiments."""

from pathlib import Path

import pytest
import yaml

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.boundary_value_problem import GRAVITY_MM_PER_S2
from palpate.workers.mechanics.fem.loads_and_regions import Hold, Wall
from palpate.workers.mechanics.materials.polynomial_laws import Yeoh
from palpate.workers.organs.specimen.experiment_files import understood
from palpate.workers.organs.specimen.specimen_keys import read_spec
from palpate.workers.organs.specimen.specimen_problem import free_constants, problem_of
from tests.workers.organs.specimen.experiments import described, write

EXAMPLE = Path(__file__).parents[4] / "examples" / "beam.yaml"


def changed(path, value):
    """Return the description with one value changed or removed."""
    data = described()
    *way, last = path.split(".")
    at = data
    for key in way:
        at = at[int(key)] if isinstance(at, list) else at[key]
    if value is None:
        del at[last]
    else:
        at[last] = value
    return data


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("holds", [{"region": "clmap"}], "clamp"),
        ("states.1.forces", [{"region": "tip"}], "exactly one of force_n and mass_g"),
        ("body", {"box_mm": [1, 2, 3], "mesh": "a.stl"}, "exactly one of box_mm, mesh and sheet"),
        ("body", {"mesh": "a.stl"}, "voxel_mm"),
        ("materials.rubber.E_kpa", [400, 40], "lower < upper"),
        ("materials.rubber.nu", 0.5, "less than 0.5"),
        ("markers", None, "exactly one of markers and field"),
        ("markers.column", "x", "{marker}"),
        ("down", [0, 0, 0], "down must not be zero"),
        ("gravty", "modelled", "gravity"),
        ("states.1.name", "bare", "each name once"),
        ("regions.tip", {}, "one of box_mm, plane and outside_circle_mm"),
    ],
)
def test_rejects_invalid_values(tmp_path, path, value, words):
    with pytest.raises(InputError, match=words):
        read_spec(write(tmp_path, changed(path, value)))


def test_rejects_missing_files_and_other_content(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_spec(tmp_path / "nowhere.yaml")
    (tmp_path / "a.yaml").write_text("a: [")
    with pytest.raises(InputError, match="not valid YAML"):
        read_spec(tmp_path / "a.yaml")
    (tmp_path / "b.yaml").write_text("- 1")
    with pytest.raises(InputError, match="not an experiment"):
        read_spec(tmp_path / "b.yaml")


def test_reads_the_example():
    spec = read_spec(EXAMPLE)
    assert [s.name for s in spec.states] == ["0 g", "52 g"]
    assert [s.name for s in spec.predict] == ["101 g"]
    assert yaml.safe_load(EXAMPLE.read_text())["organ"] == "specimen"


def test_converts_loads_and_holds_to_a_problem(tmp_path):
    data = changed("gravity", "modelled")
    data["states"][1] |= {
        "forces": [{"region": "tip", "mass_g": 5}],
        "moves": [{"region": "tip", "displacement_mm": [1, 0, 0], "axes": ["x"]}],
    }
    spec = read_spec(write(tmp_path, data))
    problem = problem_of(spec, spec.states[1], {"E": 0.1}, 0.0)
    constants = problem.constants[Tissue.FAT]
    assert (constants.young_mpa, constants.poisson) == (0.1, 0.45)
    assert constants.density_t_per_mm3 == pytest.approx(1.2e-9)
    assert problem.gravity_g == (0, -1, 0)
    assert problem.wall == Wall((True, True, True))
    assert problem.forces[0].force_n == pytest.approx((0, -5e-6 * GRAVITY_MM_PER_S2, 0))
    assert problem.holds == (Hold(problem.forces[0].region, (1.0, 0.0, 0.0), (True, False, False)),)


def test_hold_off_the_lowest_plane_is_not_a_wall(tmp_path):
    data = described()
    data["holds"] = [{"region": "tip", "axes": ["y"]}]
    spec = read_spec(write(tmp_path, data))
    problem = problem_of(spec, spec.states[0], {"E": 0.1}, 0.0)
    assert problem.wall == Wall((False, False, False))
    assert problem.holds[0].axes == (False, True, False)


def test_reads_a_material_with_yeohs_law(tmp_path):
    rubber = described()["materials"]["rubber"] | {"law": "yeoh"}
    constants = {"yeoh_c2": [0.1, 2], "yeoh_c3": -0.5}
    spec = read_spec(
        write(tmp_path, described(materials={"rubber": rubber | {"constants": constants}}))
    )
    assert [free.name for free in free_constants(spec)] == ["E", "yeoh_c2"]
    assert free_constants(spec)[1].unit.symbol == ""
    problem = problem_of(spec, spec.states[1], {"E": 0.1, "yeoh_c2": 0.4}, 0.0)
    (rubber_at_work,) = problem.constants.values()
    mu = rubber_at_work.mu_mpa
    assert rubber_at_work.law == Yeoh(mu / 2, 0.4 * mu, -0.5 * mu)
    assert not spec.can_stiffen
    assert "yeoh, yeoh_c2 expected from 0.1 to 2, yeoh_c3 -0.5" in dict(understood(spec))["rubber"]


def test_default_law_is_neo_hookean_and_not_stored(tmp_path):
    spec = read_spec(write(tmp_path, described()))
    assert spec.can_stiffen
    assert "constants" not in spec.model_dump(mode="json")["materials"]["rubber"]
    (rubber,) = problem_of(spec, spec.states[1], {"E": 0.1}, 0.0).constants.values()
    assert rubber.law is None


@pytest.mark.parametrize(
    ("law", "constants", "words"),
    [
        ("yeo", {}, "did you mean 'yeoh'"),
        ("yeoh", {"fung_b": 1}, "belongs to the law fung, but law is yeoh"),
        ("yeoh", {"yeoh_c9": 1}, "did you mean 'yeoh_c"),
        ("fung", {"fung_b": -1}, "at least 0"),
        ("fung", {"fung_b": [3, 1]}, "lower < upper"),
        ("fung", {"fung_b": [0, 1]}, "greater than 0"),
    ],
)
def test_rejects_invalid_shape_constants(tmp_path, law, constants, words):
    rubber = described()["materials"]["rubber"] | {"law": law, "constants": constants}
    with pytest.raises(InputError, match=words):
        read_spec(write(tmp_path, described(materials={"rubber": rubber})))
