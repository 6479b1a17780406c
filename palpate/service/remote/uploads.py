"""Upload of a study's images by the client, before the study is submitted."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palpate.service.remote.client import Client
from palpate.service.study.spec import StudySpec, read_spec
from palpate.storage.digest import file_digest
from palpate.storage.errors import InputError
from palpate.workers.input_files import check_regular
from palpate.workers.spec import validated

IMAGE_KEYS = ("volume", "file", "labels")


def with_uploaded_images(
    client: Client, study: str | Path | Mapping[str, Any] | StudySpec
) -> dict[str, Any]:
    """Upload the local images of a study; return its keys with the names of the uploads.

    A folder of uploads is named after the content of the image.

    Raises
    ------
    InputError
        If the study is not valid, or an image cannot be read.
    """
    if isinstance(study, Mapping):
        study = validated(StudySpec, study, "The study")
    spec = study if isinstance(study, StudySpec) else read_spec(Path(study))
    data = spec.as_dict()
    _upload(client, data)
    return data


def _upload(client: Client, data: dict[str, Any]) -> None:
    for key, value in data.items():
        if isinstance(value, dict):
            _upload(client, value)
        elif key in IMAGE_KEYS and isinstance(value, str) and Path(value).expanduser().exists():
            data[key] = _uploaded(client, Path(value).expanduser())


def _uploaded(client: Client, path: Path) -> str:
    check_regular(path)
    folder = f"image-{file_digest(path)}"
    if path.is_file():
        client.upload(path, folder)
        return f"{folder}/{path.name}"
    files = sorted(p for p in path.iterdir() if p.is_file() and not p.name.startswith("."))
    if not files:
        raise InputError(f"{path} has no images.")
    for file in files:
        client.upload(file, folder)
    return folder
