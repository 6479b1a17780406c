"""Console output, table and page of `palpate compare`."""

import json
from collections.abc import Callable
from pathlib import Path

from tests.recovery.stand_ins import Inline, run, small_spec
from tests.recovery.test_strategies import spec_of

Call = Callable[..., tuple[int, str, str]]


def test_studies_are_compared_on_terminal_as_json_as_csv_and_as_page(
    call: Call, tmp_path: Path
) -> None:
    run(tmp_path / "runs" / "a", Inline(), spec_of("least-squares"))
    run(tmp_path / "runs" / "b", Inline(), small_spec())
    code, out, err = call("compare", "a", "b", "--out", "c.csv", "--page", "c.html")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].split() == ["constant", "runs/a", "runs/b"]
    assert any(line.split() == ["search.strategy", "least-squares", "genetic"] for line in lines)
    assert (
        "* Not quotable: runs/b, E_fat_kpa and E_glandular_kpa: the search has not converged."
        in lines
    )
    assert lines[-2:] == ["table: c.csv", "page: c.html"]
    assert Path("c.csv").read_text().startswith("study,quantity,unit,value")
    assert Path("c.html").read_text().lstrip().startswith("<!DOCTYPE html>")
    code, out, _ = call("compare", "a", "b", "--json")
    assert json.loads(out)["settings"]["search.strategy"] == ["least-squares", "genetic"]
    code, _, err = call("compare", "a")
    assert (code, err) == (2, "Error: A comparison needs at least two studies, got 1.\n")
