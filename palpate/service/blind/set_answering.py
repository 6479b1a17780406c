"""Diagnosis of a sealed set, one worker per case, and sealing of the answers.

The diagnosis receives only the folder of a case. When fewer cases are left than half of the
workers, all workers diagnose the remaining cases one at a time. An answer is text and numbers as
JSON, and points as arrays.

An answer also holds what simple rules for naming a cause say, as baselines for the diagnosis:

1. The largest raw correlation: the effect with the fingerprint most nearly parallel to the
   residuals of the nominal model, at any place; nothing is whitened, and directions that the
   constants could hide are not projected out.
2. One refit at a time: the single effect that leaves the smallest distance between model and
   image when fitted together with the constants, regardless of its number of parameters.
3. Chance: any effect from the catalogue.

The first two always name an effect. For a fair comparison they are also scored with a threshold
below which they name no effect, chosen to raise as many false alarms as the diagnosis on bodies
without a missing effect.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.service.blind.diagnosed_case import (
    CASE_FILE,
    diagnose_alone,
    is_along_y,
    read_case_settings,
)
from palpate.service.blind.sealed_diagnosis import FrozenDiagnosis, differences, frozen
from palpate.service.blind.sealed_set import (
    BlindSet,
    Directions,
    answer_hashes,
    check_cases,
    file_hash,
    read_json,
    read_manifest,
    write_json,
)
from palpate.service.cluster.task_dispatch import Dispatcher, Ending
from palpate.service.diagnosis.diagnosis_run import (
    FinishedDiagnosis,
    finished,
    request_for,
    run_diagnosis,
)
from palpate.service.errors_and_interrupts import ClusterError, TaskError
from palpate.storage.backends.atomic_files import explained, replacing
from palpate.storage.backends.store_paths import Location
from palpate.storage.errors import InputError, StoreError
from palpate.storage.json_digests import to_json
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import Arrays
from palpate.storage.values import FloatArray, Triple
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.input_files import dump_yaml
from palpate.workers.tasks.diagnosis_store import (
    CalibrationRecord,
    DiagnosisRequest,
    DiagnosisStore,
    JointFitRecord,
    SensitivityRecord,
)


def raw_correlation(columns: FloatArray, residual: FloatArray) -> float:
    """Return the largest cosine between the residuals and any column of a fingerprint.

    Parameters
    ----------
    columns : ndarray, shape (m, q) or (g, m, q)
        Derivatives of the residuals, in mm per unit; a stack for an effect with g places.
    residual : ndarray, shape (m,)
        In mm.

    Returns
    -------
    float
        From 0 to 1; 0 if the residual or all columns vanish.
    """
    length = np.linalg.norm(columns, axis=-2) * np.linalg.norm(residual)
    along = np.abs(np.einsum("...mq,m->...q", columns, residual))
    return float(np.max(along[length > 0] / length[length > 0], initial=0.0))


def largest_correlation(correlations: Mapping[str, float]) -> str | None:
    """Return the effect named by the first baseline; None without fingerprints."""
    return max(correlations, key=lambda name: correlations[name]) if correlations else None


def closest_refit(left_mm: Mapping[str, float]) -> str | None:
    """Return the effect named by the second baseline; None without refits.

    Parameters
    ----------
    left_mm : mapping of str to float
        Root mean square residual of each single refit.
    """
    return min(left_mm, key=lambda name: left_mm[name]) if left_mm else None


def refit_improvement(left_mm: Mapping[str, float], before_mm: float) -> float:
    """Return the second baseline's evidence: the log of the reduction by its best refit.

    Parameters
    ----------
    left_mm : mapping of str to float
        As in `closest_refit`.
    before_mm : float
        Root mean square residual of the nominal model.
    """
    least = min(left_mm.values(), default=before_mm)
    return float(np.log(before_mm / least)) if least > 0 and before_mm > 0 else 0.0


def baseline_threshold(silent: Sequence[float], alarms: int) -> float:
    """Return the evidence that a baseline must exceed to name an effect.

    Parameters
    ----------
    silent : sequence of float
        Its evidence on each body without a missing effect.
    alarms : int
        Number of these bodies for which an effect may be named; more only in case of ties.
    """
    ranked = sorted(silent, reverse=True)
    return ranked[alarms] if alarms < len(ranked) else -np.inf


# Maps needed for a score. Those with "after" exist only if an effect is named.
KEPT = (
    "points",
    "interface",
    "before",
    "after",
    "noise",
    "moved_before",
    "moved_after",
    "normals_before",
    "normals_after",
)


@dataclass(frozen=True, slots=True)
class Baselines:
    """Inputs to the simpler rules, by effect; see `service.blind.set_answering`.

    Parameters
    ----------
    raw_correlation : mapping of str to float
        Correlation of its columns with the residuals, without projection.
    refit_left_mm : mapping of str to float
        Root mean square residual after its joint fit.
    """

    raw_correlation: Mapping[str, float]
    refit_left_mm: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer of a diagnosis to a case.

    Parameters
    ----------
    id : str
        Identifier of the case.
    code : str
        Digest of the source code of the diagnosis.
    scans : tuple of str
        Names of the loaded scans.
    summary : Summary
    baselines : Baselines
    centre_mm : tuple of float
        Middle of the body, about which scans are scaled, sheared or turned.
    """

    id: str
    code: str
    scans: tuple[str, ...]
    summary: Summary
    baselines: Baselines
    centre_mm: Triple


