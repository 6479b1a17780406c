"""How often a diagnosis is right on bodies that other solvers deformed.

    python -m tests.benchmarks.foreign_bodies OUT SET [SET ...] [--workers 2] [--reliability FILE]
                                              [--unscreened]

A SET is a folder of cases with their truths, as in ../shared/reference/gap-opened2. Each case is
diagnosed from its case.yaml and scans alone; OUT receives one JSON file for each, and cases already
there are not diagnosed again. The tables count alarms, first names, complete names, and intervals;
the thresholds of the rule are set on all sets but one and applied to that one; and the rule is set
beside the smallest residual of one fit at a time. `--reliability` writes the counts that a report
states beside a gain. `--unscreened` fits every other effect, too, where no effect has clear
evidence, and shows what screening saved and lost.
"""

import argparse
import json
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

# One thread for every library; read when it is loaded.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402
import typer  # noqa: E402

from palpate.service.diagnosis.diagnosed_constants import judged_constants  # noqa: E402
from palpate.service.diagnosis.diagnosis_run import finished, request_for  # noqa: E402
from palpate.service.diagnosis.diagnosis_words import STRENGTHS, strength  # noqa: E402
from palpate.storage.json_digests import to_json  # noqa: E402
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS  # noqa: E402
from palpate.workers.diagnosis.verdict.cause_selection import selected  # noqa: E402
from palpate.workers.tasks import diagnosis_tasks as tasks  # noqa: E402
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest, DiagnosisStore  # noqa: E402

# Names in truths of the first set, where they differ from the catalogue's.
EFFECTS = {
    "tilt": "plate_tilt",
    "friction": "plate_friction",
    "gradient": "stiffness_gradient",
    "gravity": "gravity_change",
    "skin": "skin_added",
    "chest_compliance": "wall_compliance",
    "force_miscalibrated": "plate_force",
    "segmentation_bias": "segmentation_offset",
    "pair_gravity_tilt": "gravity_change plate_tilt",
}
# Below this gain in nats, effects that were not fitted may matter.
UNCLEAR = STRENGTHS[0][1]
# An effect that moves the interfaces by less than this on average cannot be seen.
LEAST_MM = 0.05


@dataclass(frozen=True)
class Judged:
    """A diagnosis beside its truth.

    Parameters
    ----------
    set, case, kind : str
    truth : tuple of str
        Effects of the catalogue that act; empty for a control.
    listed : bool
        Whether the catalogue lists all causes.
    named, rivals : tuple of str
    verdict : str
    singles : mapping of str to float
        Gains of single effects, in nats.
    further : mapping of str to float
        Gains of several effects, by their names joined with "+".
    residuals_mm : mapping of str to float
        Root mean square residual of each single fit, and of the nominal model under "".
    left_gain : float
    intervals : tuple of bool
        For each constant that may be quoted, whether its interval contains the truth.
    magnitudes : mapping of str to tuple of bool
        For each named effect that acts, whether each of its magnitudes is within two standard
        deviations of the truth.
    unscreened : mapping of str to float
        Gains of the effects that screening left out.
    unscreened_cpu_s : float
    cpu_s : float
    """

    set: str
    case: str
    kind: str
    truth: tuple[str, ...]
    listed: bool
    named: tuple[str, ...]
    rivals: tuple[str, ...]
    verdict: str
    singles: Mapping[str, float]
    further: Mapping[str, float]
    residuals_mm: Mapping[str, float]
    left_gain: float
    intervals: tuple[bool, ...]
    magnitudes: Mapping[str, tuple[bool, ...]]
    unscreened: Mapping[str, float]
    unscreened_cpu_s: float
    cpu_s: float

    @property
    def is_control(self) -> bool:
        """Whether nothing is missing from the model."""
        return self.listed and not self.truth

    @property
    def gain(self) -> float:
        """Gain of the best single effect, in nats."""
        return max(self.singles.values(), default=0.0)


