"""Diagnosis of a sealed set, one worker per case, and sealing of the answers.

The diagnosis receives only the folder of a case. When fewer cases are left than half of the
workers, all workers diagnose the remaining cases one at a time.
"""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from palpate.service.blind.answering.answers import seal_answers, write_answer, write_failure
from palpate.service.blind.answering.single_process import diagnose_alone
from palpate.service.blind.sealed.case_file import NAME as CASE_FILE
from palpate.service.blind.sealed.case_file import is_along_y, read_case_settings
from palpate.service.blind.sealed.seal import file_hash, read_json
from palpate.service.blind.sealed.sealed_settings import differences, frozen
from palpate.service.blind.sealed.sets import BlindSet, Directions, check_cases, read_manifest
from palpate.service.cluster.dispatch import Dispatcher, Ending
from palpate.service.diagnosis.run import finished, request_for, run
from palpate.service.errors import ClusterError, TaskError
from palpate.storage.backends.atomic import explained
from palpate.storage.backends.places import Location
from palpate.storage.errors import InputError, StoreError
from palpate.storage.stores.store import open_store
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest

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
        (copy / CASE_FILE).write_text(yaml.safe_dump(said, sort_keys=False), encoding="utf-8")
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
        run(request, dispatcher)
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
    found = finished(request)
    if found is None:
        raise StoreError(
            f"The case {name} is diagnosed, but {request.store} does not contain it. Give a "
            "--store that is shared by workers and driver."
        )
    write_answer(answering.blind, name, answering.directions, request, found, code)


def _code(answering: Answering, name: str) -> str:
    return str(read_json(answering.blind.answer(name, answering.directions)).get("code"))
