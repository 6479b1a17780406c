"""What a diagnosis said of a case, on paper: words and numbers as JSON, points as arrays."""

from typing import Any

import numpy as np

from service.blind.baselines import raw_correlation
from service.blind.seal import file_hash, write_json
from service.blind.sets import BlindSet, Directions, answer_hashes
from service.diagnosis.run import Found
from storage.arrays import Arrays
from storage.atomic import explained, replacing
from workers.casebook import Casebook, Request
from workers.effects.inclusion import INCLUSION

Json = dict[str, Any]
# What a score needs of the maps. Those with "after" are there where an effect is accused.
KEPT = (
    "points", "interface", "before", "after", "noise",
    "moved_before", "moved_after", "normals_before", "normals_after",
)  # fmt: skip


def write_answer(
    blind: BlindSet, name: str, directions: Directions, request: Request, found: Found, code: str
) -> None:
    """Keep what was found; the JSON is written last, so what has one is whole.

    Parameters
    ----------
    name : str
        Of the case.
    request : Request
        Of the diagnosis, whose parts the store still has.
    code : str
        Digest of the source that found it.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    book = Casebook(request)
    arrays: Any = {key: found.maps[key] for key in KEPT if key in found.maps}
    # What the mesh adds, which the diagnosis takes off its residuals.
    arrays["bias"] = book.load("calibration")[0]["bias"].reshape(found.maps["before"].shape)
    folder = blind.answers(directions)
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(blind.points(name, directions)) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)
    record = {
        "id": name,
        "code": code,
        "scans": found.scans,
        "summary": found.summary,
        "baselines": _baselines(book, found.maps),
        "centre_mm": _centre_mm(book),
    }
    write_json(blind.answer(name, directions), record)


def write_failure(
    blind: BlindSet, name: str, directions: Directions, reason: str, code: str
) -> None:
    """Keep that a case could not be diagnosed, and why: it counts as answered wrongly."""
    folder = blind.answers(directions)
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
        blind.points(name, directions).unlink(missing_ok=True)
    write_json(blind.answer(name, directions), {"id": name, "code": code, "failed": reason})


def seal_answers(
    blind: BlindSet, directions: Directions, names: list[str], diagnosis: Json, reason: str | None
) -> str:
    """Write the hashes of all answers; the hash of that file.

    Parameters
    ----------
    diagnosis : dict
        As it answered, see `service.blind.frozen.frozen`.
    reason : str or None
        Why it is not the one that the manifest names.
    """
    record = {
        "manifest": file_hash(blind.manifest),
        "directions": directions,
        "answers": {name: answer_hashes(blind, name, directions) for name in names},
        "diagnosis": diagnosis,
        "declared": reason,
    }
    return write_json(blind.sealed_answers(directions), record)


def _centre_mm(book: Casebook) -> list[float] | None:
    """Middle of the body, from which the place of a lump counts; None if none was refitted."""
    lump = [INCLUSION.name]
    if not (book.has("refit", lump) and book.told("refit", lump)["found"]):
        return None
    return [float(x) for x in book.built.frame.centre_mm]


def _baselines(book: Casebook, maps: Arrays) -> Json:
    """How each effect does without projection, and refitted alone; see the baselines."""
    residual = maps["before"]
    correlations, left = {}, {}
    for effect in book.request["effects"]:
        parts = [book.load("print", effect, scan) for scan in range(len(residual))]
        if all(told["acts"] for _, told in parts):
            columns = np.concatenate([arrays["columns"] for arrays, _ in parts], axis=-2)
            correlations[effect] = raw_correlation(columns, residual.ravel())
        if book.has("refit", [effect]) and book.told("refit", [effect])["found"]:
            refitted = book.load("refit", [effect])[0]["residual"]
            left[effect] = float(np.sqrt(np.mean(refitted**2)))
    return {"raw_correlation": correlations, "refit_left_mm": left}
