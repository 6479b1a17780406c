"""What each part of the evidence is worth on bodies that other solvers deformed.

    python -m tests.benchmarks.evidence_variants OUT SET [SET ...] [--workers 2]

OUT is the folder of `tests.benchmarks.foreign_bodies --unscreened`, whose fits are read. For each
variant, the gains of all these fits are computed again from their linearisations, which include one
further step, and causes are named by forward selection. Every variant may raise as many alarms as
the shipped evidence with its threshold; its own threshold follows from that, and the threshold of a
further cause grows in proportion. The last row takes the threshold of each set from the controls of
the other sets.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import typer

from palpate.service.diagnosis.diagnosis_run import request_for
from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis
from palpate.workers.diagnosis.fits.gauss_newton import Fit
from palpate.workers.diagnosis.laplace_evidence import log_evidence
from palpate.workers.diagnosis.linearisation import Linearised, factored
from palpate.workers.diagnosis.noise.noise_components import LearntNoise
from palpate.workers.diagnosis.verdict.cause_selection import selected
from palpate.workers.tasks.diagnosis_store import DiagnosisStore
from tests.benchmarks.foreign_bodies import Judged, is_case, read_judged

Score = Callable[[Fit], float]
SHIPPED = "one learnt scale per interface"
RESIDUAL = "smallest residual"


def main() -> None:
    """Score the fits of all cases by all variants, and print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("sets", type=Path, nargs="+", metavar="SET")
    parser.add_argument("--workers", type=int, default=2)
    wanted = parser.parse_args()
    cases = [c for folder in wanted.sets for c in sorted(folder.iterdir()) if is_case(c)]
    asked = [(case, wanted.out) for case in cases]
    with ProcessPoolExecutor(wanted.workers, get_context("spawn"), max_tasks_per_child=1) as pool:
        rows = []
        for scored in pool.map(scored_case, asked):
            rows.append(scored)
            typer.echo(f"{len(rows)} of {len(cases)}", err=True)
    judged = [read_judged(wanted.out / f"{c.parent.name}-{c.name}.json") for c in cases]
    typer.echo("\n".join(table(judged, rows)))


def scored_case(asked: tuple[Path, Path]) -> Mapping[str, Any]:
    """Return the gains of a case's fits by each variant, stored beside its diagnosis."""
    case, out = asked
    name = f"{case.parent.name}-{case.name}"
    file = out / "variants" / f"{name}.json"
    found = json.loads(file.read_text()) if file.is_file() else {"gains": {}, "seconds": {}}
    left = {what: make for what, make in VARIANTS.items() if what not in found["gains"]}
    if not left:
        return dict(found)
    file.parent.mkdir(exist_ok=True)
    store = DiagnosisStore(request_for(case, out / "stores" / name))
    record = json.loads((out / f"{name}.json").read_text())
    refits = [tuple(one["effects"]) for one in record["summary"]["refits"]]
    refits += [(effect,) for effect in record["unscreened"]]
    loaded = {names: store.load_joint_fit(store.combination(names)) for names in refits}
    fits = {names: one.fit for names, one in loaded.items() if one is not None}
    analysis = store.analysis
    for variant, make in left.items():
        begun = time.process_time()
        score = make(analysis)
        base = score(analysis.nominal)
        found["gains"][variant] = {"+".join(who): score(fit) - base for who, fit in fits.items()}
        found["seconds"][variant] = time.process_time() - begun
    found["hidden"] = sorted(analysis.hidden)
    file.write_text(json.dumps(found, indent=1, default=float))
    return found


def scored_with(
    analysis: NominalAnalysis, noise: LearntNoise, *, poses: bool = True, contours: bool = True
) -> Score:
    """Return Laplace's log evidence under a noise, with or without poses and contours."""
    inverse, factor = analysis.inverse, factored(noise.scatter)

    def score(fit: Fit) -> float:
        columns = [fit.pose_columns(inverse)] if poses else []
        columns += [noise.fixed] if contours else []
        return log_evidence(*linearised(fit, fit.residual(inverse), columns, factor))

    return score


def linearised(
    fit: Fit, residual: FloatArray, columns: Sequence[FloatArray], factor: FloatArray
) -> tuple[Linearised, Any, Any]:
    """Return a fit with further columns of unit deviation, its one-sided parameters and bounds."""
    u = fit.unknowns
    q = sum(block.shape[1] for block in columns)
    linear = Linearised(
        residual,
        np.hstack([fit.jacobian, *columns]),
        np.append(u.sd, np.ones(q)),
        np.append(fit.z - u.mean, np.zeros(q)),
        factor,
    )
    one_sided = np.append(u.one_sided, np.zeros(q, np.bool_))
    return linear, one_sided, np.append(fit.at_bound, np.zeros(q, np.int32))


def shipped(analysis: NominalAnalysis) -> Score:
    """Return the evidence as it is."""
    return lambda fit: fit.log_evidence(analysis.inverse)


def noise_of(analysis: NominalAnalysis) -> LearntNoise:
    """Return the learnt noise of a case."""
    if analysis.inverse.learnt is None:
        raise ValueError("these cases have segmented scans")
    return analysis.inverse.learnt


def stated(analysis: NominalAnalysis) -> Score:
    """Return the evidence with the noise as stated."""
    noise = noise_of(analysis)
    return scored_with(analysis, replace(noise, scales=np.ones_like(noise.scales)))


def without_numerics(analysis: NominalAnalysis) -> Score:
    """Return the evidence without a numerical error."""
    noise = noise_of(analysis)
    return scored_with(analysis, replace(noise, numerical=noise.numerical[:, :0]))


