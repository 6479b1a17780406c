"""Opens a set: checks every seal, then scores the answers."""

from dataclasses import asdict
from typing import Any

from service.blind.confusion import confusion
from service.blind.page import Scored
from service.blind.probability import calibration_curve
from service.blind.read import read_records
from service.blind.scores import figures, floor_mm, regrouped
from service.blind.seal import file_hash
from service.blind.sets import (
    BlindSet,
    Directions,
    Truths,
    check_answers,
    check_cases,
    check_truths,
    read_manifest,
)

Json = dict[str, Any]


def score_set(blind: BlindSet, truths: Truths, directions: Directions) -> Scored:
    """Score a set.

    Raises
    ------
    InputError
        If it is not sealed or not answered, or a case, a truth or an answer is not what
        was sealed.
    """
    manifest = read_manifest(blind)
    check_cases(blind, manifest)
    sealed = check_answers(blind, directions)
    check_truths(truths, manifest)
    read = read_records(blind, truths, sorted(manifest["cases"]), directions)
    records = regrouped(read)
    seals = {
        "manifest": file_hash(blind.manifest),
        "answers": file_hash(blind.sealed_answers(directions)),
        "diagnosis": sealed["diagnosis"],
        "declared": sealed["declared"],
        "directions": directions,
    }
    name = blind.root.absolute().name
    return Scored(name, records, figures(records), floor_mm(records), seals)


def record(scored: Scored) -> Json:
    """What `palpate blind score --json` prints."""
    found = confusion(scored.records)
    return {
        "set": scored.name,
        "seals": scored.seals,
        "floor_mm": scored.floor_mm,
        "figures": [asdict(f) for f in scored.figures],
        "calibration": [asdict(b) for b in calibration_curve(scored.records)],
        "confusion": {"rows": found.rows, "columns": found.columns, "counts": found.counts},
        "cases": [
            asdict(r) | {"right": r.right, "covered": r.covered, "true_share": r.true_share}
            for r in scored.records
        ],
    }