def write_answer(
    blind: BlindSet,
    name: str,
    directions: Directions,
    request: DiagnosisRequest,
    diagnosis: FinishedDiagnosis,
    code: str,
) -> None:
    """Write an answer; the JSON is written last, so an answer with a JSON file is complete.

    Parameters
    ----------
    name : str
        Name of the case.
    request : DiagnosisRequest
        Request of the diagnosis, whose parts are still in the store.
    code : str
        Digest of the source code of the diagnosis.

    Raises
    ------
    StoreError
        If the answer cannot be written.
    """
    store, maps = DiagnosisStore(request), diagnosis.maps
    arrays: Any = {key: maps[key] for key in KEPT if key in maps}
    # The mesh error, which the diagnosis subtracts from its residuals.
    _, calibrated = store.calibration.load(CalibrationRecord)
    arrays["bias"] = calibrated["bias"].reshape(maps["before"].shape)
    arrays["pressed"] = calibrated["noise_pressed"]
    folder = blind.answers(directions)
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(blind.points(name, directions)) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)
    baselines, centre_mm = _baselines(store, maps), _centre_mm(store)
    answer = Answer(name, code, diagnosis.scans, diagnosis.summary, baselines, centre_mm)
    write_json(blind.answer(name, directions), to_json(answer))


def write_failure(
    blind: BlindSet, name: str, directions: Directions, reason: str, code: str
) -> None:
    """Write the reason why a diagnosis failed, which counts as a wrong answer."""
    folder = blind.answers(directions)
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
        blind.points(name, directions).unlink(missing_ok=True)
    write_json(blind.answer(name, directions), {"id": name, "code": code, "failed": reason})


def seal_answers(
    blind: BlindSet,
    directions: Directions,
    names: list[str],
    diagnosis: FrozenDiagnosis,
    reason: str | None,
) -> str:
    """Write the hashes of all answers, and return the hash of that file.

    Parameters
    ----------
    diagnosis : FrozenDiagnosis
        The diagnosis that answered; see `service.blind.sealed_diagnosis`.
    reason : str or None
        Why it differs from the one in the manifest.
    """
    record = {
        "manifest": file_hash(blind.manifest),
        "directions": directions,
        "answers": {name: answer_hashes(blind, name, directions) for name in names},
        "diagnosis": to_json(diagnosis),
        "declared": reason,
    }
    return write_json(blind.sealed_answers(directions), record)