def main() -> None:
    """Diagnose all cases and print the tables."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("sets", type=Path, nargs="+", metavar="SET")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--reliability", type=Path, metavar="FILE")
    parser.add_argument("--unscreened", action="store_true")
    wanted = parser.parse_args()
    wanted.out.mkdir(parents=True, exist_ok=True)
    cases = [c for folder in wanted.sets for c in sorted(folder.iterdir()) if is_case(c)]
    files = [wanted.out / f"{case.parent.name}-{case.name}.json" for case in cases]
    missing = [
        (case, file, wanted.unscreened)
        for case, file in zip(cases, files, strict=True)
        if not file.is_file()
    ]
    # A new process for each case: a worker keeps what it computed.
    pool = ProcessPoolExecutor(wanted.workers, get_context("spawn"), max_tasks_per_child=1)
    with pool:
        for done, case in enumerate(pool.map(diagnosed, missing), start=1):
            typer.echo(f"{done} of {len(missing)}: {case}", err=True)
    judged = [read_judged(file) for file in files]
    typer.echo("\n".join(tables(judged)))
    if wanted.reliability:
        wanted.reliability.write_text(json.dumps(reliability_of(judged), indent=1) + "\n")


def is_case(folder: Path) -> bool:
    """Check whether a folder holds a case and its truth."""
    return (folder / "case.yaml").is_file() and (folder / "truth.json").is_file()


def diagnosed(asked: tuple[Path, Path, bool]) -> str:
    """Diagnose a case in this process and write the result beside its truth."""
    case, file, is_unscreened = asked
    begun = time.process_time()
    request = request_for(case, file.parent / "stores" / f"{case.parent.name}-{case.name}")
    store = DiagnosisStore(request)
    calibration = tasks.calibrate_nominal(request)
    for effect in request.effects:
        for scan in range(calibration.scans):
            tasks.analyse_effect(request, effect, scan)
    while (left := tasks.weigh_hypotheses(request)).is_open:
        for names in left.wanted:
            tasks.fit_effects(request, names)
    spent = time.process_time() - begun
    diagnosis = finished(request)
    if diagnosis is None:
        raise AssertionError("the last task stores the outcome")
    analysis = store.analysis
    residuals = {"": analysis.nominal.residual(analysis.inverse)}
    for one in diagnosis.summary.refits:
        fitted = store.load_joint_fit(store.combination(one.effects))
        if fitted is not None and len(one.effects) == 1:
            residuals[one.effects[0]] = fitted.fit.residual(analysis.inverse)
    begun = time.process_time()
    others = others_fitted(request, store) if is_unscreened else {}
    record = {
        "set": case.parent.name,
        "case": case.name,
        "truth": json.loads((case / "truth.json").read_text()),
        "summary": to_json(diagnosis.summary),
        "quotable": {
            name: one.interval
            for name, one in judged_constants(diagnosis.summary).items()
            if one.answer.quotable
        },
        "residuals_mm": {name: float(np.sqrt((r**2).mean())) for name, r in residuals.items()},
        "cpu_s": spent,
        "unscreened": others,
        "unscreened_cpu_s": time.process_time() - begun,
    }
    file.write_text(json.dumps(record, indent=1, default=float))
    return case.name


def others_fitted(request: DiagnosisRequest, store: DiagnosisStore) -> dict[str, float]:
    """Fit the effects that the screening left out, unless evidence is clear; return their gains."""
    analysis = store.analysis

    def gain(name: str) -> float:
        fitted = store.load_joint_fit(store.combination((name,)))
        return 0.0 if fitted is None else fitted.log_evidence - analysis.log_evidence

    visible = [one.name for one in analysis.screening if not one.hides]
    done = [name for name in visible if store.has_joint_fit(store.combination((name,)))]
    if max(map(gain, done), default=0.0) > UNCLEAR:
        return {}
    others = [name for name in visible if name not in done]
    for name in others:
        tasks.fit_effects(request, (name,))
    return {name: gain(name) for name in others}


def read_judged(file: Path) -> Judged:
    """Read a stored result; its causes are named from its gains, with the thresholds of now."""
    record = json.loads(file.read_text())
    truth, summary = record["truth"], record["summary"]
    kind, effects, listed = truth_of(truth)
    fits = {tuple(one["effects"]): one["log_evidence_gain"] for one in summary["refits"]}
    return Judged(
        set=record["set"],
        case=record["case"],
        kind=kind,
        truth=effects,
        listed=listed,
        named=selected(fits, summary["absorbed"]) if summary["primary"] else (),
        rivals=tuple(summary["rivals"]),
        verdict=summary["verdict"],
        singles={who[0]: gain for who, gain in fits.items() if len(who) == 1},
        further={"+".join(who): gain for who, gain in fits.items() if len(who) > 1},
        residuals_mm=record["residuals_mm"],
        left_gain=summary["left_gain"],
        intervals=tuple(covered(record["quotable"], truth["constants_kPa"])),
        magnitudes=dict(magnitudes_within(summary, true_magnitudes(truth))),
        unscreened=record["unscreened"],
        unscreened_cpu_s=record["unscreened_cpu_s"],
        cpu_s=record["cpu_s"],
    )


def truth_of(truth: Mapping[str, Any]) -> tuple[str, tuple[str, ...], bool]:
    """Return the kind of a body, the effects of the catalogue that act, and whether all do."""
    if "causes" in truth:
        causes = truth["causes"]
        effects = tuple(cause["effect"] for cause in causes if cause["effect"])
        return truth["kind"], effects, len(effects) == len(causes)
    kind = truth["spec"]["kind"]
    moved = [scan["mean"] for scan in truth.get("gap_effect_mm", {}).values()]
    if kind == "control" or (moved and max(moved) < LEAST_MM):
        return kind, (), True
    if kind.startswith("ooc"):
        return kind, (), False
    return kind, tuple(EFFECTS.get(kind, kind).split()), True


def covered(quoted: Mapping[str, Any], truth: Mapping[str, float]) -> Iterable[bool]:
    """Yield, for each quoted constant, whether its interval contains the truth."""
    known = {"E_fat_kpa": "E_fat", "E_gl_kpa": "E_gl", "eta_kpa": "eta"}
    for name, interval in quoted.items():
        if name in known and interval is not None:
            yield interval[0] <= truth[known[name]] <= interval[1]


def true_magnitudes(truth: Mapping[str, Any]) -> Mapping[str, Mapping[str, float]]:
    """Return true parameters by effect, in the catalogue's terms, as far as they correspond."""
    if "causes" not in truth:
        spec = truth["spec"]
        effects, given = EFFECTS.get(spec["kind"], spec["kind"]).split(), [spec]
    else:
        effects = [cause["effect"] for cause in truth["causes"]]
        given = [cause["parameters"] for cause in truth["causes"]]
    return {
        effect: magnitudes
        for effect, one in zip(effects, given * len(effects), strict=False)
        if effect and (magnitudes := dict(_magnitudes(effect, one)))
    }


