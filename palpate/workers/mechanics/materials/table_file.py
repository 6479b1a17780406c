"""Tables of stress and stretch from CSV files.

One column is the deformation: ``stretch`` (1 at rest), ``strain`` or ``strain_percent`` along the
load, or ``shear``, the amount of simple shear. One is the nominal stress, force per undeformed
area: ``stress_kpa``, ``stress_mpa`` or ``stress_pa``. A column ``mode`` marks rows of tests that
are not uniaxial: ``equibiaxial`` or ``planar``. Other columns are ignored.
"""

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.workers.input_files import read_text, reading
from palpate.workers.mechanics.materials.homogeneous_deformation import POWERS, Mode, Table

DEFORMATION: Mapping[str, Callable[[float], float]] = {
    "stretch": lambda x: x,
    "strain": lambda x: 1 + x,
    "strain_percent": lambda x: 1 + x / 100,
    "shear": lambda x: x,
}
MPA = {"stress_kpa": 1e-3, "stress_mpa": 1.0, "stress_pa": 1e-6}


def read_tables(path: Path) -> list[Table]:
    """Read the tables of a file, one for each mode.

    Raises
    ------
    InputError
        If the file cannot be read or a column or a number is missing.
    """
    with reading(path, "a table of stress and stretch"):
        return _tables(path)


def _tables(path: Path) -> list[Table]:
    try:
        lines = read_text(path).splitlines()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text: {error}. Save it as CSV.") from error
    kept = [
        (n, line) for n, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != "#"
    ]
    rows = list(csv.reader((line for _, line in kept), delimiter=_delimiter(kept)))
    heading = [cell.strip().lower() for cell in rows[0]] if rows else []
    deformation = _column(path, heading, DEFORMATION, "the deformation")
    stress = _column(path, heading, MPA, "the nominal stress")
    points: dict[Mode, list[tuple[float, float]]] = {}
    for (number, _), row in zip(kept[1:], rows[1:], strict=True):
        where = f"{path}, line {number}"
        cells = dict(zip(heading, (cell.strip() for cell in row), strict=False))
        mode = _mode(where, deformation, cells.get("mode", ""))
        x, y = (_number(where, name, cells.get(name, "")) for name in (deformation, stress))
        points.setdefault(mode, []).append((DEFORMATION[deformation](x), y * MPA[stress]))
    if not points:
        raise InputError(f"{path} has no rows below its heading.")
    try:
        return [Table(mode, *np.array(found).T) for mode, found in points.items()]
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _delimiter(lines: Sequence[tuple[int, str]]) -> str:
    heading = lines[0][1] if lines else ""
    return next((mark for mark in ",;\t" if mark in heading), ",")


def _column(path: Path, heading: Sequence[str], known: Mapping[str, object], of: str) -> str:
    found = [name for name in heading if name in known]
    if len(found) != 1:
        raise InputError(
            f"{path} needs one column of {of}: {', '.join(known)}; found the columns "
            f"{', '.join(heading) or 'none'}."
        )
    return found[0]


def _mode(where: str, deformation: str, stated: str) -> Mode:
    if deformation == "shear":
        return Mode.SIMPLE_SHEAR
    try:
        mode = Mode(stated.lower() or Mode.UNIAXIAL)
    except ValueError:
        mode = Mode.SIMPLE_SHEAR
    if mode not in POWERS:
        raise InputError(f"{where}: mode must be one of {', '.join(POWERS)}; found {stated!r}.")
    return mode


def _number(where: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} is not a number, found {text!r}.")
    return value
