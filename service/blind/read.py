"""From the files of a set to records that can be scored."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from service.blind.baselines import closest, largest
from service.blind.magnitudes import lump_apart_mm, magnitudes, true_values
from service.blind.records import FAILED, CaseRecord
from service.blind.seal import read_json
from service.blind.sets import BlindSet, Directions, Truths
from service.blind.true_gap import true_gap
from service.blind.truth import Moved, Truth, read_moved, read_truth
from storage.values import FloatArray
from workers.diagnosis.verdict import NO_GAP, NONE_OF_THESE
from workers.effects.segmentation import SEGMENTATION_OFFSET

Json = dict[str, Any]
Arrays = Mapping[str, FloatArray]
Y_AXIS = [0, 1, 0]
# Labels drawn too large, by the interface that they move.
OFFSETS_MM = ("segmentation_fat_mm", "segmentation_glandular_mm")


def read_records(
    blind: BlindSet, truths: Truths, names: list[str], directions: Directions
) -> list[CaseRecord]:
    """A record of every case.

    Raises
    ------
    InputError
        If a truth or an answer lacks something.
    """
    return [_read(blind, truths, name, directions) for name in names]


def _read(blind: BlindSet, truths: Truths, name: str, directions: Directions) -> CaseRecord:
    truth = read_truth(truths.of(name))
    said = read_json(blind.answer(name, directions))
    if "failed" in said:
        return CaseRecord(
            name, truth.kind, truth.group, truth.effects, truth.families, FAILED,
            reason=said["failed"],
        )  # fmt: skip
    moved = _seen(read_moved(truths.of(name)), blind.case(name), directions)
    with np.load(blind.points(name, directions)) as file:
        maps = {key: file[key] for key in file.files}
    return record_of(name, truth, moved, said, maps)


def record_of(name: str, truth: Truth, moved: Moved, said: Json, maps: Arrays) -> CaseRecord:
    """One case.

    Parameters
    ----------
    truth : Truth
    moved : Moved
        Of the scans that were diagnosed.
    said : dict
        The answer, see `service.blind.answers.write_answer`.
    maps : mapping of str to ndarray
        Its arrays.
    """
    told = said["summary"]
    by_name = {e["name"]: e for e in told["effects"]}
    hidden = set(told["absorbed"])
    gap = told["gap_mm"]
    told_apart = {n: e["probability"] for n, e in by_name.items() if n not in hidden}
    ends = {NO_GAP: told["no_gap_probability"], NONE_OF_THESE: told["none_of_these_probability"]}
    baselines = said["baselines"]
    return CaseRecord(
        name=name,
        kind=truth.kind,
        group=truth.group,
        effects=truth.effects,
        families=truth.families,
        answer=told["verdict"],
        primary=tuple(told["primary"]),
        primary_families=tuple(by_name[n]["family"] for n in told["primary"]),
        set90=tuple(told["set90"]),
        probabilities=ends | told_apart,
        alarm=told["alarm"],
        claimed_before_mm=gap["before"]["gap_mm"],
        claimed_after_mm=gap["after"]["gap_mm"] if gap["after"] else None,
        true_before_mm=_true_mm("before", truth, moved, maps, {}),
        true_after_mm=_true_mm("after", truth, moved, maps, _offsets(told)),
        gap_interval_mm=(gap["before"]["low_mm"], gap["before"]["high_mm"]),
        share_interval=_share_interval(gap),
        claimed_share=_known(gap["share"]["share"]) if gap.get("share") else None,
        held_out_share=_held_out(gap),
        magnitudes=tuple(magnitudes(truth, by_name)),
        lump_apart_mm=lump_apart_mm(truth, by_name, said.get("centre_mm")),
        accused_by={
            "raw_correlation": largest(baselines["raw_correlation"]),
            "refit": closest(baselines["refit_left_mm"]),
        },
        catalogue=len(by_name),
    )


def _seen(moved: Moved, case: Path, directions: Directions) -> Moved:
    """The scans that were diagnosed."""
    if directions == "all":
        return moved
    loaded = read_json(case / "case.json")["scans"]["deformed"]
    chosen = [n for n, d in enumerate(loaded) if d.get("compression_axis", Y_AXIS) == Y_AXIS]
    return Moved(moved.points, moved.interface, moved.displacement[chosen])


def _true_mm(
    when: str, truth: Truth, moved: Moved, maps: Arrays, found: Mapping[str, float]
) -> float | None:
    """The true gap, of the interfaces as they are drawn; None where nobody is accused.

    Labels that are drawn too large are a gap of the images and none of the body. What the
    diagnosis says of it, `found`, closes that gap.
    """
    if f"moved_{when}" not in maps:
        return None
    normals, interface = maps[f"normals_{when}"], maps["interface"].astype(np.int32)
    true = true_values(truth)
    drawn = np.array([true.get(n, 0.0) - found.get(n, 0.0) for n in OFFSETS_MM])
    known = maps["bias"] + drawn[interface]
    return true_gap(maps["points"], maps[f"moved_{when}"], normals, moved, known).gap_mm


def _offsets(told: Json) -> dict[str, float]:
    """What is said of labels that are drawn too large, if they are accused."""
    if SEGMENTATION_OFFSET.name not in told["primary"]:
        return {}
    accused = next(e for e in told["effects"] if e["name"] == SEGMENTATION_OFFSET.name)
    return {p["parameter"]: p["magnitude"] for p in accused["parameters"]}


def _held_out(gap: Json) -> float | None:
    return _known(gap["held_out_share"]["share"]) if gap.get("held_out_share") else None


def _share_interval(gap: Json) -> tuple[float, float] | None:
    if not gap.get("share"):
        return None
    low, high = (_known(gap["share"][end]) for end in ("low", "high"))
    return None if low is None or high is None else (low, high)


def _known(value: float | str) -> float | None:
    """A number of an answer, where "nan" says that there is none: no gap has no share."""
    number = float(value)
    return None if np.isnan(number) else number