def _magnitudes(effect: str, given: Mapping[str, Any]) -> Iterable[tuple[str, float]]:
    if effect == "plate_friction":
        yield "friction", given.get("friction", given.get("mu"))
    elif effect == "wall_compliance":
        yield "wall_compliance_mm_per_kpa", given.get("chest", given.get("c_mm_per_kPa"))
    elif effect == "plate_tilt":
        depth, across = given.get("tilt") or (given["tilt_x"], given.get("tilt_z", 0.0))
        yield from (("tilt_depth_deg", depth), ("tilt_across_deg", across))
    elif effect == "gravity_change":
        names = ("gravity_x_g", "gravity_y_g", "gravity_z_g")
        yield from zip(names, given.get("gravity", given.get("g")), strict=True)
    elif effect == "inclusion":
        yield "inclusion_ln_ratio", float(np.log(given["ratio"]))
    elif effect == "skin_added":
        yield "skin_added_n_per_m", 1000.0 * given["E_MPa"] * given["t"]


def magnitudes_within(
    summary: Mapping[str, Any], truth: Mapping[str, Mapping[str, float]]
) -> Iterable[tuple[str, tuple[bool, ...]]]:
    """Yield, for each named effect that acts, which magnitudes are within two deviations."""
    for effect in summary["effects"]:
        name = effect["name"]
        if name in summary["primary"] and name in truth:
            sizes = {one["parameter"]: one for one in effect["parameters"]}
            yield (
                name,
                tuple(
                    abs(sizes[p]["magnitude"] - true) <= 2.0 * sizes[p]["sd"]
                    for p, true in truth[name].items()
                ),
            )


