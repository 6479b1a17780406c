"""Reads the truth of a case: the cause that it was made with, and where its points went."""

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
# The effect whose place is scored.
MAPPED = next(e for e in CATALOGUE.effects if e.is_mapped)
CONFOUNDED = {e.name for e in CATALOGUE.effects if e.is_confounded}

Group = Literal["control", "absorbed", "single", "pair", "triple", "unlike", "relative"]
"""What a case asks of a diagnosis: to keep still (``control``, ``absorbed``), to name one
effect, two or three, to say that none of the catalogue is like it (``unlike``), or to name the
family of an effect that is not in the catalogue (``relative``)."""

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
    """One thing that was made different.

    Parameters
    ----------
    kind : str
        In the words of who made the case.
    effect : str or None
        In those of the catalogue, if it lists it.
    family : str or None
        Of the effect, or of its relatives in the catalogue.
    parameters : dict
        Magnitudes, units in their names.
    """

    kind: str
    effect: str | None
    family: str | None
    parameters: dict[str, Any]


class Truth(_Record):
    """``truth.json``, as far as a score asks for it."""

    kind: str
    causes: tuple[Cause, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the effects of the catalogue that act."""
        return tuple(c.effect for c in self.causes if c.effect is not None)

    @property
    def families(self) -> tuple[str, ...]:
        """Return the families of all causes that have one."""
        return tuple(c.family for c in self.causes if c.family is not None)

    @property
    def group(self) -> Group:
        """Return what the case asks of a diagnosis."""
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
    """Where the interfaces went, without noise.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        On the true interfaces at rest, in mm.
    interface : ndarray of int, shape (k,)
        0 for the outline, 1 for the boundary of the glandular tissue.
    displacement : ndarray, shape (scans, k, 3)
        In mm.
    """

    points: FloatArray
    interface: IntArray
    displacement: FloatArray


def read_truth(folder: Path) -> Truth:
    """Read the causes of a case.

    Raises
    ------
    InputError
        If the truth is missing or lacks something.
    """
    path = folder / "truth.json"
    return validated(Truth, read_json(path), str(path))


def read_moved(folder: Path) -> Moved:
    """Read where the points of a case went.

    Raises
    ------
    InputError
        If the arrays are missing or do not fit together.
    """
    path = folder / "truth.npz"
    try:
        with np.load(path) as arrays:
            points, interface = arrays["points"], arrays["interface"]
            displacement = arrays["displacement"]
    except (OSError, KeyError, ValueError) as error:
        raise InputError(
            f"{path} must hold points, interface and displacement: {error}."
        ) from error
    k = len(points)
    fits = points.shape == (k, 3) and interface.shape == (k,) and displacement.ndim == 3
    if not fits or displacement.shape[1:] != (k, 3):
        raise InputError(
            f"{path} needs points (k, 3), interface (k,) and displacement (scans, k, 3), found "
            f"{points.shape}, {interface.shape} and {displacement.shape}."
        )
    return Moved(points, interface, displacement)