def _centre_mm(store: DiagnosisStore) -> Triple:
    x, y, z = store.uncalibrated.frame.centre_mm
    return float(x), float(y), float(z)


def _baselines(store: DiagnosisStore, maps: Arrays) -> Baselines:
    residual = maps["before"]
    correlations, left = {}, {}
    for effect in store.request.effects:
        scans = range(len(residual))
        parts = [store.sensitivity(effect, scan).load(SensitivityRecord) for scan in scans]
        if all(record.acts for record, _ in parts):
            columns = np.concatenate([arrays["columns"] for _, arrays in parts], axis=-2)
            correlations[effect] = raw_correlation(columns, residual.ravel())
        if _is_fitted(store, effect):
            _, arrays = store.joint_fit([effect]).load(JointFitRecord)
            left[effect] = float(np.sqrt(np.mean(arrays["residual"] ** 2)))
    return Baselines(correlations, left)


def _is_fitted(store: DiagnosisStore, effect: str) -> bool:
    part = store.joint_fit([effect])
    return part.is_finished and part.record(JointFitRecord).simulated


Tell = Callable[[str], object]


@dataclass(frozen=True)
class Answering:
    """Settings for answering a set.

    Parameters
    ----------
    blind : BlindSet
    store : str or Path
        A store shared by all workers.
    directions : {"all", "y"}
        Scans given to the diagnosis: all, or those pressed along y.
    nodes : int
        Number of nodes of the mesh.
    limit : int or None
        Maximum number of cases to answer in this call.
    declared : str or None
        Why the diagnosis differs from the sealed one.
    """

    blind: BlindSet
    store: Location
    directions: Directions
    nodes: int
    limit: int | None = None
    declared: str | None = None


def unanswered(answering: Answering) -> list[str]:
    """Check the seals of the set, and return the cases without an answer.

    Raises
    ------
    InputError
        If a case has changed, the diagnosis has changed without a declared reason, or there
        are answers from other code.
    """
    blind = answering.blind
    manifest = read_manifest(blind)
    check_cases(blind, manifest)
    now = frozen(answering.nodes)
    changed = differences(manifest["diagnosis"], now)
    if changed and not answering.declared:
        raise InputError(
            f"The diagnosis is not the one that {blind.manifest} was sealed for: "
            f"{', '.join(changed)} changed. Answer with that one, make a new set, or give a reason "
            'with --declare "...", which is shown with the score.'
        )
    names = sorted(manifest["cases"])
    answered = [n for n in names if blind.answer(n, answering.directions).is_file()]
    others = [n for n in answered if _code(answering, n) != now.code]
    if others:
        raise InputError(
            f"{blind.answers(answering.directions)} has answers from other code: "
            f"{', '.join(others)}. "
            "Answer a set with one version: go back to that version, or remove these answers."
        )
    return [n for n in names if n not in answered]


def answer(answering: Answering, names: Sequence[str], dispatcher: Dispatcher, tell: Tell) -> None:
    """Diagnose cases and write the answers.

    Parameters
    ----------
    names : sequence of str
        As returned by `unanswered`; the limit applies.
    tell : callable
        Called for each case with an empty text, or the reason for its failure.

    Raises
    ------
    StoreError
        If the store or the set cannot be written.
    ClusterError
        If the workers cannot do the work; completed answers are kept.
    Interrupted
        If the dispatcher is stopped.
    """
    chosen = list(names[: answering.limit])
    workers = max(1, dispatcher.threads)
    rest = len(chosen) % workers
    together = rest if 2 * rest < workers else 0
    whole, last = chosen[: len(chosen) - together], chosen[len(chosen) - together :]
    code = frozen(answering.nodes).code
    for name, request, failed in _whole(answering, whole, dispatcher):
        _keep(answering, name, request, failed, code)
        tell(failed)
    for name in last:
        asking, failed = _one(answering, name, dispatcher)
        _keep(answering, name, asking, failed, code)
        tell(failed)


