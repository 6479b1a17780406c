"""Labels of an image as tissues: names, maps from labels to tissues, and bounding boxes.

`tissue_in` recognises tissues by the names that users and programs give to segments. `label_map`
reads a map as users write it in YAML, JSON or an option; `relabel` applies it.
"""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume

_WORDS = {
    Tissue.AIR: "air background exterior outside clear",
    Tissue.FAT: "fat adipose fatty lipid",
    Tissue.GLANDULAR: "gland glands glandular fibroglandular fibro fgt parenchyma",
    Tissue.SKIN: "skin cutis dermis epidermis",
    Tissue.MUSCLE: "muscle muscles pectoral pectorals pectoralis",
    Tissue.LIGAMENT: "ligament ligaments cooper coopers",
}
_TISSUE = {word: tissue for tissue, words in _WORDS.items() for word in words.split()}
_SILENT = (
    "tissue tissues breast breasts mammary left right l r the of s label mask segment "
    "subcutaneous skeletal torso intermuscular major minor suspensory chest wall"
)
_NEUTRAL = set(_SILENT.split())


def tissue_in(name: str) -> Tissue | None:
    """Return the tissue described by a name; None if that is uncertain.

    Words count, in any case: at least one names a tissue, all tissue words name the same one, and
    all other words are neutral ("left", "breast", "tissue", numbers).

    Examples
    --------
    >>> tissue_in("Fibroglandular tissue (left)")
    <Tissue.GLANDULAR: 2>
    >>> tissue_in("fat and skin") is None
    True
    """
    words = [word for word in re.findall(r"[^\W\d_]+", name.lower()) if word not in _NEUTRAL]
    tissues = {_TISSUE.get(word) for word in words}
    return tissues.pop() if len(tissues) == 1 else None


_TABLE = 1 << 16
"""Widest range of labels that is counted and mapped with a lookup table."""


def label_counts(volume: Volume) -> dict[int, int]:
    """Count the voxels of each label, in ascending order of labels."""
    counts: dict[int, int] = {}
    for part in volume.values:  # by slices: an index table of the whole would not fit in memory
        low, high = int(part.min()), int(part.max())
        if high - low < _TABLE:
            histogram = np.bincount((part.astype(np.int64) - low).ravel())
            labels = np.flatnonzero(histogram)
            numbers, labels = histogram[labels], labels + low
        else:
            labels, numbers = np.unique(part, return_counts=True)
        for label, number in zip(labels.tolist(), numbers.tolist(), strict=True):
            counts[label] = counts.get(label, 0) + number
    return dict(sorted(counts.items()))


def relabel(
    volume: Volume, label_map: Mapping[int, Tissue | str], where: str = "the volume"
) -> Volume:
    """Convert the labels of an image to tissues.

    Parameters
    ----------
    volume : Volume
        Integer labels with any meaning.
    label_map : mapping of int to Tissue or str
        Names of `Tissue` in any case: ``{0: "air", 1: "fat", 2: "glandular"}``.
        Several labels may become one tissue.
    where : str
        Name of the image in messages.

    Returns
    -------
    Volume
        ``uint8`` values of `Tissue` on the same grid.

    Raises
    ------
    InputError
        If a name is not a tissue, the map names a label that the volume does not have,
        or lacks a label of the volume.
    """
    wanted = {_label_number(label): tissue_named(name) for label, name in label_map.items()}
    counts = label_counts(volume)
    missing = sorted(wanted.keys() - counts.keys())
    if missing:
        tissues = listed_names({wanted[label] for label in missing})
        raise InputError(
            f"Label missing from {where}: {_joined(missing)}. It has {_listed(counts)}. Check that "
            f"this is the right image, and that {tissues} was segmented and exported. If it has "
            f"another number, write that one: labels: {_written(_suggestion(counts, wanted))}. "
            f"Leave {_joined(missing)} out only if the body has none of it."
        )
    unnamed = {label: count for label, count in counts.items() if label not in wanted}
    if unnamed:
        raise InputError(
            f"{where[:1].upper()}{where[1:]} has labels that the map does not name: "
            f"{_listed(unnamed)}. "
            f"Name all of them: labels: {_written(_suggestion(counts, wanted))}"
        )
    return _renamed(volume, wanted)


def listed_names(tissues: Iterable[Tissue]) -> str:
    """Return the names of tissues, such as ``fat and glandular``."""
    return " and ".join(tissue.name.lower() for tissue in sorted(tissues))


def _label_number(label: Any) -> int:
    try:
        return int(label)
    except ValueError as error:
        raise InputError(
            f"{label!r} is not a label; labels are whole numbers. Write {{1: fat}}, not {{fat: 1}}."
        ) from error


def _renamed(volume: Volume, wanted: Mapping[int, Tissue]) -> Volume:
    known = np.array(sorted(wanted), dtype=np.int64)
    tissues = np.array([wanted[label] for label in known.tolist()], dtype=np.uint8)
    low = int(known[0])
    table = None
    if int(known[-1]) - low < _TABLE:
        table = np.zeros(int(known[-1]) - low + 1, np.uint8)
        table[known - low] = tissues
    out = np.empty(volume.values.shape, np.uint8)
    for slice_in, slice_out in zip(volume.values, out, strict=True):
        labels = slice_in.astype(np.int64)
        slice_out[...] = (
            tissues[np.searchsorted(known, labels)] if table is None else table[labels - low]
        )
    return replace(volume, values=out)


