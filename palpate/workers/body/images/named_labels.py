"""Tissues of the labels of an image, from the names in its file or a label file and the user's map.

Files that name the labels of an image:

======================  ===========================================================
``.txt`` ``.label``     ITK-SNAP: ``IDX R G B A VIS MESH "NAME"``
``.ctbl`` ``.txt``      colour table of 3D Slicer: ``IDX NAME R G B A``
``.json``               ``{"NAME": 1}``, ``{"1": "NAME"}``, or either under ``labels``
                        (nnU-Net and TotalSegmentator)
======================  ===========================================================

Labels that have numbers and no names are refused with their volumes and where they lie: a number
means no tissue by itself, 1 is fat in one program and glandular tissue in another.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from scipy.ndimage import binary_erosion

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, Tissue, Triple, Volume
from palpate.workers.body.images.image_formats import LabelImage, read_labels
from palpate.workers.body.images.tissue_labels import (
    crop_to_body,
    label_counts,
    relabel,
    tissue_in,
    tissue_named,
)
from palpate.workers.input_files import parse_json, read_text

# Number of labels that are described; an image of grey values has hundreds.
DESCRIBED = 8
AXES = "zyx"


def refuse_numbers(image: LabelImage) -> NoReturn:
    """Raise InputError with the labels of an image without names, and the line to complete."""
    counts = label_counts(image.volume)
    shown = list(counts)[:DESCRIBED]
    more = f" and {len(counts) - DESCRIBED} more labels" if len(counts) > DESCRIBED else ""
    known = [(label, "?" if label else "air") for label in shown]
    written = ", ".join(f"{label}: {tissue}" for label, tissue in known)
    option = ",".join(f"{label}={tissue}" for label, tissue in known)
    rest = ", ..." if more else ""
    raise InputError(
        f"{image.where} has numbers as labels and no names, and a number may mean any tissue. "
        f"Found {'; '.join(_described(image.volume, {k: counts[k] for k in shown}))}{more}. "
        f"Name the tissue of each, with fat, glandular, skin, muscle, ligament or air for each ?. "
        f"In a file:\n  labels: {{{written}{rest}}}\n"
        f"For `palpate import`:\n  --labels '{option}{rest.replace(' ', '')}'"
    )


def _described(volume: Volume, counts: Mapping[int, int]) -> Iterator[str]:
    """Yield number, volume, share of the outline of the body and box of each label."""
    body = np.asarray(volume.values != 0)
    outline = body & ~binary_erosion(body, border_value=1)
    whole = max(int(np.count_nonzero(outline)), 1)
    for label, count in counts.items():
        ml = f"{label}: {count * volume.voxel_mm3 / 1000:.3g} ml"
        there = np.asarray(volume.values == label)
        if label == 0:
            yield f"{ml}, taken as the air around the body"
            continue
        share = int(np.count_nonzero(there & outline)) / whole
        yield f"{ml}, {share:.0%} of the body's surface, {box_words(volume, there)}"


def box_words(volume: Volume, there: BoolArray) -> str:
    """Return the first and the last voxel centre along x, y and z in words."""
    ends = []
    for number, axis in enumerate(AXES):
        line = np.flatnonzero(there.any(axis=tuple(k for k in range(3) if k != number)))
        origin, spacing = volume.origin_mm[2 - number], volume.spacing_mm[2 - number]
        low, high = (round(float(origin + spacing * end), 1) + 0.0 for end in (line[0], line[-1]))
        ends.append(f"{axis} {low:.4g}" + (f" to {high:.4g}" if high > low else ""))
    return ", ".join(reversed(ends)) + " mm"


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


LabelMap = Mapping[int | str, Tissue | str]
"""Tissues by label number or label name."""
NEEDED = (Tissue.FAT, Tissue.GLANDULAR)
"""Tissues that an image with named labels must have."""


@dataclass(frozen=True, eq=False)
class TissueImage:
    """An image as tissues, and the meaning of its labels.

    Parameters
    ----------
    volume : Volume
        `Tissue` labels, cropped to the body.
    tissues : mapping of int to Tissue
        Tissue of every label in the file.
    image : LabelImage
        The original image.
    """

    volume: Volume
    tissues: Mapping[int, Tissue]
    image: LabelImage


def read_tissues(
    path: Path,
    stated: LabelMap | str | None = None,
    *,
    spacing_mm: Triple | None = None,
    axes: str | None = None,
) -> TissueImage:
    """Read a label map as tissues, cropped to the body.

    Parameters
    ----------
    path, spacing_mm, axes
        See `workers.body.images.image_formats.read_labels`.
    stated
        See `label_tissues`.

    Raises
    ------
    InputError
        If it cannot be read, or a label has no tissue.
    """
    image = read_labels(path, spacing_mm=spacing_mm, axes=axes)
    tissues = label_tissues(image, stated)
    return TissueImage(crop_to_body(relabel(image.volume, tissues, image.where)), tissues, image)


def label_tissues(image: LabelImage, stated: LabelMap | str | None) -> dict[int, Tissue]:
    """Return the tissue of every label in an image.

    A number alone has no meaning, not even that of `Tissue`.

    Parameters
    ----------
    image : LabelImage
    stated : mapping, str or None
        Tissues by number or name of a label, or the path of a file with names of labels. None:
        use the names in the image.

    Raises
    ------
    InputError
        If the image has no names and none are given, the names in the image and the given numbers
        disagree, a name is unknown, a label has no tissue, or a needed tissue is missing.
    """
    names = dict(image.names)
    if isinstance(stated, str):
        names, stated = _named_by_file(image, Path(stated)), None
    if not names:
        return _by_number(image, stated)
    counts = label_counts(image.volume)
    by_user = _by_user(image, names, stated or {})
    tissues: dict[int, Tissue] = {}
    unknown = []
    for label in counts:
        tissue = by_user.get(label, _tissue_of(label, names))
        if tissue is None:
            unknown.append(label)
        else:
            tissues[label] = tissue
    if unknown:
        _refuse_unknown(image, names, by_user, counts, unknown)
    _refuse_missing(image, names, by_user, tissues)
    return tissues


def names_listed(names: Mapping[int, str]) -> str:
    """List label names for a message."""
    return ", ".join(f"{label} {name!r}" for label, name in sorted(names.items()))


def _named_by_file(image: LabelImage, path: Path) -> dict[int, str]:
    names = read_label_file(path)
    for label, name in image.names.items():
        other = tissue_in(names.get(label, name))
        if other != tissue_in(name):
            raise InputError(
                f"{image.where} names its label {label} {name!r}, but {path} names it "
                f"{names[label]!r}. Omit the file, or correct it."
            )
    return names


def _by_number(image: LabelImage, stated: LabelMap | None) -> dict[int, Tissue]:
    """Return the tissues of an image without label names."""
    if not stated:
        refuse_numbers(image)
    words = [key for key in stated if isinstance(key, str)]
    if words:
        raise InputError(
            f"{image.where} has no names of labels, so {words[0]!r} is unknown. Give numbers; it "
            f"has {', '.join(map(str, label_counts(image.volume)))}. Or give a file that names "
            "them, such as a label description file of ITK-SNAP."
        )
    return {int(label): tissue_named(tissue) for label, tissue in stated.items()}


def _by_user(image: LabelImage, names: Mapping[int, str], stated: LabelMap) -> dict[int, Tissue]:
    """Return the tissues given by the user, by label number."""
    tissues: dict[int, Tissue] = {}
    for key, value in stated.items():
        tissue = tissue_named(value)
        if isinstance(key, str):
            labels = [label for label, name in names.items() if _same(name, key)]
            if not labels:
                raise InputError(
                    f"{image.where} has no label named {key!r}. Its labels are "
                    f"{names_listed(names)}."
                )
        else:
            labels = [key]
            _refuse_other_name(image, names, key, tissue)
        for label in labels:
            if tissues.setdefault(label, tissue) != tissue:
                raise InputError(
                    f"labels: {label} of {image.where} is given as {tissues[label].name.lower()} "
                    f"and as {tissue.name.lower()}. Keep one."
                )
    return tissues


def _refuse_other_name(
    image: LabelImage, names: Mapping[int, str], label: int, tissue: Tissue
) -> None:
    named = _tissue_of(label, names)
    if label not in names and label != 0:
        raise InputError(
            f"Label {label} is given as {tissue.name.lower()}, but {image.where} has no such "
            f"label. Its labels are {names_listed(names)}."
        )
    if named is not None and named != tissue:
        raise InputError(
            f"Label {label} is given as {tissue.name.lower()}, but {image.where} names it "
            f"{names.get(label, 'background')!r}. Its labels are {names_listed(names)}. Leave out "
            "the numbers, or give tissues by name, such as labels: "
            f"{{{names.get(label, 'background')}: {tissue.name.lower()}}}."
        )


def _tissue_of(label: int, names: Mapping[int, str]) -> Tissue | None:
    if label not in names:
        return Tissue.AIR if label == 0 else None
    return tissue_in(names[label])


def _same(name: str, other: str) -> bool:
    return " ".join(name.casefold().split()) == " ".join(other.casefold().split())


def _refuse_unknown(
    image: LabelImage,
    names: Mapping[int, str],
    by_user: Mapping[int, Tissue],
    counts: Mapping[int, int],
    unknown: list[int],
) -> None:
    """Raise InputError with a map to complete."""
    listed = ", ".join(
        f"{names[k]!r} (label {k})" if k in names else f"label {k}, which has no name"
        for k in unknown
    )
    known = {k: by_user.get(k, _tissue_of(k, names)) for k in counts if k != 0 or k in names}
    lines = [
        f"{_key(names.get(k, k))}: {'?' if t is None else t.name.lower()}" for k, t in known.items()
    ]
    raise InputError(
        f"{image.where}: no tissue is known for {listed}. Complete the map: labels: "
        f"{{{', '.join(lines)}}}, with air, fat, glandular, skin, muscle or ligament for each ?."
    )


def _key(name: str | int) -> str:
    plain = isinstance(name, int) or all(c.isalnum() or c in " _-" for c in name)
    return str(name) if plain and name != "" else repr(name)


def _refuse_missing(
    image: LabelImage,
    names: Mapping[int, str],
    by_user: Mapping[int, Tissue],
    found: Mapping[int, Tissue],
) -> None:
    """Raise InputError if a required tissue has no voxel."""
    for tissue in NEEDED:
        if tissue not in found.values():
            empty = [
                names[label]
                for label in names
                if by_user.get(label, _tissue_of(label, names)) == tissue
            ]
            why = (
                f"its label {empty[0]!r} is empty"
                if empty
                else f"its labels are {names_listed(names)}"
            )
            raise InputError(
                f"{image.where} has no {tissue.name.lower()} voxel: {why}. Segment that tissue, "
                f"or give its label, such as labels: {{NAME: {tissue.name.lower()}}}."
            )
