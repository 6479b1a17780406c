"""Table of the assumptions of a diagnosis."""

from palpate.workers.old_names import SAME_FIBRES
from palpate.workers.organs.breast.case.images import labels_in_words
from palpate.workers.organs.breast.case.scanned_case import stated_starts_mm
from palpate.workers.organs.breast.case.spec import CaseFile, CaseLoad
from palpate.workers.organs.breast.physics_words import law_text, wall_text
from palpate.workers.organs.breast.study_noise import DRAWN_LENGTH_MM, DRAWN_VOXELS
from palpate.workers.units import KPA, Unit

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
