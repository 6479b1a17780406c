"""Content of an image file as a `Scan`, and its conversion to a `Volume` with axes +x, +y, +z.

Every reader of a format returns a `Scan`: voxels by index axis and the position of those axes in
the patient's frame, LPS (x to the left, y to posterior, z to superior). `to_volume` makes a
`Volume` of it in two steps, both exact permutations and flips of voxels:

1. the index axes of the file are aligned with the axes of its world, LPS;
2. `axes` names the world axes that become the body's x, y and z (by default
   the same ones: x is world x, and so on).

No voxel is interpolated. A voxel keeps its world coordinates in step 1; step 2 is a rotation of
the whole frame, so coordinates of the body are those of the world, reordered and with signs
changed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Triple, Volume

RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0])
"""From NIfTI's frame (x right, y anterior) to LPS."""
SPACING_TOLERANCE = 1e-3
"""Relative difference of two spacings that is attributed to rounding."""
LABEL_TOLERANCE = 1e-3
"""Allowed distance of a label from a whole number, caused by scaling in floating point."""


@dataclass(frozen=True, eq=False)
class Scan:
    """Voxels as stored in a file.

    Parameters
    ----------
    values : ndarray, shape (ni, nj, nk)
        Values by index axis, in any memory order.
    spacing_mm : ndarray, shape (3,)
        Distance between voxel centres along each index axis; NaN if it is missing in the file
        or not a valid distance.
    directions : ndarray, shape (3, 3)
        Columns are the unit vectors of the index axes in LPS.
    origin_mm : ndarray, shape (3,)
        Centre of ``values[0, 0, 0]`` in LPS.
    frame_uid : str
        DICOM frame of reference; empty if the file names none.
    place_known : bool
        True if the file gives origin and orientation.
    anatomical : bool
        True if the frame of the file is a patient's frame, so that left, posterior and
        superior are defined.
    names : mapping of int to str
        Names of labels, if the file has them.
    scaling : str
        Fields of the header that scale the stored numbers, with their values; empty if none do.
    remarks : tuple of str
        What the file states that was not used, for whoever imports it.
    """

    values: NDArray[Any]
    spacing_mm: FloatArray
    directions: FloatArray
    origin_mm: FloatArray
    frame_uid: str = ""
    place_known: bool = True
    anatomical: bool = True
    names: Mapping[int, str] = field(default_factory=dict)
    scaling: str = ""
    remarks: tuple[str, ...] = ()

    @classmethod
    def without_frame(cls, values: NDArray[Any], spacing_mm: ArrayLike | None = None) -> "Scan":
        """Make a scan of unknown position, with axes x, y, z and the first voxel at (0, 0, 0)."""
        spacing = np.full(3, np.nan) if spacing_mm is None else np.array(spacing_mm, dtype=float)
        return cls(
            values, _distances(spacing), np.eye(3), np.zeros(3), place_known=False, anatomical=False
        )

    @classmethod
    def with_steps(
        cls,
        values: NDArray[Any],
        steps_mm: ArrayLike,
        origin_mm: ArrayLike,
        frame: FloatArray | None = None,
    ) -> "Scan":
        """Make a scan from the step of each index axis (columns), given in `frame`.

        Parameters
        ----------
        steps_mm : array_like, shape (3, 3)
            Column a is the step from one voxel centre to the next along index axis a.
            If a column is zero or not finite, the axes are unknown: all three are then
            assumed along the declared frame, with unknown spacing and position.
        origin_mm : array_like, shape (3,)
            Centre of the first voxel; if not finite, (0, 0, 0) is used and the position is
            unknown.
        frame : ndarray, shape (3, 3), optional
            Matrix from the declared frame to LPS. Default: it is LPS.
        """
        to_lps = np.eye(3) if frame is None else frame
        steps = np.asarray(steps_mm, dtype=float)
        origin = np.asarray(origin_mm, dtype=float)
        known = bool(np.all(np.isfinite(origin)))
        if not known:
            origin = np.zeros(3)
        length = np.linalg.norm(steps, axis=0)
        if not (np.all(np.isfinite(length)) and np.all(length > 0)):
            unknown = np.full(3, np.nan)
            return cls(values, unknown, to_lps.copy(), to_lps @ origin, place_known=False)
        turned = to_lps @ (steps / length)
        return cls(values, length, turned, to_lps @ origin, place_known=known)


