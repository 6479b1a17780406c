"""Reading the files of a set as records for scoring."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from palpate.service.blind.answering.answers import Answer
from palpate.service.blind.answering.baselines import closest, improvement, largest
from palpate.service.blind.scoring.drawn_interfaces import drawn_mm
from palpate.service.blind.scoring.magnitudes import (
    lump_apart_mm,
    magnitudes,
    strength,
    true_values,
)
from palpate.service.blind.scoring.true_gap import TrueGap, true_gap
from palpate.service.blind.sealed.case_file import is_along_y, read_case_settings
from palpate.service.blind.sealed.records import FAILED, CaseRecord
from palpate.service.blind.sealed.seal import read_json
from palpate.service.blind.sealed.sets import BlindSet, Directions, Truths
from palpate.service.blind.sealed.truth import CATALOGUE, Moved, Truth, read_moved, read_truth
from palpate.storage.errors import InputError
from palpate.storage.records.typed_json import from_json
from palpate.storage.values import FloatArray, Triple
from palpate.workers.diagnosis.schema.summary import ShareEstimate, Summary
from palpate.workers.diagnosis.verdict.verdict import NO_GAP, NONE_OF_THESE

Arrays = Mapping[str, FloatArray]


def read_records(
    blind: BlindSet, truths: Truths, names: list[str], directions: Directions
) -> list[CaseRecord]:
    """Return a record of every case.

    Raises
    ------
    InputError
        If a truth or an answer is incomplete.
    """
    return [_read(blind, truths, name, directions) for name in names]


def _read(blind: BlindSet, truths: Truths, name: str, directions: Directions) -> CaseRecord:
    truth = read_truth(truths.of(name))
    read = read_json(blind.answer(name, directions))
    if "failed" in read:
        return CaseRecord(
            name,
            truth.kind,
            truth.group,
            truth.effects,
            truth.families,
            FAILED,
            reason=read["failed"],
        )
    moved = _diagnosed(read_moved(truths.of(name)), blind.case(name), directions)
    with np.load(blind.points(name, directions)) as file:
        maps = {key: file[key] for key in file.files}
    return record_of(name, truth, moved, answer_of(read, name), maps)


def answer_of(read: Mapping[str, object], name: str) -> Answer:
    """Parse the content of an answer file.

    Raises
    ------
    InputError
        If the answer is incomplete.
    """
    try:
        return from_json(Answer, read)
    except ValueError as error:
        raise InputError(f"The answer to {name} is from another version: {error}.") from error


def record_of(name: str, truth: Truth, moved: Moved, answer: Answer, maps: Arrays) -> CaseRecord:
    """Return a record of the truth and the answer of one case.

    Parameters
    ----------
    truth : Truth
    moved : Moved
        Displacements in the diagnosed scans.
    answer : Answer
    maps : mapping of str to ndarray
        Arrays of the answer.
    """
    summary, gap = answer.summary, answer.summary.gap_mm
    effects = {e.name: e for e in summary.effects}
    before = _true_gap("before", truth, moved, maps, answer.centre_mm, {})
    after = _true_gap("after", truth, moved, maps, answer.centre_mm, _said_of_images(summary))
    visible = {n: e.probability for n, e in effects.items() if n not in summary.absorbed}
    ends = {
        NO_GAP: summary.no_gap_probability,
        NONE_OF_THESE: summary.none_of_these_probability,
    }
    return CaseRecord(
        name=name,
        kind=truth.kind,
        group=truth.group,
        effects=truth.effects,
        families=truth.families,
        answer=summary.verdict,
        primary=summary.primary,
        primary_families=tuple(effects[n].family for n in summary.primary),
        set90=summary.set90,
        probabilities=ends | visible,
        family_probabilities=summary.families,
        alarm=summary.alarm,
        claimed_before_mm=gap.before.gap_mm,
        claimed_after_mm=gap.after.gap_mm if gap.after else None,
        true_before_mm=before.gap_mm if before else None,
        true_after_mm=after.gap_mm if after else None,
        true_material_mm=before.material_mm if before else None,
        gap_interval_mm=(gap.before.low_mm, gap.before.high_mm),
        share_interval=_interval(gap.share),
        claimed_share=_known(gap.share),
        held_out_share=_known(gap.held_out_share),
        magnitudes=tuple(magnitudes(truth, effects)),
        strength=strength(truth, effects),
        lump_apart_mm=lump_apart_mm(truth, effects, answer.centre_mm),
        named_by={
            "raw_correlation": largest(answer.baselines.raw_correlation),
            "refit": closest(answer.baselines.refit_left_mm),
        },
        loudness={
            "raw_correlation": max(answer.baselines.raw_correlation.values(), default=0.0),
            "refit": improvement(answer.baselines.refit_left_mm, _rms(maps["before"])),
        },
        catalogue=len(effects),
    )


def _diagnosed(moved: Moved, case: Path, directions: Directions) -> Moved:
    """Return the displacements in the diagnosed scans."""
    if directions == "all":
        return moved
    loads = read_case_settings(case)["scans"]["loads"]
    chosen = [n for n, load in enumerate(loads) if is_along_y(load)]
    return Moved(moved.points, moved.interface, moved.displacement[chosen])


def _true_gap(
    when: str,
    truth: Truth,
    moved: Moved,
    maps: Arrays,
    centre_mm: Triple | None,
    found: Mapping[str, float],
) -> TrueGap | None:
    """Return the true gap to the interfaces as drawn; None if no effect is named.

    Labels or scans that are too large, or displaced, open a gap in the images but not in the
    body. The sizes `found` by the diagnosis for these effects close it.
    """
    if f"moved_{when}" not in maps:
        return None
    at, normals = maps[f"moved_{when}"], maps[f"normals_{when}"]
    true = true_values(truth)
    amiss = {n: true.get(n, 0.0) - found.get(n, 0.0) for n in {*true, *found}}
    interface = maps["interface"].astype(np.int32)
    known = maps["bias"] + drawn_mm(at, normals, interface, centre_mm, amiss)
    return true_gap(maps["points"], interface, at, normals, moved, known, maps.get("pressed"))


def _said_of_images(summary: Summary) -> dict[str, float]:
    """Return the sizes found for labels and scans that are too large or displaced, if named."""
    named = {e.name for e in CATALOGUE.on_observation}.intersection(summary.primary)
    return {p.parameter: p.magnitude for n in named for p in summary.effect(n).parameters}


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _known(share: ShareEstimate | None) -> float | None:
    """Return the share; None if there is no gap."""
    return None if share is None or np.isnan(share.share) else share.share


def _interval(share: ShareEstimate | None) -> tuple[float, float] | None:
    if share is None or np.isnan([share.low, share.high]).any():
        return None
    return share.low, share.high
