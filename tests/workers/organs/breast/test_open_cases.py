"""The cases of ../shared/reference/gap-open, made by FEBio with elements of another kind.

They were used while the diagnosis was developed, so they show that it works, not how often. The
truth is read after the verdict.
"""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.organs.breast.scanned_case_files import read_case
from palpate.workers.organs.breast.scanned_case_source import ScannedCaseSource
from palpate.workers.tasks.diagnosis_store import Outcome
from tests.workers.tasks.one_process import diagnosed_store

NODES = 5000
CASES = Path(__file__).parents[5] / "shared" / "reference" / "gap-open"
# What each kind of truth should be called. Gravity acts along the fibres there and moves
# nothing by more than 0.02 mm.
CALLED = {
    "control": [],
    "gravity": [],
    "tilt": ["plate_tilt"],
    "friction": ["plate_friction"],
    "inclusion": ["inclusion"],
}
# The gap is 0.2 mm: the inclusion is most probable, with 71 %, but coarsened evidence does not make
# it certain.
UNCERTAIN = "dev_e91470"
NAMES = sorted(p.name for p in CASES.glob("dev_*"))

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not CASES.is_dir(), reason="the open cases of FEBio are not next to the project"
    ),
]


@cache
def truth_of(name: str) -> dict[str, Any]:
    """Return the hidden deviation of a case, read after the verdict."""
    spec: dict[str, Any] = json.loads((CASES / name / "truth.json").read_text())["spec"]
    return spec


@pytest.fixture(scope="module")
def told_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Summary]:
    """The diagnosis of a case, run once."""
    store = tmp_path_factory.mktemp("open") / "store"

    @cache
    def told(name: str) -> Summary:
        source = ScannedCaseSource(read_case(CASES / name))
        return diagnosed_store(source, store, NODES).outcome.record(Outcome).summary

    return told


@pytest.mark.parametrize("name", NAMES)
def test_the_verdict_names_the_cause(name: str, told_of: Callable[[str], Summary]) -> None:
    told = told_of(name)
    truth = truth_of(name)
    wanted = CALLED[truth["kind"]]
    expected = "effect" if wanted else "no-gap"
    assert told.verdict == ("cannot-be-told-apart" if name == UNCERTAIN else expected)
    assert list(told.primary) == wanted
    if truth["kind"] == "tilt":
        tilt = told.effect("plate_tilt")
        assert tilt.magnitude == pytest.approx(truth["tilt_x"], abs=3 * tilt.sd)
