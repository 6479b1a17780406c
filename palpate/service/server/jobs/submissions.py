"""Checks of submitted studies and diagnoses before they are queued."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from palpate.service.server.jobs.limits import Limits
from palpate.service.server.jobs.uploads import Uploads
from palpate.service.server.jobs.yaml import DEEPEST, depth_of, parsed_text, refuse_paths, texts
from palpate.service.study.spec import StudySpec, parse_spec
from palpate.storage.errors import InputError, StoreError
from palpate.storage.stores.store import Store
from palpate.storage.stores.volumes import has_volume, list_volumes, volume_meta

WHERE = "The study"
IMAGE_KEYS = {"volume", "file", "labels"}


def study_from(
    given: str | Mapping[str, Any], uploads: Uploads, store: Store, limits: Limits
) -> StudySpec:
    """Return the study requested by a client.

    Parameters
    ----------
    given : str or mapping
        The text of a study file, or its keys. Images are uploads, named FOLDER/FILE, or
        volumes in the store.

    Raises
    ------
    InputError
        If it is not valid, names files of the server, or is too large.
    """
    if isinstance(given, str):
        text, data = given, parsed_text(given, WHERE)
    else:
        if depth_of(given) > DEEPEST:
            raise InputError(f"{WHERE} is nested too deeply.")
        data = dict(given)
        text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
    refuse_paths(data, WHERE)
    try:
        spec = parse_spec(text, WHERE, uploads.root)
    except InputError:
        raise
    except Exception as error:  # from dates, numbers with a thousand digits, ...
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"{WHERE} is not valid YAML: {reason}") from error
    _check_images(spec, uploads, store)
    _check_size(spec, limits)
    return spec


def _check_images(spec: StudySpec, uploads: Uploads, store: Store) -> None:
    for key, value in texts(spec.as_dict()):
        if key.rpartition(".")[2] not in IMAGE_KEYS:
            continue
        path = Path(value)
        uploaded = path.is_absolute() and path.resolve().is_relative_to(uploads.root.resolve())
        if not (uploaded and path.exists()) and not _in_store(value, store):
            raise InputError(
                f"{WHERE}: {key} is {value!r}, which is neither an upload (FOLDER/FILE) nor a "
                "volume in the store. Upload the image first."
            )


def _in_store(name: str, store: Store) -> bool:
    """Check whether the store has a volume with this digest or name."""
    with suppress(StoreError):  # not the name of a volume
        if has_volume(store, name):
            return True
    for volume in list_volumes(store):
        with suppress(StoreError):  # damaged
            if volume_meta(store, volume).get("name") == name:
                return True
    return False


def _check_size(spec: StudySpec, limits: Limits) -> None:
    search = spec.search
    if search.population > limits.population:
        raise InputError(
            f"{WHERE}: search.population is {search.population}; this service accepts up to "
            f"{limits.population}."
        )
    evaluations = search.population * search.generations
    if evaluations > limits.evaluations:
        raise InputError(
            f"{WHERE} requests up to {evaluations} evaluations; this service accepts up to "
            f"{limits.evaluations}."
        )
