"""Files of a case: its settings, the scan at rest and the scans under load.

::

    case.yaml           loads, nominal model and noise; see `CaseFile`. Or case.json, the same
                        as JSON
    reference.nrrd      labels of the body at rest; an optional second segmentation measures
                        the noise
    deformed_40N.nrrd   labels between the plates, one file for each load and direction

Only this module opens the files of a case; all others receive their content. Images become tissues,
from files in the case's folder or from volumes in the store. `understood` is the table of the
assumptions of a diagnosis.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.image_formats import LabelImage, read_labels
from palpate.workers.body.images.named_labels import label_tissues
from palpate.workers.body.images.tissue_labels import crop_to_body, label_counts, relabel
from palpate.workers.common_keys import validated
from palpate.workers.file_keys import SAME_FIBRES, with_current_names
from palpate.workers.input_files import named_by, parse_json, parse_yaml, read_text
from palpate.workers.mechanics.model_parameters import KPA, Unit
from palpate.workers.organs.breast.breast_laws import law_text, wall_text
from palpate.workers.organs.breast.scan_border import cut_cm2
from palpate.workers.organs.breast.scan_facts import (
    DRAWN_LENGTH_MM,
    DRAWN_VOXELS,
    EnclosedAir,
    enclosed_air,
    in_air,
    one_body,
)
from palpate.workers.organs.breast.scanned_case import (
    ScannedCase,
    above_wall,
    aligned_case,
    stated_starts_mm,
)
from palpate.workers.organs.breast.scanned_case_keys import CaseFile, CaseLoad, CaseScans
from palpate.workers.organs.breast.scanned_case_source import PlannedCaseSource, ScannedCaseSource

StoredVolume = Callable[[str], Volume | None]
"""Returns a stored volume by its name."""
NEEDED = {Tissue.AIR, Tissue.FAT, Tissue.GLANDULAR}
# Skin counts as fat unless the model includes it.
COUNTED_AS = {Tissue.SKIN: Tissue.FAT}


def no_store(name: str) -> Volume | None:
    """Return None, as there is no store."""
    return None


class CaseImages:
    """The images named in a case.

    Parameters
    ----------
    case : Path
        The file of the case.
    scans : CaseScans
        Settings for reading its images.
    stored : callable
        Finds volumes in the store.
    """

    def __init__(self, case: Path, scans: CaseScans, stored: StoredVolume) -> None:
        self.case, self.scans, self.stored = case, scans, stored

    def tissues(self, name: str) -> Volume:
        """Return an image as air, fat and glandular tissue.

        Raises
        ------
        InputError
            If there is no such image, or a label is not a tissue of a diagnosis.
        """
        image = self._image(name)
        meanings = self._understood(image)
        known = {label: COUNTED_AS.get(tissue, tissue) for label, tissue in meanings.items()}
        others = [tissue.name.lower() for tissue in known.values() if tissue not in NEEDED]
        if others:
            raise InputError(
                f"{image.where} has {' and '.join(others)}, but a diagnosis has only air, fat and "
                "glandular tissue. Assign it to one of them, as in labels: {NAME: fat}."
            )
        if set(known.values()) != NEEDED:
            raise InputError(self._missing(image))
        return relabel(image.volume, known, image.where)

    def _image(self, name: str) -> LabelImage:
        path = named_by(self.case, name)
        scans = self.scans
        if path.exists():
            return read_labels(path, spacing_mm=scans.spacing_mm, axes=scans.axes)
        volume = self.stored(name)
        if volume is None:
            raise InputError(
                f"{self.case} names {name}, which is neither in the folder nor in the store. "
                "Check the name, or import the image first."
            )
        if scans.axes is not None or scans.spacing_mm is not None:
            raise InputError(
                f"{name} is a stored volume, whose spacing and axes are known: remove axes and "
                f"spacing_mm from {self.case}, or name the file."
            )
        names = {int(t): t.name.lower() for t in Tissue}
        return LabelImage(volume, names, f"The stored volume {name}", anatomical=False)

    def _understood(self, image: LabelImage) -> dict[int, Tissue]:
        stated = self.scans.labels
        if isinstance(stated, str):
            return label_tissues(image, str(named_by(self.case, stated)))
        meanings = label_tissues(image, stated)
        counts = label_counts(image.volume)
        if not counts.keys() <= meanings.keys():
            raise InputError(self._missing(image))
        return {label: meanings[label] for label in counts}

    def _missing(self, image: LabelImage) -> str:
        return (
            f"{image.where} has the labels {sorted(label_counts(image.volume))}, and "
            f"{self.case.name} has labels: {labels_in_words(self.scans.labels)}. A case needs a "
            "tissue for each label, and air, fat and glandular tissue among them: complete "
            "scans.labels, or segment the missing tissues."
        )


def labels_in_words(labels: Mapping[int | str, str] | Mapping[int, str] | str | None) -> str:
    """Describe the labels given in a case, for a table."""
    if isinstance(labels, str):
        return f"named by {labels}"
    if labels is None:
        return "by the names in the files"
    return ", ".join(f"{label} {tissue}" for label, tissue in labels.items())


Rows = list[tuple[str, str]]


def understood(file: CaseFile) -> Rows:
    """Return the assumptions of a diagnosis as names and texts.

    Examples
    --------
    >>> case = CaseFile.model_validate({
    ...     "name": "mine", "wall": {"z_mm": 0}, "plates": {"lower_mm": -50, "upper_mm": 50},
    ...     "constants": {"E_fat_kpa": 10, "E_glandular_kpa": [20, 50], "eta_fat_kpa": 80,
    ...                   "eta_glandular_kpa": "eta_fat_kpa"},
    ...     "noise": {"sd_mm": 0.3, "correlation_mm": 4},
    ...     "scans": {"reference": "rest.nrrd", "loads": [{"volume": "a.nrrd", "force_n": 40}]}})
    >>> dict(understood(case))["E_glandular"]
    'searched from 20 to 50 kPa'
    """
    return [
        ("case", file.name),
        ("law", _law(file)),
        ("Poisson's ratio", f"{file.nu:g}"),
        ("chest wall", _wall(file)),
        ("plates", "rigid, flat, without friction"),
        *(
            (key.removesuffix("_kpa"), _constant(file, key, unit))
            for key, unit in _units(file).items()
        ),
        ("gravity, skin", "not in the model"),
        ("segmentation noise", _noise(file)),
        ("labels", labels_in_words(file.scans.labels)),
        ("scan at rest", file.scans.reference),
        *((f"scan {n}", _load(file, load)) for n, load in enumerate(file.scans.loads, start=1)),
    ]


def _law(file: CaseFile) -> str:
    model = file.model
    if not file.has_fibres:
        return f"{model.laws.text}, without fibres"
    return law_text(model.fibres, model.fibre_invariant, model.fibre_direction, model.laws.text)


def _wall(file: CaseFile) -> str:
    wall = file.wall
    place = "where the body at rest begins" if wall.z_mm is None else f"z = {wall.z_mm:g} mm"
    return (
        f"{place}, {wall_text(wall.held, wall.wall_hold_x_kpa_per_mm, wall.wall_hold_y_kpa_per_mm)}"
    )


def _units(file: CaseFile) -> dict[str, Unit]:
    """Return the units of the constants given in a file, by key."""
    units = {key: unit for key, (_, unit) in file.names.items()} | dict.fromkeys(SAME_FIBRES, KPA)
    return {key: unit for key, unit in units.items() if key in file.constants}


def _constant(file: CaseFile, key: str, unit: Unit) -> str:
    value = file.constants[key]
    if isinstance(value, str):
        return f"that of {value.removesuffix('_kpa')}"
    if isinstance(value, tuple):
        return f"searched from {value[0]:g} to {value[1]:g} {unit.symbol}".rstrip()
    return f"held at {value:g} {unit.symbol}".rstrip()


def _noise(file: CaseFile) -> str:
    if file.scans.reference_repeat is not None:
        return f"measured from {file.scans.reference_repeat}, a second segmentation at rest"
    if file.noise is None:
        return (
            f"not given: {DRAWN_VOXELS:g} voxels, correlated over {DRAWN_LENGTH_MM:g} mm, "
            "in all scans"
        )
    scans = "in all scans" if file.noise.in_scans == "all" else "in the loaded scans only"
    return f"sd {file.noise.sd_mm:g} mm, correlated over {file.noise.correlation_mm:g} mm, {scans}"


def _load(file: CaseFile, load: CaseLoad) -> str:
    text = f"{load.volume}: {load.name}"
    starts = load.force_n is not None
    placed = stated_starts_mm(file, load) if starts else (load.lower_mm, load.upper_mm)
    if placed == (None, None):
        where = "the scan at rest" if starts else "the scan"
        return f"{text}, plates {'start' if starts else 'end'} at the body in {where}"
    known = ((n, p) for n, p in zip(("lower", "upper"), placed, strict=True) if p is not None)
    verb = "start" if starts else "end"
    return f"{text}, plates {verb} at " + " and ".join(f"{n} {p:g} mm" for n, p in known)


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
    scans, images = file.scans, CaseImages(path, file.scans, stored)
    cut: dict[str, Mapping[str, float]] = {}
    air: dict[str, EnclosedAir | None] = {}

    def tissues(name: str) -> Volume:
        image = images.tissues(name)
        cut[name] = cut_cm2(_above(file, image))
        air[name] = enclosed_air(_above(file, image))
        return image

    case = ScannedCase(
        file,
        _scan(file, tissues(scans.reference)),
        _scan(file, tissues(scans.reference_repeat)) if scans.reference_repeat else None,
        [_one_body(tissues(load.volume)) for load in scans.loads] if loaded else [],
        str(path),
        cut_cm2=cut,
        air=air,
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
    text, data = _data(path)
    if PROSE_KEY in data:
        raise InputError(
            f"{path} describes its physics in sentences under {PROSE_KEY!r}, a form that is no "
            "longer read. Write the same settings as keys with units in case.yaml: `palpate new "
            "diagnosis NAME` writes a template, and docs/reference/keys.md lists all keys."
        )
    return validated(CaseFile, with_current_names(data, str(path)), str(path), text)


def _data(path: Path) -> tuple[str, Mapping[str, Any]]:
    """Return the text of a case, if it is YAML, and its keys."""
    try:
        text = read_text(path)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file: {error}.") from error
    is_yaml = path.suffix in YAML
    data = parse_yaml(text, str(path)) if is_yaml else parse_json(text, str(path))
    if not isinstance(data, Mapping):
        raise InputError(f"{path} is not a case: expected keys such as scans, found {text[:40]!r}.")
    return text if is_yaml else "", data


def _scan(file: CaseFile, tissues: Volume) -> Volume:
    """Return a scan at rest as one body of `Tissue` labels, in air and above the chest wall.

    A loaded scan keeps the tissue below the wall: a wall that gives way lets tissue move there,
    and a cut would be mistaken for skin.
    """
    return _one_body(_above(file, tissues))


def _above(file: CaseFile, tissues: Volume) -> Volume:
    wall_mm = file.wall.z_mm
    return tissues if wall_mm is None else above_wall(tissues, wall_mm)


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
            _, data = _data(path)
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
