"""The page's template and style are part of the distribution."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]


def test_template_and_style_are_included_in_the_wheel() -> None:
    wheel = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed")
    packed = {
        Path(file.distribution_path)
        for file in wheel.WheelBuilder(str(ROOT)).recurse_included_files()
    }
    folder = Path("palpate/service/report/page")
    needed = {"study.html.j2", "macros.html.j2", "report.css", "page_elements.py"}
    scripts = {path.name for path in (ROOT / folder / "scripts").glob("*.js")}
    assert {"common.js", "slices.js", "body.js", "charts.js", "downloads.js", "page.js"} == scripts
    assert {folder / name for name in needed} <= packed
    assert {folder / "scripts" / name for name in scripts} <= packed
