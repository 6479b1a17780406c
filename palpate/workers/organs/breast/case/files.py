"""Files of a case: its settings, the scan at rest and the scans under load.

::

    case.yaml           loads, nominal model and noise; see `CaseFile`. Or case.json, the same
                        as JSON
    reference.nrrd      labels of the body at rest; an optional second segmentation measures
                        the noise
    deformed_40N.nrrd   labels between the plates, one file for each load and direction

Only this module opens the files of a case; all others receive their content.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.body.images.labels import crop_to_body
from palpate.workers.body.images.largest_component import in_air, one_body
from palpate.workers.documents import parse_json, parse_yaml
from palpate.workers.input_files import read_text
from palpate.workers.old_names import with_current_names
from palpate.workers.organs.breast.case.alignment import aligned_case
from palpate.workers.organs.breast.case.images import CaseImages, StoredVolume, no_store
from palpate.workers.organs.breast.case.scanned_case import ScannedCase, above_wall
from palpate.workers.organs.breast.case.source import PlannedCaseSource, ScannedCaseSource
from palpate.workers.organs.breast.case.spec import CaseFile
from palpate.workers.organs.breast.case.table import understood
from palpate.workers.spec import validated

# The first of these that a folder contains is the case.
CASE_FILES = ("case.yaml", "case.json")
YAML = (".yaml", ".yml")
# A key of the form read by earlier versions.
PROSE_KEY = "nominal"


def read_case(path: Path, *, loaded: bool = True, stored: StoredVolume = no_store) -> ScannedCase:
    """Read a case and its scans.

    Parameters
    ----------
    path : Path
        The file of a case, or its folder.
    loaded : bool
        If False, only the scan at rest is read; the loaded scans need not exist.
    stored : callable
        Returns the volume of a given name in the store, or None.

    Raises
    ------
    InputError
        If a file is missing, or a key of the case is missing, unknown or invalid.
    """
    path = case_file(path)
    file = read_case_file(path)
    scans, tissues = file.scans, CaseImages(path, file.scans, stored).tissues
    case = ScannedCase(
        file,
        _scan(file, tissues(scans.reference)),
        _scan(file, tissues(scans.reference_repeat)) if scans.reference_repeat else None,
        [_one_body(tissues(load.volume)) for load in scans.loads] if loaded else [],
        str(path),
    )
    return aligned_case(case) if loaded and scans.align is not None else case


def case_file(path: Path) -> Path:
    """Return the file of a case, from the file itself or its folder.

    Raises
    ------
    InputError
        If there is none.
    """
    if path.is_file():
        return path
    for name in CASE_FILES:
        if (path / name).is_file():
            return path / name
    raise InputError(
        f"{path} is not a case: it has neither {' nor '.join(CASE_FILES)}. `palpate new diagnosis "
        "NAME` writes one."
    )


def read_case_file(path: Path) -> CaseFile:
    """Return the settings of a case.

    Raises
    ------
    InputError
        If it cannot be read, or has an invalid key.
    """
    data = _data(path)
    if PROSE_KEY in data:
        raise InputError(
            f"{path} describes its physics in sentences under {PROSE_KEY!r}, a form that is no "
            "longer read. Write the same settings as keys with units in case.yaml: `palpate new "
            "diagnosis NAME` writes a template, and docs/reference/keys.md lists all keys."
        )
    return validated(CaseFile, with_current_names(data, str(path)), str(path))


def _data(path: Path) -> Mapping[str, Any]:
    try:
        text = read_text(path)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file: {error}.") from error
    data = parse_yaml(text, str(path)) if path.suffix in YAML else parse_json(text, str(path))
    if not isinstance(data, Mapping):
        raise InputError(f"{path} is not a case: expected keys such as scans, found {text[:40]!r}.")
    return data


def _scan(file: CaseFile, tissues: Volume) -> Volume:
    """Return a scan at rest as one body of `Tissue` labels, in air and above the chest wall.

    A loaded scan keeps the tissue below the wall: a wall that gives way lets tissue move there,
    and a cut would be mistaken for skin.
    """
    wall_mm = file.wall.z_mm
    return _one_body(tissues if wall_mm is None else above_wall(tissues, wall_mm))


def _one_body(tissues: Volume) -> Volume:
    # Cropped first: the air around the body need not be searched for specks and holes.
    return in_air(one_body(crop_to_body(tissues, margin_voxels=0)))


class CaseReader:
    """See `workers.organs.source_registry.Reader`."""

    plans = True

    def knows(self, path: Path) -> bool:
        """Return True if a path is the file of a case, or a folder that contains one."""
        if path.is_dir():
            return any((path / name).is_file() for name in CASE_FILES)
        if not path.is_file() or path.suffix not in (*YAML, ".json"):
            return False
        try:
            data = _data(path)
        except InputError:
            # Only cases are JSON: reading it reports the error.
            return path.suffix == ".json"
        return PROSE_KEY in data or data.get("organ") == "breast" or "scans" in data

    def read(self, path: Path, stored: StoredVolume = no_store) -> ScannedCaseSource:
        """Read a case with its loaded scans."""
        return ScannedCaseSource(read_case(path, stored=stored))

    def read_planned(self, path: Path, stored: StoredVolume = no_store) -> PlannedCaseSource:
        """Read a case whose loaded scans need not exist."""
        return PlannedCaseSource(read_case(path, loaded=False, stored=stored))

    def understood(self, path: Path) -> list[tuple[str, str]]:
        """Return the assumptions of a diagnosis as names and texts."""
        file = case_file(path)
        return [("read from", str(file)), *understood(read_case_file(file))]


READER = CaseReader()
