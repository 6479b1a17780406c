"""What a case says in prose is understood as it always was, or refused with the phrase."""

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
import yaml

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.blind.random_case import draw
from palpate.workers.organs.breast.case.files import read_case_file
from palpate.workers.organs.breast.case.prose import from_prose
from palpate.workers.organs.breast.case.scanned_case import ScannedCase
from palpate.workers.organs.breast.case.spec import CaseFile
from palpate.workers.organs.breast.case.table import understood
from palpate.workers.organs.breast.case.yaml import case_yaml
from tests.workers.organs.breast.prose_search import noise, problem

ROOT = Path(__file__).parents[4]
SHARED = ROOT.parent / "shared" / "reference"
FILES = sorted(SHARED.glob("gap-open*/*/case.json"))
VALUES = {"E_fat": 0.011, "E_gl": 0.03, "eta": 0.08}
CENTRE = (1.0, 2.0, 3.0)


class At:
    """A frame, as far as a load needs it."""

    centre_mm = CENTRE


def said() -> dict[str, Any]:
    """A case as the reference cases of FEBio state it."""
    return {
        "id": "mine",
        "units": "mm, N, kPa",
        "axes": {
            "x": "170 mm axis (cranio-caudal)",
            "y": "compression axis; lower plate at y=-50 (fixed), upper plate at y=+50 (moves "
            "along -y)",
            "z": "chest wall z=0 -> nipple z=50",
        },
        "labels": {
            "0": "background",
            "1": "fat (skin and ligaments counted as fat)",
            "2": "glandular",
        },
        "nominal": {
            "energy": "W = mu/2 (I1bar-3) + 1/d (J-1)^2 + eta/2 (I4bar-1)^2, fibre in tension "
            "only; mu=E/(2(1+nu)), d=2/K, K=E/(3(1-2nu))",
            "nu": 0.49,
            "fibre_direction": [0, 0, 1],
            "eta": "one value for fat and glandular",
            "unknown_constants": ["E_fat", "E_gl", "eta"],
            "plausible_kPa": {"E_fat": [7, 14], "E_gl": [20, 50], "eta": [50, 120]},
            "chest_wall": "all nodes at z=0: uz=0; tangential distributed springs kx=0.2 kPa/mm "
            "(force per area per mm) and ky=0.001 kPa/mm, otherwise free",
            "plates": "two rigid flat plates normal to y, frictionless, unilateral; lower fixed "
            "at y=-50, upper only translates along y, force controlled",
            "gravity": "none (reference and deformed scan in the same posture, reference taken "
            "as stress free)",
            "skin": "none",
        },
        "segmentation": "each scan segmented independently; signed-distance noise sd 0.3 mm, "
        "correlation length about 4 mm, on body outline and glandular boundary, reference scan "
        "included",
        "scans": {
            "reference": "reference.nrrd",
            "deformed": [
                {"file": "deformed_40N.nrrd", "plate_force_N": 39.931},
                {"file": "deformed_80N.nrrd", "plate_force_N": 80.616},
            ],
        },
    }


def changed(path: str, value: Any) -> dict[str, Any]:
    """The same with one key changed, added, or taken out (None)."""
    data = deepcopy(said())
    *above, key = path.split(".")
    place = data
    for name in above:
        place = place[name]
    if value is None:
        del place[key]
    else:
        place[key] = value
    return data


def in_energy(old: str, new: str) -> dict[str, Any]:
    energy = said()["nominal"]["energy"]
    assert old in energy
    return changed("nominal.energy", energy.replace(old, new))


def scanned(file: CaseFile, body: Volume) -> ScannedCase:
    return ScannedCase(file, body, None, [])


