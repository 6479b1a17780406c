"""Tables of candidates are parsed or rejected before any work starts."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palpate.service.simulation.candidate_tables import candidates_of, read_table
from palpate.storage.errors import InputError
from tests.recovery.stand_ins import small_spec

ROWS = [{"E_fat_kpa": 8.0, "nu": 0.48}, {"E_fat_kpa": 9.5, "nu": 0.49}]
COLUMNS = {"E_fat_kpa": np.array([8.0, 9.5]), "nu": [0.48, 0.49]}


class Frame:
    """A minimal stand-in for a pandas table."""

    columns = tuple(COLUMNS)

    def __getitem__(self, name: str) -> Any:
        return COLUMNS[name]


@pytest.mark.parametrize(
    "table",
    [
        ROWS,
        COLUMNS,
        Frame(),
        np.array([(8.0, 0.48), (9.5, 0.49)], [("E_fat_kpa", "f8"), ("nu", "f8")]),
    ],
)
def test_table_types_give_equal_candidates(table: Any) -> None:
    assert candidates_of(small_spec(), table) == ROWS


def test_csv_round_trip_is_exact(tmp_path: Path) -> None:
    values = np.random.default_rng(1).uniform(5, 20, 50)
    file = tmp_path / "table.csv"
    file.write_text("\ufeffE_fat_kpa, nu\n" + "".join(f"{v!r},0.49\n" for v in values.tolist()))
    found = candidates_of(small_spec(), read_table(file))
    assert [row["E_fat_kpa"] for row in found] == values.tolist()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"E_fatt_kpa": [8]}, "did you mean 'E_fat_kpa'"),
        ({"E_skin_kpa": [800]}, "has no skin"),
        ({"E_fat_kpa": [8, -1]}, "Row 2: E_fat_kpa must be above 0 kPa, found -1"),
        ({"nu": [0.48, 0.5]}, "Row 2: nu must be"),
        ({"E_fat_kpa": [8, np.nan]}, "Row 2: E_fat_kpa"),
        ({"E_fat_kpa": ["8", "soft"]}, "Row 2: E_fat_kpa must be a number, found 'soft'"),
        ({"E_fat_kpa": [8, 9], "nu": [0.48]}, "E_fat_kpa 2, nu 1"),
        ({"E_fat_kpa": []}, "no rows"),
        ([], "no rows"),
        ("E_fat_kpa", "found str"),
        (SimpleNamespace(), "found SimpleNamespace"),
    ],
)
def test_rejects_invalid_tables(table: Any, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        candidates_of(small_spec(), table)


def test_rejects_files_without_table(tmp_path: Path) -> None:
    for text, message in (("", "is empty"), ("E_fat_kpa,nu\n8\n", "row 1: expected 2 values")):
        (tmp_path / "table.csv").write_text(text)
        with pytest.raises(InputError, match=message):
            read_table(tmp_path / "table.csv")
    with pytest.raises(InputError, match="no table"):
        read_table(tmp_path / "nowhere.csv")
