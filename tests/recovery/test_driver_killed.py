"""A driver killed with signal 9, three times; its own cluster goes down with it."""

from pathlib import Path

from processes import kill_and_finish
from stand_ins import Inline, assert_each_ran_once, run, told


def test_driver_killed_three_times(tmp_path: Path) -> None:
    run(tmp_path / "undisturbed" / "demo", Inline())
    folder = tmp_path / "runs" / "demo"
    kill_and_finish(folder, ["--workers", "2"], killed_after=[1, 8, 20])
    assert told(folder) == told(tmp_path / "undisturbed" / "demo")
    assert_each_ran_once(folder, cut_off=6)  # two workers go down with each of the three