def without_either(analysis: NominalAnalysis) -> Score:
    """Return the evidence without a numerical error and without contour bias."""
    noise = noise_of(analysis)
    return scored_with(analysis, replace(noise, numerical=noise.numerical[:, :0]), contours=False)


def without_poses(analysis: NominalAnalysis) -> Score:
    """Return the evidence with all scans in their exact positions."""
    return scored_with(analysis, noise_of(analysis), poses=False)


def without_contours(analysis: NominalAnalysis) -> Score:
    """Return the evidence with all contours drawn without bias."""
    return scored_with(analysis, noise_of(analysis), contours=False)


def one_deviation(analysis: NominalAnalysis) -> Score:
    """Return the evidence with independent noise as large as the nominal residuals."""
    inverse = analysis.inverse
    sd = float(np.sqrt((analysis.nominal.residual(inverse) ** 2).mean()))
    factor = sd * np.eye(len(inverse.bias))
    return lambda fit: log_evidence(*linearised(fit, fit.residual(inverse), [], factor))


def criterion(analysis: NominalAnalysis) -> Score:
    """Return Schwarz's criterion, with the stated covariance scaled by the nominal residuals."""
    inverse, noise = analysis.inverse, noise_of(analysis)
    even = replace(noise, scales=np.ones_like(noise.scales))
    factor = factored(even.scatter)

    def misfit(fit: Fit) -> float:
        columns = [fit.pose_columns(inverse), noise.fixed]
        linear, _, bound = linearised(fit, fit.residual(inverse), columns, factor)
        linear = linear.holding(bound != 0)
        A, rho, offset = linear.scaled_nominal, linear.whitened_residual, linear.scaled_offset
        H, g = np.eye(A.shape[1]) + A.T @ A, A.T @ rho + offset
        return float(rho @ rho + offset @ offset - g @ np.linalg.solve(H, g))

    m = len(inverse.bias)
    variance = misfit(analysis.nominal) / m
    return lambda fit: -0.5 * (misfit(fit) / variance + len(fit.z) * float(np.log(m)))


def smallest_residual(analysis: NominalAnalysis) -> Score:
    """Return minus half of m log of the mean square distance: nothing but the residual."""
    m = len(analysis.inverse.bias)
    return lambda fit: -0.5 * m * float(np.log((fit.residual(analysis.inverse) ** 2).mean()))


VARIANTS: Mapping[str, Callable[[NominalAnalysis], Score]] = {
    SHIPPED: shipped,
    "noise as stated": stated,
    "stated covariance, nominal scale, BIC": criterion,
    "independent noise": one_deviation,
    "without poses": without_poses,
    "without contour bias": without_contours,
    "without numerical error": without_numerics,
    "without numerical error and contour bias": without_either,
    RESIDUAL: smallest_residual,
}


def table(judged: Sequence[Judged], scored: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    """Yield the lines of the table of variants."""
    yield "| evidence | first | controls alarmed | singles first | in full | CPU s of a case |"
    yield "|---|---|---|---|---|---|"
    pairs = list(zip(judged, scored, strict=True))
    first = SETTINGS.selection.first
    controls = [gains for one, gains in pairs if one.is_control]
    allowed = sum(best_gain(gains, SHIPPED) > first for gains in controls)
    for variant in VARIANTS:
        gains = sorted((best_gain(one, variant) for one in controls), reverse=True)
        least = first if variant == SHIPPED else max(gains[allowed], 0.0)
        yield row(variant, f"{least:.1f}", [(one, scored, least) for one, scored in pairs])
    sets = {one.set for one in judged}
    leasts = {name: threshold(pair for pair in pairs if pair[0].set != name) for name in sets}
    others = ", ".join(f"{least:.1f}" for _, least in sorted(leasts.items()))
    yield row(SHIPPED, others, [(one, scored, leasts[one.set]) for one, scored in pairs])


def threshold(pairs: Iterable[tuple[Judged, Mapping[str, Any]]]) -> float:
    """Return the least gain that one control of some sets exceeds, and no less than a tie."""
    gains = sorted((best_gain(scored, SHIPPED) for one, scored in pairs if one.is_control))
    return max([SETTINGS.selection.tie, *gains[-2:-1]])


def row(variant: str, first: str, pairs: Sequence[tuple[Judged, Mapping[str, Any], float]]) -> str:
    """Return the counts of one variant with each body's threshold as a row of the table."""
    named = [(one, named_by(gains, variant, least)) for one, gains, least in pairs]
    spent = np.mean([gains["seconds"][variant] for _, gains, _ in pairs])
    alarmed = [bool(names) for one, names in named if one.is_control]
    right = [names[:1] == one.truth for one, names in named if len(one.truth) == 1 and one.listed]
    full = [{*names} == {*one.truth} for one, names in named if one.truth and one.listed]
    return (
        f"| {variant} | {first} | {sum(alarmed)} of {len(alarmed)} | {sum(right)} of "
        f"{len(right)} | {sum(full)} of {len(full)} | {spent:.1f} |"
    )


def best_gain(scored: Mapping[str, Any], variant: str) -> float:
    """Return the gain of the best single effect that the constants do not hide."""
    hidden = set(scored["hidden"])
    gains = scored["gains"][variant]
    return max((g for who, g in gains.items() if "+" not in who and who not in hidden), default=0.0)


def named_by(scored: Mapping[str, Any], variant: str, first: float) -> tuple[str, ...]:
    """Return the effects named with a threshold for the first, and that of others in proportion."""
    gains = {tuple(who.split("+")): gain for who, gain in scored["gains"][variant].items()}
    ratio = SETTINGS.selection.further / SETTINGS.selection.first
    return selected(gains, scored["hidden"], ratio * first, first)


if __name__ == "__main__":
    main()