def _distances(spacing: FloatArray) -> FloatArray:
    return np.where(np.isfinite(spacing) & (spacing > 0), spacing, np.nan)


def three_axes(values: NDArray[Any], what: str) -> NDArray[Any]:
    """Drop axes of length one until three are left.

    Raises
    ------
    InputError
        If the image is 2-D, or has more than three axes longer than one.
    """
    extra = values.ndim - 3
    single = [axis for axis, size in enumerate(values.shape) if size == 1]
    if extra > 0 and len(single) == extra:
        return values.squeeze(tuple(single))
    if extra > 0 and len(single) < extra:
        raise InputError(
            f"{what} has {values.ndim} axes, shape {values.shape}; a volume has 3. "
            "Save one channel and one time point of it."
        )
    return values


def check_shape(values: NDArray[Any], what: str) -> None:
    """Raise InputError unless `values` has three axes of two voxels or more."""
    if values.ndim != 3 or min(values.shape) < 2:
        raise InputError(
            f"{what} is not a 3-D image: its shape is {values.shape}, but three axes of at least "
            "2 voxels are needed. Give the whole stack (a multi-page file, or the "
            "folder with its slices)."
        )


def whole_numbers(values: NDArray[Any], what: str, scaling: str = "") -> NDArray[Any]:
    """Return labels as native integers.

    Floats are rounded if all are within `LABEL_TOLERANCE` of a whole number.

    Parameters
    ----------
    values : ndarray
    what : str
        Name of the image in messages.
    scaling : str, optional
        See `Scan`.

    Raises
    ------
    InputError
        If a voxel is not a whole number, or has several values.
    """
    if values.dtype.kind == "b":
        return values.astype(np.uint8)
    if values.dtype.kind in "iu":
        return values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype.kind != "f":
        raise InputError(
            f"{what} has voxels of type {values.dtype}, expected one whole number each (labels). "
            "Save the label map itself, not its colours."
        )
    low, high = np.inf, -np.inf
    for part in values:
        _refuse_fractions(part, what, scaling)
        low, high = min(low, float(part.min())), max(high, float(part.max()))
    kind = _smallest_integer(np.rint(low), np.rint(high), what)
    return np.rint(values).astype(kind)


def _refuse_fractions(part: NDArray[Any], what: str, scaling: str) -> None:
    """Raise InputError if a value is not finite, or not a whole number."""
    finite = np.isfinite(part)
    if finite.all():
        odd = part[np.abs(part - np.rint(part)) > LABEL_TOLERANCE]
        if not odd.size:
            return
        example = str(odd[0])
    else:
        example = "NaN" if np.isnan(part[~finite]).any() else "infinity"
    advice = (
        "Write 0 where there is no body."
        if example == "NaN"
        else "Segment the image first; resample label maps with nearest neighbour."
    )
    if scaling:
        advice = (
            f"Its header scales the stored numbers by {scaling}: if those are the labels, save it "
            "without scaling (slope 1, intercept 0). Otherwise segment the image first."
        )
    raise InputError(
        f"{what} is not a label map: it contains {example}, but labels must be whole numbers. "
        f"{advice}"
    )


def _smallest_integer(low: float, high: float, what: str) -> type[np.integer[Any]]:
    for kind in (np.uint8, np.uint16, np.int16, np.int32, np.int64):
        limits = np.iinfo(kind)
        if limits.min <= low and high <= limits.max and abs(high) < 2**53:
            return kind
    raise InputError(f"{what} is not a label map: its values run from {low:g} to {high:g}.")


OBLIQUE_DEG = 1.0
"""Index axes further than this from a world axis are refused, in degrees."""

# Part of a body at either end whose cross-sections are averaged.
END_PART = 0.1

AxisOrder = NDArray[np.intp]


