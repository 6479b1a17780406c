"""The settings of a case of a blind set, which name its scans."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palpate.storage.errors import InputError
from palpate.workers.documents import parse_yaml
from palpate.workers.old_names import with_current_names

NAME = "case.yaml"
ALONG_Y = ("y", [0, 1, 0])


def read_case_settings(case: Path) -> dict[str, Any]:
    """Read the settings in a case file.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    path = case / NAME
    try:
        settings = with_current_names(parse_yaml(path.read_text(encoding="utf-8"), str(path)))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read: {error}.") from error
    return settings


def is_along_y(load: Mapping[str, Any]) -> bool:
    """Return True if a loaded scan was compressed along y, the default."""
    return load.get("axis", "y") in ALONG_Y