def tables(judged: Sequence[Judged]) -> Iterable[str]:
    """Yield the lines of all tables."""
    yield "| set | controls alarmed | named first | among rivals | in full | intervals |"
    yield "|---|---|---|---|---|---|"
    for name in sorted({one.set for one in judged}):
        yield row(name, [one for one in judged if one.set == name])
    yield row("all", judged)
    yield ""
    yield "| rule | controls alarmed | single, named first |"
    yield "|---|---|---|"
    yield from baselines(judged)
    yield ""
    yield "| magnitudes of named effects | within two standard deviations |"
    yield "|---|---|"
    yield from magnitude_rows(judged)
    if any(one.unscreened for one in judged):
        yield ""
        yield (
            "| no clear evidence | bodies | largest gain of an effect left out (nats) | causes "
            "lost | CPU s | CPU s of the fits left out |"
        )
        yield "|---|---|---|---|---|---|"
        yield from screening_rows(judged)
    yield ""
    yield "| gain of the first name | right | cause not in the catalogue |"
    yield "|---|---|---|"
    for band in reliability_of(judged):
        yield f"| {band['word']} | {band['right']} of {band['named']} | {band['unlisted']} |"


def magnitude_rows(judged: Sequence[Judged]) -> Iterable[str]:
    """Yield, for each effect, how many of its magnitudes are within two standard deviations."""
    names = sorted({name for one in judged for name in one.magnitudes})
    for name in names:
        within = [hit for one in judged for hit in one.magnitudes.get(name, ())]
        yield f"| {name.replace('_', ' ')} | {sum(within)} of {len(within)} |"


def screening_rows(judged: Sequence[Judged]) -> Iterable[str]:
    """Yield what fits of the effects left out by screening would have cost and found."""
    looked = [one for one in judged if one.unscreened]
    first = SETTINGS.selection.first
    for kind, some in (
        ("nothing missing", [one for one in looked if one.is_control]),
        ("an effect missing", [one for one in looked if not one.is_control]),
    ):
        found = [max(one.unscreened.values()) for one in some]
        lost = sum(
            max(one.unscreened.get(name, 0.0) for name in one.truth) > first
            for one in some
            if one.truth
        )
        spent = sum(one.unscreened_cpu_s for one in some), sum(one.cpu_s for one in some)
        yield (
            f"| {kind} | {len(some)} | {max(found, default=0.0):.1f} | {lost} | {spent[1]:.0f} | "
            f"{spent[0]:.0f} |"
        )


def row(name: str, judged: Sequence[Judged]) -> str:
    """Return the counts of some bodies as a row of a table."""
    controls = [one for one in judged if one.is_control]
    singles = [one for one in judged if len(one.truth) == 1 and one.listed]
    spoken = [one for one in judged if one.named]
    alarmed = sum(bool(one.named) or one.verdict == "none-of-these" for one in controls)
    first = sum(one.named[:1] == one.truth for one in singles)
    among = sum(bool({*one.named, *one.rivals} & {*one.truth}) for one in singles)
    full = sum(bool(one.truth) and {*one.named} == {*one.truth} for one in spoken)
    within = [hit for one in judged for hit in one.intervals]
    return (
        f"| {name} | {alarmed} of {len(controls)} | {first} of {len(singles)} | {among} | "
        f"{full} of {len(spoken)} | {sum(within)} of {len(within)} |"
    )


def baselines(judged: Sequence[Judged]) -> Iterable[str]:
    """Yield the rule, and the smallest residual with a threshold for as many alarms."""
    controls = [one for one in judged if one.is_control]
    singles = [one for one in judged if len(one.truth) == 1 and one.listed]
    alarms = sum(bool(one.named) for one in controls)

    def drop(one: Judged) -> float:
        best = min(one.residuals_mm.values())
        return float(np.log(one.residuals_mm[""] / best))

    least = sorted((drop(one) for one in controls), reverse=True)[alarms] if controls else 0.0
    of_rule = sum(one.named[:1] == one.truth for one in singles)
    of_residual = sum(
        drop(one) > least
        and (min(one.residuals_mm, key=lambda name: one.residuals_mm[name]),) == one.truth
        for one in singles
    )
    yield f"| forward selection | {alarms} of {len(controls)} | {of_rule} of {len(singles)} |"
    yield f"| smallest residual | {alarms} of {len(controls)} | {of_residual} of {len(singles)} |"


def reliability_of(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return, for each band of gains, how often the first name was right."""
    found = []
    for word in ("weak", "clear", "strong"):
        named = [one for one in judged if one.named and strength(one.gain) == word]
        right = sum(one.named[0] in one.truth for one in named)
        unlisted = sum(not one.listed and one.named[0] not in one.truth for one in named)
        found.append({"word": word, "named": len(named), "right": right, "unlisted": unlisted})
    return found


if __name__ == "__main__":
    main()
