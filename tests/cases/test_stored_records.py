"""Detection of flipped digits in stored records."""

import random
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.study_folder import StudyLog
from palpate.storage.backends.store_paths import StudyLayout, place_of
from palpate.storage.errors import JournalError, NewerSchemaError, StoreError
from palpate.storage.journal import PREVIOUS_KEY
from palpate.storage.json_digests import CHECKSUM_KEY, dumps, loads, seal, unseal
from palpate.storage.store import Store, load_evaluation, open_store
from palpate.storage.stored_arrays import load_arrays, save_arrays
from palpate.storage.upkeep import check_store
from tests.recovery.stand_ins import Inline, run

FLIPS = 100


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stored") / "runs" / "demo"
    run(folder, Inline())
    return folder


def flips(text: str, seed: int, count: int = FLIPS) -> list[str]:
    """Return copies of a text, each with one digit changed."""
    random_ = random.Random(seed)
    places = [match.start() for match in re.finditer(r"\d", text)]
    chosen = random_.sample(places, min(count, len(places)))
    return [
        text[:at] + str((int(text[at]) + random_.randint(1, 9)) % 10) + text[at + 1 :]
        for at in chosen
    ]


def test_detects_a_flipped_digit_in_the_journal(folder: Path, tmp_path: Path) -> None:
    text = StudyLayout(folder).journal.read_text()
    found = 0
    for flipped in flips(text, seed=1):
        damaged = tmp_path / "journal.jsonl"
        damaged.write_text(flipped)
        with pytest.raises((JournalError, NewerSchemaError)):
            StudyLog.read(damaged)
        found += 1
    assert found == FLIPS


def test_detects_a_flipped_digit_in_each_field_of_a_line(folder: Path) -> None:
    line = StudyLayout(folder).journal.read_text().splitlines()[3]
    record = loads(line)
    assert CHECKSUM_KEY in record
    for name, value in record.items():
        written = f'"{name}":{dumps(value)}'
        for flipped in flips(written, seed=2, count=5):
            with pytest.raises(ValueError, match="checksum is wrong"):
                unseal(line.replace(written, flipped))


def test_detects_a_flipped_digit_in_an_evaluation(folder: Path) -> None:
    store = open_store(folder.parent / "store")
    evaluation = next(Path(str(store.layout.evaluations)).glob("*.json"))
    text = evaluation.read_text()
    found = 0
    for flipped in flips(text, seed=3):
        evaluation.write_text(flipped)
        with pytest.raises(StoreError):
            load_evaluation(store, evaluation.stem)
        found += "checksum is wrong" in damage_of(store, evaluation)
    evaluation.write_text(text)
    assert found == min(FLIPS, len(re.findall(r"\d", text)))
    assert "checksum" not in damage_of(store, evaluation)


def damage_of(store: Store, path: Path) -> str:
    """Return the damages of a file reported by `palpate store check`."""
    return " ".join(d.reason for d in check_store(store).damages if d.path == path)


def test_detects_a_flipped_digit_in_the_description_of_arrays(tmp_path: Path) -> None:
    path = place_of(tmp_path / "group.zarr")
    save_arrays(path, {"values": np.arange(3.0)}, {"spacing_mm": [0.5, 0.25, 1.0], "n": 12})
    description = tmp_path / "group.zarr" / "zarr.json"
    text = description.read_text()
    start, end = text.index('"meta"'), text.index('"crc32"')
    for flipped in flips(text[start:end], seed=4):
        description.write_text(text[:start] + flipped + text[end:])
        if _same_meta(flipped, text[start:end]):
            continue  # 1.0 and 1.00 are one number
        with pytest.raises(StoreError, match="checksum of its description is wrong"):
            load_arrays(path)


def _same_meta(one: str, other: str) -> bool:
    numbers = [[float(n) for n in re.findall(r"[\d.]+", text)] for text in (one, other)]
    return numbers[0] == numbers[1]


def test_journal_without_checksums_is_readable_and_unverified(folder: Path, tmp_path: Path) -> None:
    old = tmp_path / "runs" / "demo"
    old.mkdir(parents=True)
    lines = [loads(line) for line in StudyLayout(folder).journal.read_text().splitlines()]
    kept = [_as_before(line) for line in lines if line["kind"] != "proposal"]
    StudyLayout(old).journal.write_text("".join(dumps(line) + "\n" for line in kept))
    before, after = study_json(study_results(folder)), study_json(study_results(old))
    assert before["unverified_records"] == 0
    assert after["unverified_records"] == after["unchained_records"] == len(kept)
    assert before["unchained_records"] == 0
    for key in ("estimates", "best", "evaluations", "per_label", "stopped"):
        assert after[key] == before[key]


def _as_before(line: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in line.items() if key not in (CHECKSUM_KEY, PREVIOUS_KEY)}


def test_checksum_covers_the_text_of_numbers() -> None:
    """0.1 and 0.10000000000000001 are one float, but not one text."""
    sealed = seal(dumps({"score": 0.1}))
    assert loads(sealed.replace("0.1", "0.10000000000000001")) == loads(sealed)
    with pytest.raises(ValueError, match="checksum is wrong"):
        unseal(sealed.replace("0.1", "0.10000000000000001"))
