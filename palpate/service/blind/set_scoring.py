"""Scoring of opened sets, after every seal has been checked.

The files of a set are read as records, these are scored, and page, text and console show the
result, a `ScoredSet`.

True magnitudes are converted to the catalogue's parameters, for comparison with estimates: the
maker of a case parametrises each cause in its own way; `Effect.truth` returns the catalogue
parameters with the same meaning, which a diagnosis should find.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from palpate.service.blind.answer_statistics import confusion, reliability
from palpate.service.blind.blind_metrics import Metric, floor_mm, metrics, regrouped
from palpate.service.blind.case_truth import (
    CATALOGUE,
    FAILED,
    MAPPED,
    CaseRecord,
    Magnitude,
    Moved,
    Truth,
    read_moved,
    read_truth,
)
from palpate.service.blind.diagnosed_case import is_along_y, read_case_settings
from palpate.service.blind.sealed_set import (
    BlindSet,
    Directions,
    Truths,
    check_answers,
    check_cases,
    check_truths,
    file_hash,
    read_json,
    read_manifest,
)
from palpate.service.blind.set_answering import (
    Answer,
    closest_refit,
    largest_correlation,
    refit_improvement,
)
from palpate.service.blind.true_gap import TrueGap, drawn_mm, true_gap
from palpate.storage.errors import InputError
from palpate.storage.json_digests import from_json
from palpate.storage.values import FloatArray, Triple
from palpate.workers.diagnosis.outcome.diagnosis_summary import (
    EffectSummary,
    ShareEstimate,
    Summary,
)


def true_values(truth: Truth) -> dict[str, float]:
    """Return the catalogue parameters of all true effects, under their external names.

    Raises
    ------
    KeyError
        If a cause lacks a parameter.
    """
    convert = {e.name: e.truth for e in CATALOGUE.effects if e.truth is not None}
    out: dict[str, float] = {}
    for cause in truth.causes:
        if cause.effect in convert:
            out |= convert[cause.effect](cause.parameters)
    return out


def magnitudes(truth: Truth, by_name: Mapping[str, EffectSummary]) -> list[Magnitude]:
    """Return estimated and true magnitudes of a single effect that was refitted.

    Parameters
    ----------
    by_name : mapping of str to EffectSummary
        The summary of each effect, see `workers.diagnosis.outcome.diagnosis_summary`.
    """
    found = by_name.get(truth.effects[0]) if truth.group == "single" else None
    if found is None or not found.refitted:
        return []
    true = true_values(truth)
    return [
        Magnitude(p.parameter, p.magnitude, p.sd, true[p.parameter])
        for p in found.parameters
        if p.parameter in true
    ]


def lump_apart_mm(truth: Truth, by_name: Mapping[str, EffectSummary]) -> float | None:
    """Return the distance between the true and the estimated centre of a lump, or None."""
    given = next((c.parameters for c in truth.causes if c.effect == MAPPED.name), None)
    effect = by_name.get(MAPPED.name)
    if given is None or effect is None or not effect.refitted or MAPPED.place is None:
        return None
    sizes = {p.parameter: p.magnitude for p in effect.parameters}
    positions = [name for name, _ in MAPPED.place.positions_mm((0.0, 0.0, 0.0)).values()]
    centre = np.array([sizes[name] for name in positions])
    return float(np.linalg.norm(centre - np.asarray(given["centre_mm"])))


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
    try:
        answer = from_json(Answer, read)
    except ValueError as error:
        raise InputError(
            f"{blind.answer(name, directions)} is from a version whose answers cannot be scored "
            f"any more, such as one that states probabilities ({error}). Move "
            f"{blind.answers(directions)} and {blind.sealed_answers(directions)} away and run "
            f"`palpate blind run {blind.root} --directions {directions}` again."
        ) from error
    return record_of(name, truth, moved, answer, maps)


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
    return CaseRecord(
        name=name,
        kind=truth.kind,
        group=truth.group,
        effects=truth.effects,
        families=truth.families,
        answer=summary.verdict,
        primary=summary.primary,
        rivals=summary.rivals,
        family_of={n: effects[n].family for n in (*summary.primary, *summary.rivals)},
        gain=summary.gain,
        something_else=summary.something_else,
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
        lump_apart_mm=lump_apart_mm(truth, effects),
        named_by={
            "raw_correlation": largest_correlation(answer.baselines.raw_correlation),
            "refit": closest_refit(answer.baselines.refit_left_mm),
        },
        loudness={
            "raw_correlation": max(answer.baselines.raw_correlation.values(), default=0.0),
            "refit": refit_improvement(answer.baselines.refit_left_mm, _rms(maps["before"])),
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
    centre_mm: Triple,
    found: Mapping[str, float],
) -> TrueGap | None:
    """Return the true gap to the interfaces as drawn; None if no effect is named.

    Labels or scans that are too large, or displaced, open a gap in the images but not in the
    body. The sizes `found` by the diagnosis for these effects close it.
    """
    if f"moved_{when}" not in maps:
        return None
    places, normals = maps[f"moved_{when}"], maps[f"normals_{when}"]
    true = true_values(truth)
    amiss = {n: true.get(n, 0.0) - found.get(n, 0.0) for n in {*true, *found}}
    interface = maps["interface"].astype(np.int32)
    known = maps["bias"] + drawn_mm(places, normals, interface, centre_mm, amiss)
    return true_gap(maps["points"], interface, places, normals, moved, known, maps.get("pressed"))


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


class Seals(TypedDict):
    """The seals behind the score of a set.

    ``set`` is its name, ``manifest`` and ``answers`` are hashes, ``diagnosis`` is the one that
    answered (see `sealed_diagnosis`), ``declared`` is the reason if it is not the
    sealed one, and ``directions`` are the scans that it received.
    """

    set: str
    manifest: str
    answers: str
    diagnosis: dict[str, Any]
    declared: str | None
    directions: Directions


@dataclass(frozen=True)
class ScoredSet:
    """One set, or several together, with metrics.

    Parameters
    ----------
    name : str
        Name of the set, or of several: "one + another".
    records : sequence of CaseRecord
    metrics : sequence of Metric
    floor_mm : float or None
        True gap of the median control; None without controls.
    seals : tuple of Seals
        One for each set.
    """

    name: str
    records: Sequence[CaseRecord]
    metrics: Sequence[Metric]
    floor_mm: float | None
    seals: tuple[Seals, ...]

    @property
    def declared(self) -> list[str]:
        """Return the reasons why the answering diagnosis is not the sealed one, if any."""
        return list(dict.fromkeys(one["declared"] for one in self.seals if one["declared"]))

    @property
    def targets_first(self) -> list[Metric]:
        """Return all metrics, those with a target first."""
        return sorted(self.metrics, key=lambda metric: metric.target is None)


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
        [record for blind, truths in sets for record in _records(blind, truths, directions)]
    )
    name = " + ".join(record["set"] for record in seals)
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


def score_record(scored: ScoredSet) -> dict[str, Any]:
    """Return the record printed by `palpate blind score --json`."""
    table = confusion(scored.records)
    return {
        "set": scored.name,
        "seals": scored.seals,
        "floor_mm": scored.floor_mm,
        "figures": [asdict(f) for f in scored.metrics],
        "reliability": [asdict(b) for b in reliability(scored.records)],
        "confusion": {"rows": table.rows, "columns": table.columns, "counts": table.counts},
        "cases": [
            asdict(r) | {"right": r.right, "true_share": r.true_share} for r in scored.records
        ],
    }
