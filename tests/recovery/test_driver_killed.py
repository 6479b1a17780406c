"""A driver killed twice with signal 9, together with its own cluster."""

from pathlib import Path

from tests.recovery.processes import kill_and_finish
from tests.recovery.stand_ins import Inline, assert_each_ran_once, run, told


def test_driver_killed_twice(tmp_path: Path) -> None:
    run(tmp_path / "undisturbed" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    kill_and_finish(folder, ["--workers", "2"], killed_after=[1, 20])
    assert told(folder) == told(tmp_path / "undisturbed" / "demo")
    assert_each_ran_once(folder, cut_off=4)  # two workers die each time
