"""The files of a blind set, and the hashes that seal them.

::

    SET/manifest.json          hashes of all cases and truths, and the diagnosis at that time
    SET/cases/<id>/            the input of a diagnosis
    SET/answers/<id>.json      its answer, and <id>.npz: final positions of its points
    SET/answers.json           hashes of all answers
    SET-truth/plan.json        seeds, kinds and salts
    SET-truth/<id>/            truth.json, truth.npz

Nothing in SET reveals the kind of a case: names are random, cases are in the order of their
names, and the truth is stored elsewhere. Answers for the scans pressed along y alone are in
``answers-y`` and ``answers-y.json``.

The hashes can be checked with ``sha256sum``::

    of a folder          sha256 of the output of `sha256sum *` in it (with LC_ALL=C)
    of a truth           sha256 of its salt, 32 random bytes, followed by the hash of its folder
                         as text

A salted hash reveals nothing about the truth before it is opened, although there are few enough
truths to try them one by one.
"""

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict, cast

from palpate.storage.backends.atomic_files import write_file
from palpate.storage.errors import InputError
from palpate.storage.json_digests import to_plain
from palpate.workers.input_files import parse_json

SALT_BYTES = 32


def new_salt() -> str:
    """Draw a salt in hexadecimal digits."""
    return secrets.token_hex(SALT_BYTES)


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(
            f"Cannot read {path}: {error.strerror or error}. A sealed set must be complete."
        ) from error


def folder_hash(folder: Path) -> str:
    """Return the SHA-256 of names and content of the files in a folder, except hidden ones.

    Raises
    ------
    InputError
        If the folder is missing or a file cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is missing. A sealed set must be complete.")
    names = sorted(p.name for p in folder.iterdir() if p.is_file() and p.name[0] != ".")
    lines = (f"{file_hash(folder / name)}  {name}\n" for name in names)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def salted_hash(salt: str, folder: Path) -> str:
    """Return the sealed hash of a truth.

    Parameters
    ----------
    salt : str
        See `new_salt`.
    folder : Path
        Folder of the truth.
    """
    content = folder_hash(folder).encode()
    return hashlib.sha256(bytes.fromhex(salt) + content).hexdigest()


def write_json(path: Path, record: Mapping[str, Any]) -> str:
    """Write a record with sorted keys and return the hash of the file."""
    text = json.dumps(to_plain(record), indent=1, sort_keys=True, allow_nan=False)
    write_file(path, text.encode() + b"\n")
    return file_hash(path)


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON record.

    Raises
    ------
    InputError
        If it cannot be read, or is not a record.
    """
    try:
        record = parse_json(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror or error}.") from error
    if not isinstance(record, dict):
        raise InputError(
            f"{path} does not contain a record: found {type(record).__name__}, expected {{..}}."
        )
    return record


Directions = Literal["all", "y"]


class CaseHashes(TypedDict):
    """Hashes of the folder of a case, and of its salted truth."""

    case: str
    truth: str


class Manifest(TypedDict):
    """The seal of a new set: every case, and the diagnosis at that time."""

    cases: dict[str, CaseHashes]
    diagnosis: dict[str, Any]


class AnswerHashes(TypedDict):
    """Hashes of the answer to a case; ``npz`` is None if the diagnosis failed."""

    json: str
    npz: str | None


class SealedAnswers(TypedDict):
    """The seal of an answered set.

    ``manifest`` is the hash of the set, ``diagnosis`` the one that answered, ``declared`` the
    reason if it differs from the one in the manifest.
    """

    manifest: str
    directions: Directions
    answers: dict[str, AnswerHashes]
    diagnosis: dict[str, Any]
    declared: str | None


class PlannedCase(TypedDict):
    """A planned case: its name, seed and kind, and the salt of its truth."""

    id: str
    seed: int
    kind: str
    salt: str


@dataclass(frozen=True)
class BlindSet:
    """Paths of a set.

    Parameters
    ----------
    root : Path
    """

    root: Path

    @property
    def manifest(self) -> Path:
        """Return the path of the manifest."""
        return self.root / "manifest.json"

    @property
    def cases(self) -> Path:
        """Return the folder with one folder per case."""
        return self.root / "cases"

    def case(self, name: str) -> Path:
        """Return the folder of one case."""
        return self.cases / name

    def answers(self, directions: Directions) -> Path:
        """Return the folder of answers."""
        return self.root / _suffixed("answers", directions)

    def answer(self, name: str, directions: Directions) -> Path:
        """Return the path of the answer to one case."""
        return self.answers(directions) / f"{name}.json"

    def points(self, name: str, directions: Directions) -> Path:
        """Return the path of the final positions of one case's points."""
        return self.answers(directions) / f"{name}.npz"

    def sealed_answers(self, directions: Directions) -> Path:
        """Return the path of the hashes of all answers."""
        return self.root / f"{_suffixed('answers', directions)}.json"

    def truth_beside(self) -> Path:
        """Return the default folder of the truths."""
        root = self.root.absolute()
        return root.with_name(f"{root.name}-truth")


