"""Valid and invalid keys of a cornea in a study file."""

from pathlib import Path
from typing import Any

import pytest

from palpate.service.study.study_keys import StudySpec, parse_spec, read_spec
from palpate.storage.errors import InputError
from palpate.workers.common_keys import validated
from palpate.workers.organs.cornea.cornea_keys import CorneaCase
from palpate.workers.organs.cornea.corneal_model import MPA_PER_MMHG

EXAMPLES = Path(__file__).parents[4] / "examples"
X1 = {"mu1_pa": 11000, "alpha1": 30, "mu2_pa": 35000, "alpha2": 80}


def case(**parts: Any) -> CorneaCase:
    return validated(CorneaCase, {"organ": "cornea", **parts}, "The case")


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("cornea*.yaml")), ids=lambda p: p.stem)
def test_examples_are_studies_of_a_cornea(path: Path) -> None:
    assert read_spec(path).case.organ == "cornea"


def test_pressures_are_converted_to_megapascals() -> None:
    literal = case(load={"iop_mmhg": 12, "jet": {"pressure_mmhg": 15, "centre_mm": 0.2}}).complete()
    assert literal["iop"] == pytest.approx(12 * MPA_PER_MMHG)
    assert literal["jet_pressure"] == pytest.approx(15 * MPA_PER_MMHG)
    assert literal["jet_centre"] == 0.2
    assert case().complete()["jet_pressure"] == 0.015
    assert case(constants={"iop_mmhg": 20}).complete()["iop"] == pytest.approx(20 * MPA_PER_MMHG)
    assert case(constants=X1).complete()["mu2"] == pytest.approx(0.035)


def test_swapped_terms_describe_the_same_cornea() -> None:
    swapped = {"mu1_pa": 35000, "alpha1": 80, "mu2_pa": 11000, "alpha2": 30}
    assert case(constants=swapped).complete() == case(constants=X1).complete()
    assert case().canonical(swapped) == X1
    by_mu = case(model={"order_terms_by": "mu"})
    assert by_mu.canonical({"mu1_pa": 3, "alpha1": 1, "mu2_pa": 2, "alpha2": 4}) == {
        "mu1_pa": 2,
        "alpha1": 4,
        "mu2_pa": 3,
        "alpha2": 1,
    }
    literal = case(model={"order_terms_by": "nothing"})
    assert literal.canonical(swapped) == swapped


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"load": {"iop_mmhg": -1}}, "iop_mmhg: Input should be greater than or equal to 0"),
        ({"load": {"jet": {}}}, "exactly one of pressure_kpa and pressure_mmhg, found neither"),
        ({"reference": {}}, "exactly one of section and frame, found neither"),
        ({"constants": {"mu1_kpa": 3}}, "did you mean 'mu1_pa'"),
        ({"constants": {"alpha1": 0}}, "alpha1 must be above 0"),
        ({"model": {"kind": "shell"}}, "model.kind"),
        (
            {
                "load": {
                    "jet": {"pressure_kpa": 15, "profile": {"r_mm": [1, 0.5], "fraction": [1, 0]}}
                }
            },
            "ascending distances",
        ),
    ],
)
def test_rejects_invalid_keys(parts: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        case(**parts)


def test_reads_a_study_file_of_a_cornea(tmp_path: Path) -> None:
    (tmp_path / "frame.png").touch()
    text = """
name: pair
case:
  organ: cornea
  reference: {frame: {file: frame.png, pixel_mm: [0.0156, 0.0165]}}
  load: {jet: {pressure_kpa: 15}}
target: {frame: {file: frame.png, pixel_mm: [0.0156, 0.0165]}}
search: {parameters: {mu1_pa: [1, 40000], iop_mmhg: [8, 20]}}
"""
    study: Any = parse_spec(text, "pair.yaml", tmp_path)
    assert isinstance(study, StudySpec)
    assert study.case.reference.frame.file == str(tmp_path / "frame.png")
    assert study.target.frame.file == str(tmp_path / "frame.png")
    with pytest.raises(InputError, match="window_mm: give"):
        parse_spec(text + "score: {window_mm: [3, 1]}\n", "pair.yaml", tmp_path)
    with pytest.raises(InputError, match="did you mean 'mu1_pa'"):
        parse_spec(text.replace("mu1_pa", "mu1"), "pair.yaml", tmp_path)