def seal(answering: Answering) -> str | None:
    """Seal the answers if they are complete, and return the hash of the seal, or None."""
    if unanswered(answering):
        return None
    path = answering.blind.sealed_answers(answering.directions)
    manifest = read_manifest(answering.blind)
    now = frozen(answering.nodes)
    reason = answering.declared if differences(manifest["diagnosis"], now) else None
    if path.is_file():
        return file_hash(path)
    return seal_answers(
        answering.blind, answering.directions, sorted(manifest["cases"]), now, reason
    )


def request_of(answering: Answering, name: str) -> DiagnosisRequest:
    """Return the request of the diagnosis: the folder of a case, or of its scans along y.

    Raises
    ------
    InputError
        If the folder cannot be diagnosed.
    StoreError
        If the store cannot be used.
    """
    folder = answering.blind.case(name)
    if answering.directions == "y":
        root = open_store(answering.store).root
        copies = root if isinstance(root, Path) else answering.blind.root  # buckets lack folders
        folder = along_y(folder, copies / "along-y" / name)
    return request_for(folder, answering.store, answering.nodes)


def along_y(case: Path, copy: Path) -> Path:
    """Copy a case without the scans that are pressed along an axis other than y.

    Raises
    ------
    InputError
        If no scan is left.
    StoreError
        If the copy cannot be written.
    """
    said = read_case_settings(case)
    scans = said["scans"]
    kept = [load for load in scans["loads"] if is_along_y(load)]
    if not kept:
        raise InputError(f"{case} has no scan pressed along y: answer it with --directions all.")
    said["scans"] = scans | {"loads": kept}
    with explained(copy):
        copy.mkdir(parents=True, exist_ok=True)
        for file in [scans["reference"], *(load["volume"] for load in kept)]:
            shutil.copy2(case / file, copy / file)
        (copy / CASE_FILE).write_text(dump_yaml(said), encoding="utf-8")
    return copy


def _whole(
    answering: Answering, names: Sequence[str], dispatcher: Dispatcher
) -> Iterator[tuple[str, DiagnosisRequest | None, str]]:
    """Yield cases in order of arrival: the name, the request, and the reason for a failure."""
    requests: dict[str, DiagnosisRequest] = {}
    refused: dict[str, str] = {}

    def calls() -> Iterator[tuple[str, tuple[DiagnosisRequest]]]:
        for name in names:
            try:
                requests[name] = request_of(answering, name)
            except InputError as error:
                refused[name] = _sentence(error)
                continue
            yield name, (requests[name],)

    for ending in dispatcher.run(diagnose_alone, calls()):
        yield ending.key, requests.pop(ending.key), _reason(ending)
    for name, why in refused.items():
        yield name, None, why


def _reason(ending: Ending) -> str:
    if ending.kind == "lost":
        raise ClusterError(
            f"The case {ending.key} was lost: {ending.reason}. Give the workers more memory, or "
            "start fewer with --workers; run the same command again to continue."
        )
    return ending.reason if ending.kind != "returned" else ""


def _one(
    answering: Answering, name: str, dispatcher: Dispatcher
) -> tuple[DiagnosisRequest | None, str]:
    """Diagnose with all workers; return the request, and the reason for a failure."""
    try:
        request = request_of(answering, name)
        run_diagnosis(request, dispatcher)
    except (InputError, TaskError) as error:
        return None, _sentence(error)
    return request, ""


def _sentence(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _keep(
    answering: Answering, name: str, request: DiagnosisRequest | None, failed: str, code: str
) -> None:
    if failed or request is None:
        write_failure(answering.blind, name, answering.directions, failed, code)
        return
    diagnosis = finished(request)
    if diagnosis is None:
        raise StoreError(
            f"The case {name} is diagnosed, but {request.store} does not contain it. Give a "
            "--store that is shared by workers and driver."
        )
    write_answer(answering.blind, name, answering.directions, request, diagnosis, code)


def _code(answering: Answering, name: str) -> str:
    return str(read_json(answering.blind.answer(name, answering.directions)).get("code"))
