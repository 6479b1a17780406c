"""The stored volumes of candidates, read as the how-to page does."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "deformed-volumes.md"
STUDY = {
    "name": "a",
    "case": {"reference": {"phantom": {"spacing_mm": 2}}, "mesh": {"nodes": 850}},
    "target": {"constants": {"E_fat_kpa": 12}},
    "search": {"parameters": {"E_fat_kpa": [5, 20]}, "population": 4, "generations": 1},
    "keep": "all",
}


def test_the_how_to_reads_a_candidate_of_a_real_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    study = palpate.Study.from_dict(STUDY)
    study.run(in_process=True)
    here: dict[str, Any] = {}
    blocks = re.findall(r"<!-- candidates -->\n```python\n(.*?)^```", PAGE.read_text(), re.S | re.M)
    assert len(blocks) == 2
    for text in blocks:
        exec(compile(text, PAGE.name, "exec"), here)
    volume, about = here["volume"], here["about"]
    np.testing.assert_array_equal(here["labels"], volume.values)
    assert (tuple(about["spacing_mm"]), tuple(about["origin_mm"])) == (
        volume.spacing_mm,
        volume.origin_mm,
    )
    # The softest candidate is pressed thinnest along y.
    stiffness = study.candidates()["E_fat_kpa"]
    thin = [study.volume(k).values.any(axis=(0, 2)).sum() for k in range(4)]
    assert np.argmin(thin) == np.argmin(stiffness)
    with pytest.raises(palpate.InputError, match=r"no evaluation of candidate 7; `candidates`"):
        study.volume(7)


def test_names_of_volumes_are_checked(tmp_path: Path) -> None:
    study = palpate.Study.from_dict(STUDY | {"keep": "best"}, tmp_path / "a")
    with pytest.raises(palpate.InputError, match="worst: expected reference, target, best or"):
        study.volume("worst")  # type: ignore[arg-type]
