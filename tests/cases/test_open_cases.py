"""The cases of ../shared/reference/gap-open, made by FEBio with elements of another kind.

They were looked at while the diagnosis was built, so they show that it works, not how
often. The truth is read after the verdict.
"""

import json
from pathlib import Path

import pytest

from workers.cases.build import body_of, build_subject
from workers.cases.case import ImagedCase
from workers.diagnosis.calibrate import calibrate
from workers.diagnosis.diagnosis import diagnose, look, one_by_one
from workers.diagnosis.summary import summary
from workers.effects.catalogue import BREAST_EFFECTS
from workers.fem.model import prepare
from workers.mesh.hierarchy import build_hierarchy

CASES = Path(__file__).parents[3] / "shared" / "reference" / "gap-open"
# What each kind of truth should be called, the suspects in any order. Gravity acts along the
# fibres there and moves nothing by more than 0.02 mm. Friction of their law and skin look alike
# along one direction: 116 and 122 nats.
CALLED = {
    "control": [],
    "gravity": [],
    "tilt": ["plate_tilt"],
    "friction": ["plate_friction", "skin_added"],
    "inclusion": ["inclusion"],
}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not CASES.is_dir(), reason="the open cases of FEBio are not beside the project"
    ),
]


@pytest.mark.parametrize("name", sorted(p.name for p in CASES.glob("dev_*")))
def test_the_cause_is_named(name: str) -> None:
    case = ImagedCase(CASES / name)
    finer = prepare(build_hierarchy(body_of(case), nodes=14_000))
    subject, nominal = calibrate(build_subject(case), finer)
    seen = look(subject, nominal, BREAST_EFFECTS)
    found = diagnose(seen, BREAST_EFFECTS, one_by_one(seen))
    told = summary(found, list(BREAST_EFFECTS), name)
    truth = json.loads((CASES / name / "truth.json").read_text())
    wanted = CALLED[truth["spec"]["kind"]]
    verdicts = ("no-gap", "effect", "cannot-be-told-apart")
    assert told["verdict"] == verdicts[len(wanted)]
    if wanted:
        assert sorted(told["set90"]) == wanted
        assert told["primary"][0] in wanted
    if truth["spec"]["kind"] == "tilt":
        tilt = next(e for e in told["effects"] if e["name"] == "plate_tilt")
        assert tilt["magnitude"] == pytest.approx(truth["spec"]["tilt_x"], abs=3 * tilt["sd"])
