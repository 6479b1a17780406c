"""Old names of keys are read as the current ones, with a note; records keep their names."""

import logging
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
import yaml

from palpate.storage.errors import InputError
from palpate.storage.json_digests import digest
from palpate.workers.common_keys import validated
from palpate.workers.file_keys import OLD_DIAGNOSIS_KEYS
from palpate.workers.organs.breast.scanned_case_files import read_case_file
from palpate.workers.organs.breast.scanned_case_keys import CaseFile

OLD: dict[str, Any] = {
    "name": "mine",
    "model": {"law": "fibre-neo-hookean", "nu": 0.48, "fibre_invariant": "isochoric"},
    "wall": {"z_mm": 0, "kx_kpa_per_mm": 0.2, "ky_kpa_per_mm": 0.1},
    "constants": {"E_fat_kpa": [7, 14], "E_glandular_kpa": 30, "eta_kpa": [50, 120]},
    "scans": {"reference": "rest.nrrd", "loads": [{"file": "a.nrrd", "force_n": 40}]},
}
NEW: dict[str, Any] = {
    "name": "mine",
    "model": {"law": "fibre-neo-hookean", "fibre_invariant": "isochoric"},
    "wall": {"z_mm": 0, "wall_hold_x_kpa_per_mm": 0.2, "wall_hold_y_kpa_per_mm": 0.1},
    "constants": {
        "E_fat_kpa": [7, 14],
        "E_glandular_kpa": 30,
        "eta_fat_kpa": [50, 120],
        "eta_glandular_kpa": "eta_fat_kpa",
        "nu": 0.48,
    },
    "scans": {"reference": "rest.nrrd", "loads": [{"volume": "a.nrrd", "force_n": 40}]},
}


def written(folder: Path, keys: dict[str, Any]) -> Path:
    path = folder / "case.yaml"
    path.write_text(yaml.safe_dump(keys))
    return path


def test_each_old_name_is_read_with_one_note(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path, OLD)
    with caplog.at_level(logging.WARNING, "palpate"):
        old = read_case_file(path)
        read_case_file(path)
    assert old == validated(CaseFile, NEW)
    assert len(caplog.messages) == len(OLD_DIAGNOSIS_KEYS)
    for name, new in OLD_DIAGNOSIS_KEYS.items():
        assert any(f"{name} is now called {new}" in text for text in caplog.messages)


def test_current_names_need_no_note(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = read_case_file(written(tmp_path, NEW))
    assert caplog.messages == []
    assert (file.nu, file.wall.wall_hold_y_kpa_per_mm) == (0.48, 0.1)
    assert file.free == {"E_fat": (7.0, 14.0), "eta": (50.0, 120.0)}


def test_a_record_has_the_names_and_the_digest_of_older_versions() -> None:
    record = validated(CaseFile, NEW).record
    assert record["model"]["nu"] == 0.48
    assert record["wall"] == {
        "z_mm": 0.0, "held": False, "kx_kpa_per_mm": 0.2, "ky_kpa_per_mm": 0.1
    }  # fmt: skip
    assert record["constants"] == {
        "E_fat_kpa": [7.0, 14.0], "E_glandular_kpa": 30.0, "eta_kpa": [50.0, 120.0]
    }  # fmt: skip
    assert record["scans"]["loads"][0]["file"] == "a.nrrd"
    assert digest(record) == "b1fd43bbfbde392b"  # as written before the names changed
    assert validated(CaseFile, record) == validated(CaseFile, NEW)


def test_a_record_has_poissons_ratio_even_if_the_file_does_not() -> None:
    keys = deepcopy(NEW)
    del keys["constants"]["nu"]
    assert validated(CaseFile, keys).record["model"]["nu"] == 0.49


def test_both_names_of_one_key_are_refused() -> None:
    keys = deepcopy(NEW)
    keys["wall"]["kx_kpa_per_mm"] = 0.3
    with pytest.raises(InputError, match="unknown key 'kx_kpa_per_mm'"):
        validated(CaseFile, keys)


def test_fibres_of_each_tissue_keep_their_names_in_the_record() -> None:
    keys = deepcopy(NEW)
    keys["constants"] |= {"eta_fat_kpa": 80, "eta_glandular_kpa": [50, 120]}
    constants = validated(CaseFile, keys).record["constants"]
    assert constants["eta_fat_kpa"] == 80.0
    assert "eta_kpa" not in constants
