"""Scoring of opened sets, after every seal has been checked."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from palpate.service.blind.scoring.calibration import calibration_curve
from palpate.service.blind.scoring.confusion import confusion
from palpate.service.blind.scoring.metrics import floor_mm, metrics, regrouped
from palpate.service.blind.scoring.read_records import read_records
from palpate.service.blind.scoring.scored_set import ScoredSet, Seals
from palpate.service.blind.sealed.records import CaseRecord
from palpate.service.blind.sealed.seal import file_hash
from palpate.service.blind.sealed.sets import (
    BlindSet,
    Directions,
    Truths,
    check_answers,
    check_cases,
    check_truths,
    read_manifest,
)
from palpate.storage.errors import InputError

OpenedSet = tuple[BlindSet, Truths]
"""A set and the location of its truths."""


def score_sets(sets: Sequence[OpenedSet], directions: Directions) -> ScoredSet:
    """Score one set, or several as one.

    Raises
    ------
    InputError
        If a set is not sealed or not answered, a seal is broken, or a set is given twice.
    """
    roots = [blind.root.absolute().resolve() for blind, _ in sets]
    twice = next((root for n, root in enumerate(roots) if root in roots[:n]), None)
    if twice is not None:
        raise InputError(f"The set {twice} is given twice: its cases would be counted twice.")
    seals = tuple(_checked_seals(blind, truths, directions) for blind, truths in sets)
    records = regrouped(
        [one for blind, truths in sets for one in _records(blind, truths, directions)]
    )
    name = " + ".join(one["set"] for one in seals)
    return ScoredSet(name, records, metrics(records), floor_mm(records), seals)


def _checked_seals(blind: BlindSet, truths: Truths, directions: Directions) -> Seals:
    """Check the seals of a set and return them."""
    manifest = read_manifest(blind)
    check_cases(blind, manifest)
    sealed = check_answers(blind, directions)
    check_truths(truths, manifest)
    return {
        "set": blind.root.absolute().name,
        "manifest": file_hash(blind.manifest),
        "answers": file_hash(blind.sealed_answers(directions)),
        "diagnosis": sealed["diagnosis"],
        "declared": sealed["declared"],
        "directions": directions,
    }


def _records(blind: BlindSet, truths: Truths, directions: Directions) -> list[CaseRecord]:
    return read_records(blind, truths, sorted(read_manifest(blind)["cases"]), directions)


def record(scored: ScoredSet) -> dict[str, Any]:
    """Return the record printed by `palpate blind score --json`."""
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
