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


def store(file: Path, *rows: tuple[str, int, int, int]) -> None:
    names = ("word", "named", "right", "unlisted")
    file.write_text(json.dumps([dict(zip(names, row, strict=True)) for row in rows]))


def test_a_gain_has_the_counts_of_its_band(file: Path) -> None:
    few = FEWEST - 1
    store(file, ("weak", FEWEST, 8, 0), ("clear", few, few, 0), ("strong", 30, 26, 3))
    assert reliability(12.0) == (
        f"Of {FEWEST} bodies of another solver with weak evidence, the cause named first was right "
        "in 8."
    )
    assert reliability(30.0) == ""
    assert reliability(500.0).endswith(
        "strong evidence, the cause named first was right in 26; the cause of 3 others is not in "
        "the catalogue."
    )
    assert reliability(2.0) == ""


def test_bands_with_few_bodies_are_counted_together(file: Path) -> None:
    store(file, ("weak", 4, 4, 0), ("clear", 8, 5, 2), ("strong", 30, 26, 3))
    assert reliability(12.0) == reliability(30.0)
    assert reliability(30.0).startswith(
        "Of 12 bodies of another solver with weak or clear evidence, the cause named first was "
        "right in 9; the cause of 2"
    )


def test_the_stored_counts_are_those_of_all_words() -> None:
    bands.cache_clear()
    assert [one.word for one in bands()] == [*(word for word, _ in STRENGTHS), "strong"]
    assert all(0 <= one.right <= one.right + one.unlisted <= one.named for one in bands())
