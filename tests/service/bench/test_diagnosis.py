"""Timing of a diagnosis, and its projection to more workers."""

from pathlib import Path

import pytest

from palpate.service.bench.diagnosis_timing import PhaseTimes, measure_diagnosis, projected
from palpate.service.cli import main
from palpate.workers.organs.breast.breast_effects import BREAST_EFFECTS
from tests.service.diagnosis.compressed_breast import write_case


def test_tasks_go_to_the_first_free_worker() -> None:
    """5, 3, 3 and 2 s: two workers get 5 + 2 and 3 + 3 s, assigned in this order."""
    phase = PhaseTimes("effects", (5.0, 3.0, 3.0, 2.0))
    assert [phase.on(n) for n in (1, 2, 3, 12)] == [13.0, 7.0, 5.0, 5.0]
    assert projected([phase, PhaseTimes("weighing", (4.0,))], 12) == 9.0


@pytest.mark.slow
def test_the_tasks_of_a_diagnosis_are_timed(tmp_path: Path) -> None:
    case, ended = write_case(tmp_path / "tilted", {"tilt_depth": 8.0}), []
    phases = measure_diagnosis(case, tmp_path / "store", 500, ended.append)
    assert phases == ended
    assert [one.phase for one in phases][:4] == [
        "preparation",
        "calibration",
        "effects",
        "weighing",
    ]
    assert phases[-1].phase == "weighing"
    counts = {one.phase: len(one.seconds) for one in phases}
    # Points, body, shapes and two scans; one for each effect and scan.
    assert counts["preparation"] == 5
    assert counts["effects"] == 2 * len(BREAST_EFFECTS)
    assert all(seconds > 0 for one in phases for seconds in one.seconds)
    assert projected(phases, 12) < projected(phases, 2) < projected(phases, 1)


def test_rejects_two_measurements_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--service", "--diagnosis", "case"]) == 2
    assert "cannot be combined: give one of them" in capsys.readouterr().err