def tissue_named(name: Tissue | str | int) -> Tissue:
    """Return the tissue with this name (in any case) or number.

    Raises
    ------
    InputError
        If it is unknown; the closest name is suggested.
    """
    tissue = _known_tissue(name)
    if tissue is None:
        names = [t.name.lower() for t in Tissue]
        near = difflib.get_close_matches(str(name).strip().lower(), names, n=1)
        hint = f"Did you mean {near[0]}? " if near else ""
        raise InputError(f"{name!r} is not a tissue. {hint}Known: {', '.join(names)}.")
    return tissue


def _known_tissue(name: Tissue | str | int) -> Tissue | None:
    if isinstance(name, str):
        return Tissue.__members__.get(name.strip().upper())
    return Tissue(name) if name in set(Tissue) else None


def default_map(volume: Volume, where: str = "The volume") -> dict[int, Tissue]:
    """Return the map of a volume whose labels are already those of `Tissue`.

    Parameters
    ----------
    volume : Volume
    where : str
        Its name in messages.

    Raises
    ------
    InputError
        If a label is not in `Tissue`, so that its meaning is unknown.
    """
    counts = label_counts(volume)
    strange = {label: count for label, count in counts.items() if _known_tissue(label) is None}
    if strange:
        raise InputError(
            f"{where} has labels that are not tissue numbers: {_listed(strange)}. "
            f"Name the tissue of each: labels: {_written(_suggestion(counts, {}))}"
        )
    return {label: Tissue(label) for label in counts}


class Box(TypedDict):
    """The lower and upper corner (x, y, z) of a box, in mm."""

    lower: list[float]
    upper: list[float]


class LabelShare(TypedDict):
    """Voxels and volume of a label, and its tissue if known."""

    tissue: NotRequired[str]
    voxels: int
    ml: float


class LabelSummary(TypedDict):
    """Contents of a volume, see `summarise`."""

    shape: list[int]
    spacing_mm: list[float]
    origin_mm: list[float]
    box_mm: Box
    body_mm: Box | None
    labels: dict[str, LabelShare]


def summarise(volume: Volume, *, named: bool = False) -> LabelSummary:
    """Summarise the contents of a volume, ready for JSON.

    Parameters
    ----------
    volume : Volume
        Integer labels.
    named : bool, optional
        True if the labels are those of `Tissue`; each then has its ``tissue``.

    Returns
    -------
    LabelSummary
        ``shape`` (nx, ny, nz), ``spacing_mm``, ``origin_mm``; ``box_mm`` with the
        ``lower`` and ``upper`` faces of the outermost voxels, ``body_mm`` the same for
        the voxels that are not 0 (None if all are); ``labels`` by label (as text):
        ``voxels`` and ``ml``.
    """
    lower, upper = np.zeros(3, dtype=np.intp), np.array(volume.shape_xyz)
    body = _extent(volume.values)
    labels: dict[str, LabelShare] = {}
    for label, count in label_counts(volume).items():
        ml = count * volume.voxel_mm3 / 1000
        tissue = _known_tissue(label) if named else None
        labels[str(label)] = (
            LabelShare(voxels=count, ml=ml)
            if tissue is None
            else LabelShare(tissue=tissue.name.lower(), voxels=count, ml=ml)
        )
    return {
        "shape": list(volume.shape_xyz),
        "spacing_mm": [float(s) for s in volume.spacing_mm],
        "origin_mm": [float(o) for o in volume.origin_mm],
        "box_mm": _faces(volume, lower, upper),
        "body_mm": None if body is None else _faces(volume, *body),
        "labels": labels,
    }


def crop_to_body(volume: Volume, margin_voxels: int = 1) -> Volume:
    """Crop to the tight box around all voxels that are not air (0).

    The body was cut from the patient at the chest wall, the low end of z. That face
    stays the first slice of the box: no margin is left below it, whatever
    `margin_voxels`, so that air never comes between body and wall. On the five other
    sides up to `margin_voxels` of the volume's own voxels are kept; none are added
    where the body reaches the edge of the image.

    Parameters
    ----------
    volume : Volume
    margin_voxels : int, optional
        >= 0.

    Returns
    -------
    Volume
        A copy on the same lattice; every voxel keeps its world coordinates.

    Raises
    ------
    InputError
        If all voxels are air, or the margin is negative.
    """
    if margin_voxels < 0:
        raise InputError(f"The margin must be 0 voxels or more, got {margin_voxels}.")
    box = _extent(volume.values)
    if box is None:
        raise InputError(
            "The volume is all air (0), without a body. Check the label map; only the outside of "
            "the body may be air."
        )
    lower = np.maximum(box[0] - [margin_voxels, margin_voxels, 0], 0)
    upper = np.minimum(box[1] + margin_voxels, volume.shape_xyz)
    x, y, z = (slice(int(a), int(b)) for a, b in zip(lower, upper, strict=True))
    origin = np.asarray(volume.origin_mm) + lower * np.asarray(volume.spacing_mm)
    ox, oy, oz = (float(o) for o in origin)
    return replace(volume, values=volume.values[z, y, x].copy(), origin_mm=(ox, oy, oz))


