"""Opens a set: checks every seal, then scores the answers."""

from dataclasses import asdict
from typing import Any

from service.blind.calibration import calibration_curve
from service.blind.confusion import confusion
from service.blind.metrics import floor_mm, metrics, regrouped
from service.blind.read_records import read_records
from service.blind.scored_set import ScoredSet, Seals
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


def score_set(blind: BlindSet, truths: Truths, directions: Directions) -> ScoredSet:
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
    seals: Seals = {
        "manifest": file_hash(blind.manifest),
        "answers": file_hash(blind.sealed_answers(directions)),
        "diagnosis": sealed["diagnosis"],
        "declared": sealed["declared"],
        "directions": directions,
    }
    name = blind.root.absolute().name
    return ScoredSet(name, records, metrics(records), floor_mm(records), seals)


def record(scored: ScoredSet) -> dict[str, Any]:
    """Return what `palpate blind score --json` prints."""
    table = confusion(scored.records)
    return {
        "set": scored.name,
        "seals": scored.seals,
        "floor_mm": scored.floor_mm,
        "figures": [asdict(f) for f in scored.metrics],
        "calibration": [asdict(b) for b in calibration_curve(scored.records)],
        "confusion": {"rows": table.rows, "columns": table.columns, "counts": table.counts},
        "cases": [
            asdict(r) | {"right": r.right, "covered": r.covered, "true_share": r.true_share}
            for r in scored.records
        ],
    }
