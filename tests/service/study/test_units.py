"""Units of printed numbers; only given parameters are printed."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from palpate.service.cli import main
from palpate.service.number_formatting import not_neutral, quantities_inside
from palpate.service.results.results_from_journal import candidate_results
from palpate.storage.json_digests import digest
from palpate.workers.organs.breast.breast_effects import BREAST_MODEL
from palpate.workers.tasks import study_tasks
from tests.recovery.stand_ins import SPEC, Inline, run, small_spec

Printed = Callable[..., str]


@pytest.fixture
def printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Printed:
    """Return a function that runs a command in the folder of a study file and captures output."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.yaml").write_text(SPEC)

    def calling(*arguments: object) -> str:
        assert main([str(argument) for argument in arguments]) == 0
        return capsys.readouterr().out

    return calling


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the simulation by a stub that returns completed constants and an outcome."""

    def simulate_once(case, constants, store):  # type: ignore[no-untyped-def]
        return {
            "digest": digest("nothing"),
            "status": "done",
            "reason": "",
            "outcome": {"plate_force_n": 40.0, "newton_iterations": [3, 4], "min_j": 0.7},
            "constants": study_tasks.case_of(case).complete(constants),
            "seconds": {"solve": 1.25},
            "worker": "here",
            "volume": None,
        }

    monkeypatch.setattr("palpate.service.commands.studies.simulate.simulate_once", simulate_once)


@pytest.mark.usefixtures("simulated")
def test_simulate_prints_stated_values_with_units(printed: Printed) -> None:
    said = printed("simulate", "study.yaml", "--set", "E_fat_kpa=12", "--set", "tilt_depth_deg=1")
    assert re.search(r"E_fat_kpa +12 kPa$", said, re.MULTILINE)
    assert re.search(r"tilt_depth_deg +1 deg$", said, re.MULTILINE)
    assert re.search(r"plate_force +40 N$", said, re.MULTILINE)
    assert re.search(r"solve +1\.25 s$", said, re.MULTILINE)
    assert "MPa" not in said
    assert "inclusion_radius" not in said
    assert "more at their neutral values: --all" in said


@pytest.mark.usefixtures("simulated")
def test_option_all_shows_neutral_parameters_with_units(printed: Printed) -> None:
    said = printed("simulate", "study.yaml", "--all")
    assert re.search(r"E_glandular_kpa +40 kPa$", said, re.MULTILINE)
    assert re.search(r"nu +0\.49$", said, re.MULTILINE)
    assert re.search(r"inclusion_radius_mm +6 mm$", said, re.MULTILINE)


@pytest.mark.usefixtures("simulated")
def test_json_constants_have_value_and_unit(printed: Printed) -> None:
    said = json.loads(printed("simulate", "study.yaml", "--set", "E_fat_kpa=12", "--json"))
    assert said["constants"] == {"E_fat_kpa": {"value": 12.0, "unit": "kPa"}}
    said = json.loads(printed("simulate", "study.yaml", "--all", "--json"))
    assert said["constants"]["nu"] == {"value": 0.49, "unit": ""}
    assert len(said["constants"]) == len(BREAST_MODEL)


def test_show_prints_units_of_searched_and_held_parameters(
    tmp_path: Path, printed: Printed
) -> None:
    held = SPEC.replace("mesh: {nodes: 2000}", "mesh: {nodes: 2000}, constants: {nu: 0.48}")
    folder = tmp_path / "runs" / "demo"
    run(folder, Inline(), small_spec(held))
    genes = candidate_results(folder, 3).genes
    said = printed("show", 3)
    assert re.search(rf"E_fat_kpa +{genes['E_fat_kpa']:.6g} kPa$", said, re.MULTILINE)
    assert re.search(r"nu +0\.48$", said, re.MULTILINE)
    assert re.search(r"generation +1$", said, re.MULTILINE)
    record = json.loads(printed("show", 3, "--json"))
    assert record["genes"]["E_fat_kpa"] == {"value": genes["E_fat_kpa"], "unit": "kPa"}
    assert record["held"] == {"nu": {"value": 0.48, "unit": ""}}
    everything = json.loads(printed("show", 3, "--all", "--json"))["held"]
    assert everything["tilt_depth_deg"] == {"value": 0.0, "unit": "deg"}
    assert "E_fat_kpa" not in everything
    best = json.loads(printed("report", "--json"))["best"]
    assert best["genes"]["E_fat_kpa"]["unit"] == "kPa"


def test_parameters_command_prints_units(printed: Printed) -> None:
    said = printed("parameters")
    assert re.search(r"E_fat_kpa +5 to 20 kPa +10 kPa", said)
    assert re.search(r"tilt_depth_deg +-5 to 5 deg +0 deg", said)


def test_muscle_stiffness_equal_to_fat_is_neutral() -> None:
    constants = BREAST_MODEL.complete({"E_fat": 0.012})
    assert set(not_neutral(BREAST_MODEL, constants)) == {"E_fat"}
    apart = BREAST_MODEL.complete({"E_fat": 0.012, "E_muscle": 0.01})
    assert str(
        quantities_inside(BREAST_MODEL, not_neutral(BREAST_MODEL, apart))["E_muscle_kpa"]
    ) == ("10 kPa")