def to_volume(
    scan: Scan, what: str, *, spacing_mm: Triple | None = None, axes: str | None = None
) -> Volume:
    """Align a scan with the axes of the body.

    Parameters
    ----------
    scan : Scan
    what : str
        Name of the image in messages.
    spacing_mm : tuple of float, optional
        Spacing along x, y, z of the file's world (before `axes`). Required if the
        file has none; if it has one, both must agree.
    axes : str, optional
        See `parse_axes`.

    Returns
    -------
    Volume
        ``values`` are C-contiguous, shape (nz, ny, nx).

    Raises
    ------
    InputError
        For an oblique scan, a missing or contradictory spacing, or invalid `axes`.

    Notes
    -----
    A tilt of up to `OBLIQUE_DEG` is removed by rotating the image about its centre.
    """
    order, _ = nearest_axes(scan.directions, what)
    spacing = np.empty(3)
    spacing[order] = _settle_spacing(scan.spacing_mm[order], spacing_mm, what)

    if is_anatomical(axes) and not scan.anatomical:
        raise InputError(
            f"axes {axes} are anatomical, but {what} does not define where left, posterior and "
            "superior are. Name the axes of the file instead, such as -z,y,x."
        )
    turn = parse_axes(axes)
    directions = turn @ scan.directions
    order, sign = nearest_axes(directions, what)
    straight = np.zeros((3, 3))
    straight[np.arange(3), order] = sign * spacing[order]
    last = np.array(scan.values.shape) - 1
    flipped = np.zeros(3)
    flipped[order] = sign < 0
    tilt = directions * spacing - straight  # exactly zero for an upright scan
    origin = turn @ scan.origin_mm + straight @ (flipped * last) + tilt @ (last / 2)

    values = scan.values.transpose(tuple(order))
    values = np.flip(values, axis=tuple(int(w) for w in np.flatnonzero(sign < 0)))
    x, y, z = (float(o) + 0.0 for o in origin)  # + 0.0: no minus zero in a header
    sx, sy, sz = (float(s) for s in spacing[order])
    return Volume(
        np.ascontiguousarray(values.transpose(2, 1, 0)),
        (sx, sy, sz),
        (x, y, z),
        frame_uid=scan.frame_uid,
        place_known=scan.place_known,
    )


def nearest_axes(directions: FloatArray, what: str) -> tuple[AxisOrder, FloatArray]:
    """Return the index axis along each world axis, and its direction.

    Parameters
    ----------
    directions : ndarray, shape (3, 3)
        Unit columns, one per index axis.

    Returns
    -------
    order : ndarray of int, shape (3,)
        ``order[w]`` is the index axis along world axis w.
    sign : ndarray, shape (3,)
        -1 where that index axis runs backwards.

    Raises
    ------
    InputError
        If an index axis is more than `OBLIQUE_DEG` away from every world axis.
    """
    world = np.argmax(np.abs(directions), axis=0)
    cosine = directions[world, np.arange(3)]
    degrees = np.degrees(np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)))
    if degrees.max() > OBLIQUE_DEG:
        angles = ", ".join(f"{d:.1f}" for d in degrees)
        raise InputError(
            f"{what} is oblique: its voxel axes are {angles} degrees off the nearest world axes, "
            f"and at most {OBLIQUE_DEG:g} are allowed. Resample it first onto an upright grid, "
            "with nearest neighbour (3D Slicer: Resample Scalar/Vector/DWI Volume)."
        )
    if len(set(world.tolist())) < 3:
        raise InputError(f"{what} has two voxel axes in the same direction; its header is wrong.")
    order = np.argsort(world)
    return order, np.sign(cosine[order])


def _settle_spacing(header: FloatArray, given: Triple | None, what: str) -> FloatArray:
    """Return the spacing along world x, y, z from header and user; NaN in the header is unknown."""
    known = np.isfinite(header)
    if given is None:
        if not known.all():
            raise InputError(
                f"{what} has no voxel spacing (x y z: {_mm(header)} mm). "
                "Give it with --spacing-mm X Y Z."
            )
        return header
    wanted = np.asarray(given, dtype=float)
    if wanted.shape != (3,) or not np.all(np.isfinite(wanted) & (wanted > 0)):
        raise InputError(f"--spacing-mm needs three positive numbers X Y Z, got {given}.")
    if not np.allclose(wanted[known], header[known], rtol=SPACING_TOLERANCE, atol=0.0):
        raise InputError(
            f"{what} has a spacing along x, y, z of {_mm(header)} mm, but --spacing-mm is "
            f"{_mm(wanted)} mm. Omit the option, or correct the file."
        )
    return np.where(known, header, wanted)


def _mm(lengths: FloatArray) -> str:
    return " ".join(f"{length:g}" if np.isfinite(length) else "?" for length in lengths)


