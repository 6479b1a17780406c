"""An inconsistent record cannot be created; a consistent one round-trips through the journal."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.storage.errors import JournalError, NewerSchemaError
from palpate.storage.journal_records import EvaluationRecord, Status, StudyRecord, record_of
from palpate.storage.json_digests import dumps, loads

SCORE = {"gsf": -1.5, "jc": 0.97, "mhd_mm": 0.1}
DONE = {
    "candidate": 3,
    "generation": 1,
    "genes": {"E_fat": 0.1 + 0.2, "eta_fat": 5e-324},
    "digest": "0123456789abcdef",
    "status": Status.DONE,
    "score": SCORE,
    "outcome": {"converged": True, "newton_iterations": (3, 2), "reason": ""},
    "seconds": {"solve": 1.25},
    "worker": "tcp://10.0.0.1:4000",
    "attempts": 2,
}
DIVERGED = DONE | {"status": Status.DIVERGED, "score": None, "reason": "no equilibrium"}
CRASHED = DIVERGED | {"status": Status.CRASHED, "traceback": "Traceback ...\n  é\n"}
LOST = DIVERGED | {"status": Status.LOST, "outcome": None}


def through_a_line(record):
    return record_of(loads(dumps(record.to_json())))


@pytest.mark.parametrize("values", [DONE, DIVERGED, CRASHED, LOST], ids=lambda v: v["status"])
def test_every_ending_round_trips(values):
    record = EvaluationRecord(**values)
    assert through_a_line(record) == record
    assert through_a_line(record).status is values["status"]
    assert dict(through_a_line(record).genes) == values["genes"]


@pytest.mark.parametrize("gsf", [-math.inf, math.inf, -0.0, 1e308, np.float64(-1 / 3)])
def test_every_score_round_trips(gsf):
    record = EvaluationRecord(**DONE | {"score": SCORE | {"gsf": gsf}})
    line = dumps(record.to_json())
    assert "Infinity" not in line
    read = through_a_line(record).score["gsf"]
    assert type(read) is float
    assert (read, math.copysign(1, read)) == (gsf, math.copysign(1, gsf))


def test_infinities_are_strings_on_disk():
    record = EvaluationRecord(**DONE | {"score": {"gsf": -math.inf, "mhd_mm": math.inf}})
    assert record.to_json()["score"] == {"gsf": "-inf", "mhd_mm": "inf"}


@given(st.floats(allow_nan=False, allow_infinity=False))
@settings(max_examples=50, deadline=None)
def test_genes_round_trip_bit_for_bit(gene):
    read = through_a_line(EvaluationRecord(**DONE | {"genes": {"E": gene}})).genes["E"]
    assert np.float64(read).tobytes() == np.float64(gene).tobytes()


def test_strings_that_look_like_numbers_stay_strings():
    record = EvaluationRecord(**LOST | {"reason": "nan", "worker": "inf"})
    assert through_a_line(record) == record


def test_diverged_outcome_may_contain_nan():
    record = EvaluationRecord(**DIVERGED | {"outcome": {"residual_n": math.nan}})
    assert math.isnan(through_a_line(record).outcome["residual_n"])


def test_study_round_trips():
    record = StudyRecord("abc", {"name": "é", "search": {"elite": 2}}, {"palpate": "0.1.0"})
    assert through_a_line(record) == record
    assert json.loads(dumps(record.to_json()))["kind"] == "study"


@pytest.mark.parametrize(
    ("base", "wrong", "message"),
    [
        (DONE, {"score": None}, "is done without a score"),
        (DONE, {"score": {"jc": 1.0}}, "gsf None"),
        (DONE, {"score": {"gsf": math.nan}}, "gsf nan"),
        (DONE, {"reason": "because"}, "with the reason 'because'"),
        (DONE, {"traceback": "x"}, "with a traceback"),
        (DONE, {"attempts": 0}, "after 0 attempts"),
        (DONE, {"candidate": -1}, "is not a count"),
        (DONE, {"generation": 1.5}, "is not a count"),
        (DONE, {"genes": {"E": math.inf}}, "not finite"),
        (DIVERGED, {"score": SCORE}, "is diverged with a score"),
        (DIVERGED, {"reason": ""}, "with the reason ''"),
        (CRASHED, {"traceback": ""}, "without a traceback"),
        (LOST, {"status": "running"}, "is not an ending"),
    ],
)
def test_refuses_inconsistent_records(base, wrong, message):
    with pytest.raises(JournalError, match=message):
        EvaluationRecord(**base | wrong)


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "verdict"},
        {"status": "finished"},
        {"genes": [1.0]},
        {"genes": {"E": "soft"}},
        {"score": 3},
        {"score": {"gsf": "low"}},
        {"surprise": 1},
        {"schema_version": "1"},
        {"schema_version": None},
    ],
)
def test_inconsistent_line_means_damaged_journal(change):
    line = EvaluationRecord(**DONE).to_json() | change
    with pytest.raises(JournalError, match="start a new study"):
        record_of(line)


def test_missing_field_is_named():
    line = EvaluationRecord(**DONE).to_json()
    del line["digest"]
    with pytest.raises(JournalError, match="missing or unknown: digest"):
        record_of(line)


def test_newer_record_requires_upgrade_even_if_it_looks_different():
    for record in (EvaluationRecord(**DONE), StudyRecord("a", {}, {})):
        line = record.to_json() | {"schema_version": 3, "surprise": 1}
        with pytest.raises(NewerSchemaError, match="Upgrade"):
            record_of(line)
