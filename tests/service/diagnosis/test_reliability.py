"""The counts that stand beside a gain."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from palpate.service.diagnosis import reliability as counts
from palpate.service.diagnosis.diagnosis_words import STRENGTHS
from palpate.service.diagnosis.reliability import FEWEST, bands, reliability


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(counts, "FILE", tmp_path / "reliability.json")
    bands.cache_clear()
    yield tmp_path / "reliability.json"
    bands.cache_clear()


def test_a_gain_has_the_counts_of_its_band(file: Path) -> None:
    rows = [("weak", FEWEST, 8), ("clear", FEWEST - 1, 9), ("strong", 30, 29)]
    names = ("word", "named", "right")
    file.write_text(json.dumps([dict(zip(names, row, strict=True)) for row in rows]))
    assert reliability(12.0) == (
        f"Of {FEWEST} bodies of another solver with weak evidence, the cause named first was right "
        "in 8."
    )
    assert reliability(30.0) == ""
    assert "strong evidence, the cause named first was right in 29." in reliability(500.0)
    assert reliability(2.0) == ""


def test_the_stored_counts_are_those_of_all_words() -> None:
    bands.cache_clear()
    assert [one.word for one in bands()] == [*(word for word, _ in STRENGTHS), "strong"]
    assert all(0 <= one.right <= one.named for one in bands())