ANATOMICAL = {"l": "x", "r": "-x", "p": "y", "a": "-y", "s": "z", "i": "-z"}
"""World axes (LPS) for the letters left, right, posterior, anterior, superior and inferior."""


def is_anatomical(axes: str | None) -> bool:
    """Return True if axes are given by anatomical letters."""
    return axes is not None and any(letter in ANATOMICAL for letter in axes.lower())


def parse_axes(axes: str | None) -> FloatArray:
    """Return the rotation from the world frame to the body's frame.

    Parameters
    ----------
    axes : str, optional
        Three world axes with an optional sign, the ones that become x
        (across), y (compression) and z (chest wall to nipple): ``"-z,y,x"`` turns
        a body upright whose head is at +z and whose nipple is at +x. Or the anatomical
        directions in which x, y and z increase, one letter of L, R, P, A, S and I
        each: ``"L S A"`` is ``"x,z,-y"``. Default: ``"x,y,z"``.

    Returns
    -------
    ndarray, shape (3, 3)
        A signed permutation with determinant +1.

    Raises
    ------
    InputError
        If it does not name all three directions once each, or would mirror the body.

    Examples
    --------
    >>> parse_axes("-z,y,x") @ [1.0, 2.0, 3.0]
    array([-3.,  2.,  1.])
    """
    names = world_axes(axes)
    bare = [name.lstrip("+-") for name in names]
    signed = all(len(name) - len(letter) <= 1 for name, letter in zip(names, bare, strict=True))
    if sorted(bare) != ["x", "y", "z"] or not signed:
        raise InputError(
            f"axes must name x, y and z once each, with an optional sign, got {axes!r}. "
            "For example, with -z,y,x the body's x is world -z, y is y and z is x. Or give the "
            "anatomical directions in which x, y and z increase, such as L S A: one of L and R, "
            "one of P and A, one of S and I."
        )
    turn = np.zeros((3, 3))
    for house, (name, letter) in enumerate(zip(names, bare, strict=True)):
        turn[house, "xyz".index(letter)] = -1.0 if name.startswith("-") else 1.0
    if np.linalg.det(turn) < 0:
        raise InputError(
            f"axes {_as_given(names, axes)} would mirror the body (a left breast would become a "
            f"right one). Swap two directions, for example "
            f"{_as_given([names[1], names[0], names[2]], axes)}, or reverse one, for example "
            f"{_as_given(_unmirrored(names), axes)}; the second is the direction of compression."
        )
    return turn


def world_axes(axes: str | None) -> list[str]:
    """Return the signed world axes in `axes`, which may be given by anatomical letters."""
    text = ("x,y,z" if axes is None else axes).lower()
    if is_anatomical(axes):
        letters = text.replace(",", " ").split()
        if len(letters) == 1:
            letters = list(letters[0])
        return [ANATOMICAL.get(letter, letter) for letter in letters]
    return text.replace(" ", "").split(",")


def _unmirrored(names: list[str]) -> list[str]:
    first = names[0].lstrip("+-")
    return [first if names[0].startswith("-") else f"-{first}", *names[1:]]


def _as_given(names: list[str], axes: str | None) -> str:
    """Format signed world axes in the user's notation, letters or axes."""
    if not is_anatomical(axes):
        return ",".join(names)
    letters = {axis: letter.upper() for letter, axis in ANATOMICAL.items()}
    return " ".join(letters[name] for name in names)


def anatomical_directions(axes: str | None) -> tuple[str, str, str]:
    """Return the letters of the anatomical directions in which the body's x, y and z increase."""
    turn = parse_axes(axes)
    x, y, z = (
        "LPS"[w] if row[w] > 0 else "RAI"[w] for row in turn for w in [int(np.abs(row).argmax())]
    )
    return x, y, z


def opposite(letter: str) -> str:
    """Return the opposite anatomical direction."""
    return "RLAPIS"["LRPASI".index(letter)]


def end_areas_mm2(labels: Volume) -> tuple[float, float]:
    """Return the mean cross-section near the low and near the high end of a body along z.

    In mm2; both are 0 for an empty volume.
    """
    area = np.count_nonzero(labels.values != Tissue.AIR, axis=(1, 2))
    area = area[area > 0] * labels.spacing_mm[0] * labels.spacing_mm[1]
    if not len(area):
        return 0.0, 0.0
    few = max(1, round(END_PART * len(area)))
    return float(area[:few].mean()), float(area[-few:].mean())