def resample_labels(volume: Volume, like: Volume) -> Volume:
    """Sample labels on the grid of another volume, by nearest neighbour in world coordinates.

    Every voxel of `like` gets the label of the voxel of `volume` that contains its centre
    (on a common face, the one at higher coordinates); centres outside get AIR.
    Coarsening this way is sampling, not a majority vote.

    Returns
    -------
    Volume
        ``values`` have the type of ``volume.values`` and the grid of `like`.
    """
    index, inside = [], []
    for axis in range(3):
        count, spacing = like.shape_xyz[axis], like.spacing_mm[axis]
        centre = like.origin_mm[axis] + spacing * np.arange(count)
        place = (centre - volume.origin_mm[axis]) / volume.spacing_mm[axis]
        nearest = np.floor(place + 0.5 + 1e-6).astype(np.intp)  # faces up, despite rounding
        within = (nearest >= 0) & (nearest < volume.shape_xyz[axis])
        index.append(nearest[within])
        inside.append(within)
    values = np.full(like.values.shape, Tissue.AIR, volume.values.dtype)
    values[np.ix_(*inside[::-1])] = volume.values[np.ix_(*index[::-1])]
    return replace(volume, values=values, spacing_mm=like.spacing_mm, origin_mm=like.origin_mm)


def _extent(values: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """Return the first index of the voxels that are not 0, and one past the last, as (x, y, z)."""
    mask = np.zeros(values.shape[1:], dtype=bool)
    along_z = np.zeros(len(values), dtype=bool)
    for z, part in enumerate(values):
        solid = part != 0
        along_z[z] = solid.any()
        mask |= solid
    if not along_z.any():
        return None
    hits = [np.flatnonzero(line) for line in (mask.any(axis=0), mask.any(axis=1), along_z)]
    return np.array([h[0] for h in hits]), np.array([h[-1] + 1 for h in hits])


def _faces(volume: Volume, lower: NDArray[np.intp], upper: NDArray[np.intp]) -> Box:
    spacing, origin = np.asarray(volume.spacing_mm), np.asarray(volume.origin_mm)
    return {
        "lower": (origin + (lower - 0.5) * spacing).tolist(),
        "upper": (origin + (upper - 0.5) * spacing).tolist(),
    }


_LISTED = 12
"""Number of labels listed in a message; the rest are only counted."""


def _suggestion(counts: Iterable[int], wanted: Mapping[int, Tissue]) -> Iterator[tuple[int, str]]:
    for label in counts:
        tissue = wanted.get(label, _known_tissue(label))
        yield label, "?" if tissue is None else tissue.name.lower()


def _written(suggestion: Iterable[tuple[int, str]]) -> str:
    items = [f"{label}: {name}" for label, name in suggestion]
    return "{" + ", ".join(_shortened(items)) + "}"


def _listed(counts: Mapping[int, int]) -> str:
    items = [f"{label} ({count} voxel{'s' * (count != 1)})" for label, count in counts.items()]
    return ", ".join(_shortened(items))


def _joined(labels: Iterable[int]) -> str:
    return ", ".join(_shortened([str(label) for label in labels]))


def _shortened(items: list[str]) -> list[str]:
    more = len(items) - _LISTED
    return items if more <= 0 else [*items[:_LISTED], f"... ({more} more)"]


FORMS = "a mapping such as {0: air, 1: fat} or {Adipose: fat}, or a file that names labels"


def label_map(given: Any) -> Any:
    """Return a map from label numbers or names to tissue names; a path is returned unchanged.

    Numbers may be strings, as keys are in JSON.

    Raises
    ------
    ValueError
        If it is invalid, or names a label twice.
    """
    if given is None or isinstance(given, str):
        return given
    if not isinstance(given, Mapping):
        raise ValueError(f"expected {FORMS}; found {given!r}")
    tissues: dict[int | str, str] = {}
    for key, value in given.items():
        label = _label_as_written(key)
        if label in tissues:
            raise ValueError(f"label {label} is named twice: keep one")
        tissues[label] = _tissue_as_written(label, value)
    return tissues


def _label_as_written(key: Any) -> int | str:
    if isinstance(key, int) and not isinstance(key, bool):
        return key
    if isinstance(key, float) and key.is_integer():
        return int(key)
    text = str(key).strip()
    return int(text) if re.fullmatch(r"-?\d+", text) else text


def _tissue_as_written(label: int | str, value: Any) -> str:
    if isinstance(value, int) and isinstance(label, str):
        raise ValueError(f"write {{{value}: {label}}}, not {{{label}: {value}}}")
    if not isinstance(value, str):
        raise ValueError(f"{label}: expected a tissue, such as fat; found {value!r}")
    try:
        return tissue_named(value).name.lower()
    except InputError as error:
        raise ValueError(f"{label}: {error}") from None
