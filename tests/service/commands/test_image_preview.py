"""The preview of `palpate import`, which reveals wrong axes."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from palpate.service.cli import main
from palpate.service.commands.images.image_preview import doubt, facts, terminal_lines
from palpate.storage.values import Volume
from palpate.workers.body.images.tissue_labels import summarise

CONE = np.zeros((12, 20, 20), np.uint8)  # [z, y, x], widest at z = 0
for _z in range(12):
    _reach = 9 - _z // 2
    CONE[_z, 10 - _reach : 10 + _reach, 10 - _reach : 10 + _reach] = 1
CONE[2:6, 8:12, 8:14] = 2
BODY = Volume(CONE, (1.0, 2.0, 4.0))


def test_facts_agree_with_image() -> None:
    rows = dict(facts(summarise(BODY, named=True), "y,x,z"))
    assert rows["voxels"] == "20 x 20 x 12"
    assert rows["spacing"] == "1 x 2 x 4 mm"
    assert rows["body x"].startswith("18 mm")  # 18 voxels of 1 mm
    assert rows["body y"].startswith("36 mm")
    assert rows["body z"].startswith("48 mm")
    assert "y of the image: across the compression" in rows["body x"]
    gland = 4 * 4 * 6 * 8 / 1000
    fat = (CONE == 1).sum() * 8 / 1000
    assert rows["glandular"].startswith(f"{gland:.4g} ml, {100 * gland / (fat + gland):.3g} %")
    assert rows["total"] == f"{fat + gland:.4g} ml"


def test_warns_about_reversed_body() -> None:
    assert doubt(BODY) == ""
    assert doubt(BODY, ("L", "S", "A")) == ""
    assert "z increases towards S" in doubt(BODY, ("R", "A", "S"))
    turned = doubt(Volume(np.ascontiguousarray(CONE[::-1]), BODY.spacing_mm))
    assert "--axes" in turned
    assert "6.48 cm2" in turned  # 18 x 18 pixels of 1 x 2 mm


@pytest.mark.parametrize("width", [30, 80, 200])
def test_slices_fit_the_terminal_and_keep_their_shape(width: int) -> None:
    lines = [line.plain for line in terminal_lines(BODY, width, colours=False)]
    assert max(map(len, lines)) <= width
    drawing = "\n".join(lines)
    assert "#" in drawing
    assert "." in drawing
    if width == 30:  # one below the other: the coronal one is 20 mm wide and 40 mm high
        first = drawing.split("transverse")[0].splitlines()[1:]
        across = max(len(line.rstrip()) - len(line) + len(line.lstrip()) for line in first)
        filled = sum(bool(line.strip()) for line in first)
        assert 2 * filled / across == pytest.approx(36 / 18, rel=0.25)


def test_colours_are_drawn_as_half_blocks() -> None:
    console = Console(width=80, force_terminal=True, color_system="truecolor", record=True)
    with console.capture() as captured:
        for line in terminal_lines(BODY, 80, colours=True):
            console.print(line, no_wrap=True)
    drawn = captured.get()
    assert "▀" in drawn
    assert "38;2;168;50;110" in drawn  # glandular tissue


def test_import_prints_and_draws_preview(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("cone.npy", CONE)
    options = ["--labels", "{0: air, 1: fat, 2: glandular}", "--spacing-mm", "1", "2", "4"]
    assert main(["import", "cone.npy", "--name", "cone", *options]) == 0
    out = capsys.readouterr().out
    assert "coronal" in out
    assert "#" in out
    assert "\x1b" not in out
    assert re.search(r"slices: runs/images/cone.png", out)
    assert Path("runs/images/cone.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert main(["import", "cone.npy", "--name", "cone", *options, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["spacing_mm"] == [1, 2, 4]
    assert found["axes"] == "x,y,z"
    assert found["png"] == "runs/images/cone.png"
    assert main(["import", "cone.npy", "--name", "cone", *options, "--axes", "-x,y,-z"]) == 2
    assert main(["import", "cone.npy", "--name", "c2", *options, "--axes", "-x,y,-z"]) == 0
    assert "Check: The body is wider at the high end of z" in capsys.readouterr().err
    assert main(["import", "cone.npy", "--name", "c3", *options, "--png", "p.gif"]) == 2
    assert "use one of .png" in capsys.readouterr().err
