"""Keys of a structured case, which include units; unknown ones are refused."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.common_keys import validated
from palpate.workers.organs.breast.scanned_case import ScannedCase
from palpate.workers.organs.breast.scanned_case_files import read_case_file, understood
from palpate.workers.organs.breast.scanned_case_keys import ALONG_X, CaseFile, CaseWall

CASE: dict[str, Any] = {
    "organ": "breast",
    "name": "mine",
    "model": {"law": "fibre-neo-hookean", "fibres": "tension-only"},
    "wall": {"z_mm": 0, "wall_hold_x_kpa_per_mm": 0.2, "wall_hold_y_kpa_per_mm": 0.001},
    "plates": {"lower_mm": -50, "upper_mm": 50},
    "constants": {
        "E_fat_kpa": [7, 14],
        "E_glandular_kpa": [20, 50],
        "eta_fat_kpa": 80,
        "eta_glandular_kpa": "eta_fat_kpa",
        "nu": 0.49,
    },
    "noise": {"sd_mm": 0.3, "correlation_mm": 4},
    "scans": {
        "reference": "rest.nrrd",
        "loads": [
            {"volume": "a.nrrd", "force_n": 40},
            {"volume": "b.nrrd", "plate_distance_mm": 60, "axis": "x"},
        ],
    },
}


def changed(path: str, value: Any) -> dict[str, Any]:
    """The case with one key changed, added, or taken out (None)."""
    data = deepcopy(CASE)
    *above, key = path.split(".")
    place: Any = data
    for name in above:
        place = place[int(name)] if name.isdecimal() else place[name]
    if value is None:
        del place[key]
    else:
        place[int(key) if key.isdecimal() else key] = value
    return data


def test_values_are_held_and_intervals_are_searched() -> None:
    case = validated(CaseFile, CASE)
    assert case.free == {"E_fat": (7.0, 14.0), "E_gl": (20.0, 50.0)}
    assert case.held == {"eta": 80.0}
    assert case.scans.loads[1].axis == ALONG_X
    assert [load.name for load in case.scans.loads] == ["40 N", "60 mm along x"]
    assert CaseFile.model_validate(case.model_dump(mode="json")) == case


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("organ", "brest", "organ"),
        ("wal", {}, "did you mean 'wall'"),
        ("gravity", "prone", "unknown key 'gravity'"),
        ("model.fibers", "literal", "did you mean 'fibres'"),
        ("model.law", "odgen", "did you mean 'ogden'"),
        ("constants.nu", 0.5, "less than 0.5"),
        ("constants.nu", [0.4, 0.45], "effect compressibility"),
        ("constants.E_fat_kpa", "eta_fat_kpa", "only eta_glandular_kpa"),
        ("model.fibre_direction", [0, 0, 0], "must not be zero"),
        ("wall.wall_hold_x", 0.2, "did you mean 'wall_hold_x_kpa_per_mm'"),
        ("wall.wall_hold_x_kpa_per_mm", -1, "greater than or equal to 0"),
        ("wall.held", True, "no springs"),
        ("plates.upper_mm", -60, "less than upper_mm"),
        ("constants.E_fat", 10, "did you mean 'E_fat_kpa'"),
        ("constants.E_fat_kpa", [14, 7], "lower < upper"),
        ("constants.E_fat_kpa", "10 kPa", "10 kPa"),
        ("constants.E_fat_kpa", [0, 7], "a positive value"),
        ("constants.E_fat_kpa", True, "a positive value"),
        (
            "constants",
            {"E_fat_kpa": 1, "E_glandular_kpa": 2, "eta_fat_kpa": 3, "eta_glandular_kpa": 3},
            "all are held",
        ),
        ("noise.sd", 1, "did you mean 'sd_mm'"),
        ("noise.in_scans", "reference", "'all' or 'loaded'"),
        ("scans.pose_sd_mm", -0.1, "greater than or equal to 0"),
        ("scans.loads", [], "at least 1"),
        ("scans.labels", {"0": "air", "1": "skin"}, "'air', 'fat' or 'glandular'"),
        ("scans.loads.0.force_n", -40, "greater than 0"),
        ("scans.loads.0.plate_distance_mm", 60, "exactly one of"),
        ("scans.loads.0.force_kn", 60, "did you mean 'force_n'"),
        ("scans.loads.1.axis", "z", "expected x, y"),
        ("scans.loads.1.axis", [0, 0, 1], "perpendicular to z"),
        (
            "scans.loads.1",
            {"volume": "b", "plate_distance_mm": 60, "lower_mm": 0, "upper_mm": 9},
            "apart",
        ),
    ],
)
def test_rejects_invalid_values(path: str, value: Any, message: str) -> None:
    with pytest.raises(InputError, match=r"case\.yaml does not make sense") as refused:
        validated(CaseFile, changed(path, value), "case.yaml")
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("name", "name: this key is missing"),
        ("constants.eta_fat_kpa", "no value for eta_fat_kpa"),
        ("noise.sd_mm", "noise.sd_mm: this key is missing"),
        ("scans.reference", "scans.reference: this key is missing"),
        ("scans.loads.0.force_n", "exactly one of force_n and plate_distance_mm, found neither"),
    ],
)
def test_reports_missing_required_keys(path: str, message: str) -> None:
    with pytest.raises(InputError, match=r"case\.yaml is not finished") as refused:
        validated(CaseFile, changed(path, None), "case.yaml")
    assert message in str(refused.value)


def test_each_tissue_may_have_fibres_of_its_own() -> None:
    each = {"eta_fat_kpa": 90, "eta_glandular_kpa": [100, 200]}
    case = validated(
        CaseFile, changed("constants", {"E_fat_kpa": 10, "E_glandular_kpa": 30} | each)
    )
    assert case.held == {"E_fat": 10.0, "E_gl": 30.0, "eta_fat": 90.0}
    assert case.free == {"eta_glandular": (100.0, 200.0)}


@pytest.mark.parametrize("path", ["wall", "plates", "noise"])
def test_values_available_from_the_scans_are_optional(path: str) -> None:
    case = validated(CaseFile, changed(path, None))
    assert getattr(case, path) in (None, CaseWall())


def test_a_law_without_fibres_rejects_their_keys() -> None:
    data = changed("model", {"law": "neo-hookean", "fibres": "literal"})
    with pytest.raises(InputError, match=r"fibres are for|are for fibres"):
        validated(CaseFile, data)


class At:
    """A frame, as far as a load needs it."""

    centre_mm = (1.0, 2.0, 3.0)


def test_the_example_of_a_breast_in_ct_is_read() -> None:
    file = read_case_file(Path(__file__).parents[4] / "examples" / "breast-ct" / "case.yaml")
    body = Volume(np.full((4, 4, 4), Tissue.FAT, np.uint8), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    built = ScannedCase(file, body, None, []).problem(0, At())({"E_gl": 0.03})
    assert built.constants[Tissue.FAT].young_mpa == 0.010
    assert (built.isochoric_fibre, built.literal_fibre) == (False, True)
    assert built.wall.spring_mpa_per_mm == (1e-5, 1e-5, 0.0)
    assert file.scans.labels == {0: "air", 1: "fat", 2: "glandular", 3: "fat"}
    assert file.scans.loads[0].plate_distance_mm == 65.07


def test_settings_are_described_in_words() -> None:
    data = changed("model.fibre_invariant", "isochoric")
    data["scans"]["loads"][0] |= {"force_n": 39.931, "lower_mm": -50, "upper_mm": 50}
    rows = dict(understood(validated(CaseFile, data)))
    assert "tension only" in rows["law"] and "isochoric" in rows["law"]
    assert "0.2 kPa/mm along x and 0.001 kPa/mm along y" in rows["chest wall"]
    assert rows["E_fat"] == "searched from 7 to 14 kPa"
    assert rows["scan 1"] == "a.nrrd: 39.931 N, plates start at lower -50 mm and upper 50 mm"
