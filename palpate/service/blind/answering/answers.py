"""Answers of a diagnosis to a case: text and numbers as JSON, points as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.service.blind.answering.baselines import raw_correlation
from palpate.service.blind.sealed.seal import file_hash, write_json
from palpate.service.blind.sealed.sealed_settings import FrozenDiagnosis
from palpate.service.blind.sealed.sets import BlindSet, Directions, answer_hashes
from palpate.service.diagnosis.run import FinishedDiagnosis
from palpate.storage.backends.atomic import explained, replacing
from palpate.storage.records.typed_json import to_json
from palpate.storage.stores.arrays import Arrays
from palpate.storage.values import Triple
from palpate.workers.diagnosis.schema.summary import Summary
from palpate.workers.tasks.diagnosis_store import (
    CalibrationRecord,
    DiagnosisRequest,
    DiagnosisStore,
    JointFitRecord,
    SensitivityRecord,
)

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
    """Inputs to the simpler rules, by effect; see `service.blind.answering.baselines`.

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
    centre_mm : tuple of float or None
        Middle of the body, the origin of fitted positions; None in answers of earlier
        versions that fitted no lump.
    """

    id: str
    code: str
    scans: tuple[str, ...]
    summary: Summary
    baselines: Baselines
    centre_mm: Triple | None


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
        The diagnosis that answered; see `service.blind.sealed.sealed_settings`.
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
