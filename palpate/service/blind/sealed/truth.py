"""The truth of a case: the cause with which it was made, and the displacements of its points."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from palpate.service.blind.sealed.seal import read_json
from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.organs.registry import catalogue_of
from palpate.workers.spec import validated

# A blind case is a breast.
CATALOGUE = catalogue_of("breast")
# The effect whose position is scored.
MAPPED = next(e for e in CATALOGUE.effects if e.is_mapped)
CONFOUNDED = {e.name for e in CATALOGUE.effects if e.is_confounded}

Group = Literal["control", "absorbed", "single", "pair", "triple", "unlike", "relative"]
"""The expected answer to a case: none (``control``, ``absorbed``), one effect, two or three, no
effect in the catalogue (``unlike``), or the family of an effect that is not in the catalogue
(``relative``)."""

GROUPS: dict[Group, str] = {
    "control": "nothing missing",
    "absorbed": "hidden in the constants",
    "single": "one effect",
    "pair": "two effects",
    "triple": "three effects",
    "unlike": "unlike any effect",
    "relative": "relative of an effect",
}


class _Record(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Cause(_Record):
    """One deviation of a case.

    Parameters
    ----------
    kind : str
        Name used by the maker of the case.
    effect : str or None
        Name in the catalogue, if it is listed.
    family : str or None
        Family of the effect, or of its relatives in the catalogue.
    parameters : dict
        Magnitudes, with units in their names.
    """

    kind: str
    effect: str | None
    family: str | None
    parameters: dict[str, Any]


class Truth(_Record):
    """The part of ``truth.json`` needed for a score."""

    kind: str
    causes: tuple[Cause, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the acting effects from the catalogue."""
        return tuple(c.effect for c in self.causes if c.effect is not None)

    @property
    def families(self) -> tuple[str, ...]:
        """Return the families of all causes that have one."""
        return tuple(c.family for c in self.causes if c.family is not None)

    @property
    def group(self) -> Group:
        """Return the expected kind of answer."""
        if not self.causes:
            return "control"
        if len(self.effects) < len(self.causes):
            return "relative" if self.families else "unlike"
        if CONFOUNDED.issuperset(self.effects):
            return "absorbed"
        together: tuple[Group, ...] = ("single", "pair", "triple")
        return together[len(self.causes) - 1]


@dataclass(frozen=True, eq=False)
class Moved:
    """Noise-free displacements of the interfaces.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Points on the true interfaces at rest, in mm.
    interface : ndarray of int, shape (k,)
        0 for the outline, 1 for the boundary of the glandular tissue.
    displacement : ndarray, shape (scans, k, 3)
        Displacements in mm.
    """

    points: FloatArray
    interface: IntArray
    displacement: FloatArray


def read_truth(folder: Path) -> Truth:
    """Read the causes of a case.

    Raises
    ------
    InputError
        If the truth is missing or incomplete.
    """
    path = folder / "truth.json"
    return validated(Truth, read_json(path), str(path))


def read_moved(folder: Path) -> Moved:
    """Read the displacements of a case's points.

    Raises
    ------
    InputError
        If the arrays are missing or their shapes do not match.
    """
    path = folder / "truth.npz"
    try:
        with np.load(path) as arrays:
            points, interface = arrays["points"], arrays["interface"]
            displacement = arrays["displacement"]
    except (OSError, KeyError, ValueError) as error:
        raise InputError(
            f"{path} must have points, interface and displacement: {error}."
        ) from error
    k = len(points)
    fits = points.shape == (k, 3) and interface.shape == (k,) and displacement.ndim == 3
    if not fits or displacement.shape[1:] != (k, 3):
        raise InputError(
            f"{path} needs points (k, 3), interface (k,) and displacement (scans, k, 3), found "
            f"{points.shape}, {interface.shape} and {displacement.shape}."
        )
    return Moved(points, interface, displacement)
