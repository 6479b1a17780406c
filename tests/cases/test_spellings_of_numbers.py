"""Numbers in every kind of file are read as YAML 1.2 says, or refused with their line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from palpate.service.commands.named_study import find_study
from palpate.service.server.jobs.untrusted_inputs import Limits, Uploads, study_from
from palpate.service.study.study_keys import parse_spec
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.workers.common_keys import validated
from palpate.workers.input_files import dump_yaml, parse_json, parse_yaml
from palpate.workers.organs.breast.scanned_case_files import read_case_file
from palpate.workers.organs.breast.scanned_case_keys import CaseFile
from palpate.workers.organs.specimen.specimen_keys import read_spec as read_experiment
from tests.service.commands.bad_inputs import STUDY
from tests.workers.organs.breast.test_case_spec import CASE
from tests.workers.organs.specimen.experiments import described

NUMBER = "SPELLING"
BREAST = STUDY.replace("force_n: 60", f"force_n: {NUMBER}")
CORNEA = f"""
name: eye
case:
  organ: cornea
  reference: {{section: {{}}}}
  load: {{iop_mmhg: 15, jet: {{pressure_kpa: {NUMBER}, diameter_mm: 3}}}}
target: {{constants: {{mu1_pa: 9000}}}}
search: {{parameters: {{mu1_pa: [5000, 20000]}}, population: 12}}
"""


def _breast(text: str, folder: Path) -> Any:
    return parse_spec(text, "The study", folder).case.load.force_n


def _cornea(text: str, folder: Path) -> Any:
    return parse_spec(text, "The study", folder).case.load.jet.pressure_kpa


def _experiment(text: str, folder: Path) -> Any:
    (folder / "experiment.yaml").write_text(text)
    return read_experiment(folder / "experiment.yaml").materials["rubber"].density_kg_per_m3


def _case(text: str, folder: Path) -> Any:
    (folder / "case.yaml").write_text(text)
    return read_case_file(folder / "case.yaml").scans.loads[0].force_n


def _upload(text: str, folder: Path) -> Any:
    uploads, store = Uploads(folder, Limits()), open_store(folder / "store")
    return study_from(text, uploads, store, Limits()).case.load.force_n


EXPERIMENT = yaml.safe_dump(described()).replace("1200", NUMBER)
CASE_FILE = yaml.safe_dump(CASE).replace("force_n: 40", f"force_n: {NUMBER}")
FILES: dict[str, tuple[str, Callable[[str, Path], Any]]] = {
    "study of a breast": (BREAST, _breast),
    "study of a cornea": (CORNEA, _cornea),
    "experiment": (EXPERIMENT, _experiment),
    "case": (CASE_FILE, _case),
    "upload": (BREAST, _upload),
}
READ = {
    "60": 60, "+60": 60, "60.": 60, "60.0": 60, "60.50": 60.5, ".5": 0.5, "0.5": 0.5, "00.5": 0.5,
    "6e1": 60, "6E1": 60, "6e+1": 60, "6.0e1": 60, "6.0e+1": 60, "600e-1": 60, ".6e2": 60,
    "05": 5, "08": 8, "099": 99, "060.5": 60.5, "0x1f": 31, "1e2": 100, '"60"': 60, "060e0": 60,
}  # fmt: skip
REFUSED = [
    "060", "+060", "0100", "01500", "1:30", "1:30:00", "1:30.5", "0b11", "0o17", "1_000", "1_0.5",
    "0x1_f", "-0x1f", "yes", "no", "on", "off", "Yes", "y", "true", "True", "false", "5,0", "1,500",
    "1 000", "60 N", "1.0e+308", "1e400", "1e-400", ".inf", ".nan", "one",
]  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_spellings_are_read_as_decimal_or_refused(kind: str, tmp_path: Path) -> None:
    text, read = FILES[kind]
    assert text.count(NUMBER) == 1
    for spelling, number in READ.items():
        assert read(text.replace(NUMBER, spelling), tmp_path) == number, spelling
    line = text[: text.index(NUMBER)].count("\n") + 1
    for spelling in REFUSED:
        with pytest.raises(InputError) as refused:
            read(text.replace(NUMBER, spelling), tmp_path)
        if kind != "case" or "positive" not in str(refused.value):
            assert f"on line {line}" in str(refused.value), spelling


@pytest.mark.parametrize(
    ("spelling", "message"),
    [
        ("060", "force_n: 060 on line 6 is 60 in decimal or 48 in octal: write 60, or "),
        ("1:30", "force_n: 1:30 on line 6 is a text or a number in base 60: write 90, or "),
        ("1_000", "force_n: 1_000 on line 6 has underscores: write 1000, or "),
        ("0o17", "force_n: 0o17 on line 6 is octal: write 15, or "),
        ("5,0", "force_n: 5,0 on line 6 has a comma: write 5.0"),
        ("1,500", "on line 6 has a comma: write 1500, or 1.5 if the comma is a decimal one"),
        ("'5,0'", "expected a number, such as 12.5, found '5,0' on line 6: write 5.0"),
        ("60 N", "found '60 N' on line 6: give the number alone, in the unit of the key"),
        ("yes", "case.load.force_n: expected a number, such as 12.5, found 'yes' on line 6"),
        ("true", "expected a number or a text, not true or false, found True on line 6"),
        ("1.0e+308", "expected a number of at most 1e30, found 1e+308 on line 6"),
    ],
)
def test_says_what_to_write_instead(spelling: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        _breast(BREAST.replace("{force_n: SPELLING}", f"{{force_n: {spelling}}}"), tmp_path)
    assert message in str(refused.value)


def test_numbers_in_lists_counts_and_keys(tmp_path: Path) -> None:
    study = parse_spec(STUDY.replace("2000", "1e3").replace("[5, 20]", "[05, 2e1]"), "It", tmp_path)
    assert study.case.mesh.nodes == 1000
    assert isinstance(study.case.mesh.nodes, int)
    assert study.search.parameters["E_fat_kpa"] == (5, 20)
    with pytest.raises(InputError, match="E_fat_kpa: 020 on line 9 is 20 in decimal or 16 in oct"):
        parse_spec(STUDY.replace("[5, 20]", "[5, 020]"), "It", tmp_path)
    with pytest.raises(InputError, match=r"E_fat_kpa\.0: expected a number or a text, not true"):
        parse_spec(STUDY.replace("[5, 20]", "[true, 20]"), "It", tmp_path)
    with pytest.raises(InputError, match=r"on line 9: decimals have a point"):
        parse_spec(STUDY.replace("[5, 20]", "[5,0, 20,0]"), "It", tmp_path)
    with pytest.raises(InputError, match=r"whole number, found 1000\.5 on line 5"):
        parse_spec(STUDY.replace("2000", "1000.5"), "It", tmp_path)


def test_labels_are_decimal(tmp_path: Path) -> None:
    image = "reference: {volume: rest.npy, spacing_mm: 2, labels: LABELS}"
    text = STUDY.replace("reference: {phantom: {preset: 445ml}}", image)

    def labels(written: str) -> Any:
        study = parse_spec(text.replace("LABELS", written), "The study", tmp_path)
        return study.case.reference.labels

    assert labels("{08: fat, 2e0: glandular}") == {8: "fat", 2: "glandular"}
    with pytest.raises(InputError, match="labels: 010 on line 4 is 10 in decimal or 8 in octal"):
        labels("{010: fat}")
    with pytest.raises(InputError, match="expected a number or a text as key"):
        labels("{true: fat}")
    with pytest.raises(InputError, match="labels: 1:30 on line 4 is a text or a number in base 60"):
        labels("{1:30: fat}")


def test_only_true_and_false_are_booleans() -> None:
    assert validated(CaseFile, CASE | {"wall": {"z_mm": 0, "held": True}}).wall.held is True
    for given in ("yes", "on", "off", 1, 0.0):
        with pytest.raises(InputError, match=r"wall\.held: expected true or false, found "):
            validated(CaseFile, CASE | {"wall": {"z_mm": 0, "held": given}})


def test_text_that_looks_like_a_number_stays_text(tmp_path: Path) -> None:
    """Studies written as YAML 1.1 have names such as 1e3 without quotes."""
    for name in ("1e3", "08", "12e4", "no", "on", "'060'"):
        study = parse_spec(STUDY.replace("demo", name), "The study", tmp_path)
        assert study.name == name.strip("'\"")
        for written in (yaml.safe_dump(study.as_dict()), dump_yaml(study.as_dict())):
            assert parse_spec(written, "The study", tmp_path) == study
    with pytest.raises(InputError, match='expected a text, found 7 on line 2: write "007" in quot'):
        parse_spec(STUDY.replace("demo", "007"), "The study", tmp_path)
    values = ["1e3", "08", "060", "1:30", "0o17", "yes", "=", "1_0", 1e-5, 1e22, 3, True, None, ""]
    assert parse_yaml(dump_yaml(values), "It") == values
    assert [type(v) for v in parse_yaml(dump_yaml(values), "It")] == [type(v) for v in values]


def test_study_given_as_keys_is_checked_like_its_text(tmp_path: Path) -> None:
    uploads, store = Uploads(tmp_path, Limits()), open_store(tmp_path / "store")
    keys = parse_yaml(STUDY, "The study")
    assert study_from(keys | {"name": "1e3"}, uploads, store, Limits()).name == "1e3"
    keys["case"]["load"]["force_n"] = True
    with pytest.raises(InputError, match="expected a number or a text, not true or false"):
        study_from(keys, uploads, store, Limits())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  mesh", "\tmesh", "line 5 is indented with a tab. Replace each tab by blanks"),
        ("  mesh", "  \tmesh", "line 5 is indented with a tab. Replace each tab by blanks"),
        ("demo", '"\\ud800"', "found invalid Unicode character escape code, on line 2"),
        ("name: demo", "name: Müller 1", "found 'Müller 1' on line 2: write Mueller_1"),
        ("name: demo", "name: a/b", "expected at most 64 letters (a to z, A to Z), digits,"),
    ],
)
def test_plain_words_about_yaml_and_names(old: str, new: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        parse_spec(STUDY.replace(old, new, 1), "The study", tmp_path)
    assert message in str(refused.value)
    assert "<unicode string>" not in str(refused.value)


def test_json_refuses_half_a_character() -> None:
    assert parse_json('["\\ud83d\\ude00"]', "It") == ["\U0001f600"]
    with pytest.raises(InputError, match="It is not valid JSON"):
        parse_json('{"name": "\\ud800"}', "It")


def test_name_of_a_file_is_not_the_name_of_its_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text(STUDY)
    assert find_study(Path("mine.yaml")) == Path("runs/demo")
    with pytest.raises(InputError, match=r"mine\.yaml is a study file: give mine\.yaml"):
        find_study(Path("mine"))