@pytest.fixture
def body() -> Volume:
    import numpy as np

    values = np.full((4, 4, 4), Tissue.FAT, np.uint8)
    return Volume(values, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


def assert_same_meaning(file: CaseFile, data: dict[str, Any], body: Volume) -> None:
    case = scanned(file, body)
    for number, load in enumerate(data["scans"]["deformed"]):
        expected = problem(data, load, VALUES, CENTRE)
        assert case.problem(number, At())(VALUES) == expected
    sd, length, of_reference = noise(data)
    assert (case.noise.sd_mm, case.noise.correlation_mm) == (sd, length)
    assert case.noise.reference_sd_mm == (sd if of_reference else 0.0)
    nominal = data["nominal"]
    assert [f.name for f in case.free] == nominal["unknown_constants"]
    for free in case.free:
        low, high = (v / 1000.0 for v in nominal["plausible_kPa"][free.name])
        assert (free.lower, free.upper) == (low, high)


@pytest.mark.skipif(not FILES, reason="the cases of FEBio are not beside the project")
def test_the_cases_of_febio_keep_their_meaning(body: Volume) -> None:
    assert len(FILES) >= 28
    for path in FILES:
        assert_same_meaning(read_case_file(path), json.loads(path.read_text()), body)


def test_a_case_of_the_example_keeps_its_meaning(body: Volume) -> None:
    assert_same_meaning(from_prose(said(), "case.json"), said(), body)


def test_the_breast_in_ct_keeps_its_meaning(body: Volume) -> None:
    file = read_case_file(ROOT / "examples" / "breast-ct" / "case.json")
    built = scanned(file, body).problem(0, At())({"E_gl": 0.03})
    assert built.constants[Tissue.FAT].young_mpa == 0.010
    assert (built.isochoric_fibre, built.literal_fibre) == (False, True)
    assert built.wall.spring_mpa_per_mm == (1e-5, 1e-5, 0.0)
    assert file.scans.labels == {0: "air", 1: "fat", 2: "glandular", 3: "fat"}
    assert file.scans.loads[0].plate_distance_mm == 65.07


@pytest.mark.parametrize(
    ("path", "value", "phrase"),
    [
        ("nominal.energy", "Ogden N=3", "Ogden N=3"),
        ("nominal.chest_wall", "all nodes at z=0: uz=0, kx=0.2 MPa/mm", "kx=0.2 MPa/mm"),
        ("nominal.chest_wall", "all nodes at z=0: uz=0, kx=stiff", "kx=stiff"),
        ("nominal.chest_wall", "all nodes at z=0: uz=0, glued to the ribs", "glued to the ribs"),
        ("nominal.plates", "lower at y=-50, upper at y=50, friction 0.3", "friction 0.3"),
        ("nominal.gravity", "prone", "prone"),
        ("nominal.skin", "yes", "yes"),
        ("nominal.eta", "one for each tissue", "one for each tissue"),
        ("nominal.held_kpa", {"E_fat": 10}, "held_kpa"),
        ("nominal.fiber_direction", [0, 1, 0], "fiber_direction"),
        ("units", "m, N, Pa", "m"),
        ("axes.z", "nipple z=0 -> chest wall z=50", "nipple z=0"),
        ("axes.z", "chest wall z=50 -> nipple z=0", "larger z"),
        ("axes.z", "chest wall z=3 -> nipple z=50", "contradicts itself"),
        ("axes.w", "time", "'w'"),
        ("labels.2", "tumour", "tumour"),
        ("labels.1", "fat (tumour counted as fat)", "(tumour counted as fat)"),
        ("segmentation", "noise sd 0.3 mm, correlation length 4 mm, twice as much", "twice as"),
        ("segmentation", "noise sd 0.3 cm, correlation length 4 mm", "sd 0.3 cm"),
        ("segmentation", "noise sd 0.3 mm, sd 0.4 mm, correlation length 4 mm", "sd 0.4 mm"),
        ("segmentation", "noise sd 0.3 mm", "correlation length"),
        ("nominal.unknown_constants", ["E_fat", "E_gland", "eta"], "E_gland"),
        ("nominal.unknown_constants", ["E_fat", "E_gl"], "no value of eta"),
        ("nominal.plausible_kPa", {"E_fat": [7, 14], "E_gl": [20, 50]}, "lacks an interval"),
        ("nominal.nu", 0.5, "less than 0.5"),
        ("nominal.chest_wall", "springs kx=0.2 kPa/mm", None),
        ("weather", "fair", "weather"),
        ("scans.reference", None, "scans.reference"),
    ],
)
def test_what_is_not_known_is_refused_and_named(path: str, value: Any, phrase: str | None) -> None:
    data = changed(path, value)
    if phrase is None:
        data = {**data, "axes": {}}
        phrase = "does not say chest_wall"
    with pytest.raises(InputError) as refused:
        from_prose(data, "case.json")
    assert "case.json" in str(refused.value)
    assert phrase in str(refused.value)


def test_terms_added_to_the_energy_are_named() -> None:
    data = in_energy("(I4bar-1)^2,", "(I4bar-1)^2 + zeta (I8-1)^2,")
    with pytest.raises(InputError, match="zeta"):
        from_prose(data, "case.json")


def test_spellings_of_one_meaning_mean_the_same() -> None:
    first = from_prose(said(), "case.json")
    assert first.model.fibres == "tension-only"
    for old, new in (("fibre in tension only", "tension-only"), (" + 1/d (J-1)^2", "+1/d(J-1)^2")):
        assert from_prose(in_energy(old, new), "case.json") == first
    walls = said()["nominal"]["chest_wall"].replace("kx=0.2 kPa/mm", "kx = 0.2 kPa / mm")
    assert from_prose(changed("nominal.chest_wall", walls), "case.json") == first


def test_unsaid_fibres_act_as_the_formula_reads() -> None:
    assert (
        from_prose(in_energy(", fibre in tension only", ""), "case.json").model.fibres == "literal"
    )


def test_a_case_in_prose_becomes_the_same_one_in_yaml() -> None:
    for data in (said(), changed("labels.3", "skin (counted as fat)")):
        file = from_prose(data, "case.json")
        text = case_yaml(file)
        assert CaseFile.model_validate(yaml.safe_load(text)) == file


def test_what_was_understood_is_told() -> None:
    rows = dict(understood(from_prose(said(), "case.json")))
    assert "tension only" in rows["law"] and "isochoric" in rows["law"]
    assert "0.2 kPa/mm along x and 0.001 kPa/mm along y" in rows["chest wall"]
    assert rows["E_fat"] == "searched from 7 to 14 kPa"
    assert (
        rows["scan 1"]
        == "deformed_40N.nrrd: 39.931 N, plates start at lower -50 mm and upper 50 mm"
    )


def test_the_blind_generator_writes_what_is_understood(tmp_path: Path) -> None:
    from palpate.workers.blind.write_case import _case

    truth = draw(3, "control")
    data = json.loads(json.dumps(_case(truth, "name")))
    assert from_prose(data, "case.json").name == "name"