@dataclass(frozen=True)
class Truths:
    """Paths of the truths, which no diagnosis receives."""

    root: Path

    @property
    def plan(self) -> Path:
        """Return the path of the seeds, kinds and salts."""
        return self.root / "plan.json"

    def of(self, name: str) -> Path:
        """Return the folder of one truth."""
        return self.root / name


def read_manifest(blind: BlindSet) -> Manifest:
    """Read the manifest of a set.

    Raises
    ------
    InputError
        If the set is not finished.
    """
    if not blind.manifest.is_file():
        raise InputError(
            f"{blind.root} is not a sealed set: it has no {blind.manifest.name}. Make one with "
            f"`palpate blind make {blind.root}`; the same command completes an unfinished one."
        )
    record = read_json(blind.manifest)
    if not isinstance(record.get("cases"), dict) or not isinstance(record.get("diagnosis"), dict):
        raise InputError(f"{blind.manifest} is not a manifest: expected `cases` and `diagnosis`.")
    return cast(Manifest, record)


def check_cases(blind: BlindSet, manifest: Manifest) -> None:
    """Compare every case with the manifest.

    Raises
    ------
    InputError
        If cases are missing, added or changed; the message names them.
    """
    sealed = manifest["cases"]
    there = {p.name for p in blind.cases.iterdir() if p.is_dir() and p.name[0] != "."}
    missing, added = sorted(sealed.keys() - there), sorted(there - sealed.keys())
    same = sorted(there & sealed.keys())
    changed = [name for name in same if folder_hash(blind.case(name)) != sealed[name]["case"]]
    what = {"missing": missing, "added": added, "changed": changed}
    differences = "; ".join(f"{word}: {', '.join(names)}" for word, names in what.items() if names)
    if differences:
        raise InputError(
            f"{blind.cases} does not match {blind.manifest.name} ({differences}). Restore it, "
            "or make a new set."
        )


def check_truths(truths: Truths, manifest: Manifest) -> None:
    """Compare every truth and its salt with the manifest.

    Raises
    ------
    InputError
        If truths are missing or changed; the message names them.
    """
    plan = read_json(truths.plan)
    salts = {entry["id"]: entry["salt"] for entry in plan["cases"]}
    wrong = [
        name
        for name, sealed in sorted(manifest["cases"].items())
        if name not in salts or salted_hash(salts[name], truths.of(name)) != sealed["truth"]
    ]
    if wrong:
        raise InputError(
            f"{truths.root} does not have the sealed truth of {', '.join(wrong)}. Give the "
            "unchanged folder that was made with the set, with --truth."
        )


def check_answers(blind: BlindSet, directions: Directions) -> SealedAnswers:
    """Read the sealed answers, and compare them with the manifest and the answer files.

    Raises
    ------
    InputError
        If answers are missing or changed, or belong to another set.
    """
    path = blind.sealed_answers(directions)
    if not path.is_file():
        raise InputError(
            f"{blind.root} has no {path.name}: not all cases are answered. Continue with "
            f"`palpate blind run {blind.root} --directions {directions}`."
        )
    record = cast(SealedAnswers, read_json(path))
    if record["manifest"] != file_hash(blind.manifest):
        raise InputError(f"{path} belongs to a different manifest from {blind.manifest}.")
    wrong = [
        name
        for name, hashes in sorted(record["answers"].items())
        if hashes != answer_hashes(blind, name, directions)
    ]
    if wrong:
        raise InputError(
            f"Answers have changed since they were sealed in {path}: {', '.join(wrong)}. Restore "
            "them; a second run needs a new set."
        )
    return record


def answer_hashes(blind: BlindSet, name: str, directions: Directions) -> AnswerHashes:
    """Return the hashes of the answer to a case."""
    points = blind.points(name, directions)
    return {
        "json": file_hash(blind.answer(name, directions)),
        "npz": file_hash(points) if points.is_file() else None,
    }


def _suffixed(word: str, directions: Directions) -> str:
    return word if directions == "all" else f"{word}-{directions}"
