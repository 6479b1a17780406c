"""Files that name the labels of an image.

======================  ===========================================================
``.txt`` ``.label``     ITK-SNAP: ``IDX R G B A VIS MESH "NAME"``
``.ctbl`` ``.txt``      colour table of 3D Slicer: ``IDX NAME R G B A``
``.json``               ``{"NAME": 1}``, ``{"1": "NAME"}``, or either under ``labels``
                        (nnU-Net and TotalSegmentator)
======================  ===========================================================
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palpate.storage.errors import InputError
from palpate.workers.documents import parse_json
from palpate.workers.input_files import read_text

_ITK_SNAP = re.compile(r'(-?\d+)\s+\d+\s+\d+\s+\d+\s+[\d.]+\s+[01]\s+[01]\s+"(.*)"')
_SLICER = re.compile(r"(-?\d+)\s+(\S+)\s+\d+\s+\d+\s+\d+\s+\d+")


def read_label_file(path: Path) -> dict[int, str]:
    """Return the name of each label in a file.

    Raises
    ------
    InputError
        If the file cannot be read, or has an unknown format.
    """
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{path} cannot be read as a file of label names: {reason}. Give a label description "
            'file of ITK-SNAP, a .ctbl of 3D Slicer or a .json such as {"fat": 1}.'
        ) from error
    return _of_json(text, path) if path.suffix.lower() == ".json" else _of_lines(text, path)


def _of_lines(text: str, path: Path) -> dict[int, str]:
    names: dict[int, str] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        match = _ITK_SNAP.fullmatch(line) or _SLICER.fullmatch(line)
        if match is None:
            raise InputError(
                f"{path}, line {number}: found {line[:60]!r}, expected a label in the format of "
                "ITK-SNAP, such "
                'as 1 255 0 0 1 1 1 "Fat", or of 3D Slicer, such as 1 Fat 255 0 0 255.'
            )
        label, name = int(match[1]), match[2]
        name = name if match.re is _ITK_SNAP else name.replace("_", " ")
        if label in names:
            raise InputError(f"{path}, line {number}: label {label} is named twice. Keep one name.")
        names[label] = name.strip()
    return _some(names, path)


def _of_json(text: str, path: Path) -> dict[int, str]:
    data: Any = parse_json(text, str(path))
    if isinstance(data, Mapping) and isinstance(data.get("labels"), Mapping):
        data = data["labels"]
    pairs = list(data.items()) if isinstance(data, Mapping) else []
    names: dict[int, str] = {}
    for key, value in pairs:
        by_name = isinstance(value, int) and not isinstance(value, bool)
        label, name = (value, key) if by_name else (key, value)
        if not (isinstance(name, str) and re.fullmatch(r"-?\d+", str(label))):
            raise InputError(
                f'{path} has the entry {key!r}: {value!r}, expected an entry such as "fat": 1 or '
                '"1": "fat".'
            )
        if int(label) in names:
            raise InputError(f"{path} names label {label} twice. Keep one name.")
        names[int(label)] = name.strip()
    return _some(names, path)


def _some(names: dict[int, str], path: Path) -> dict[int, str]:
    if not names:
        raise InputError(
            f"{path} contains no label names. Give a label description file of ITK-SNAP, a .ctbl "
            "of 3D "
            'Slicer or a .json such as {"fat": 1}.'
        )
    return names
