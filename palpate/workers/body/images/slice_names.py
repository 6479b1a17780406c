"""Order of the slices in a folder, by the numbers in their names."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray

# A minus sign after a letter is a hyphen unless that makes no sense: slice-1 is slice 1.
_SIGNED = re.compile(r"((?<![^\W_])[+-]?\d+(?:[.,]\d+)*)")
_AFTER_LETTERS = re.compile(r"((?<!\d)[+-]?\d+(?:[.,]\d+)*)")
_EVEN = 0.05
"""Allowed deviation of a number from its position in the row, in steps."""


@dataclass(frozen=True)
class _Row:
    """The values of one number in the file names, over all files.

    Parameters
    ----------
    values : ndarray, shape (n,)
    decimals : int
        Digits after the decimal point.
    """

    values: FloatArray
    decimals: int

    @property
    def order(self) -> list[int]:
        return [int(k) for k in np.argsort(self.values, kind="stable")]

    @property
    def step(self) -> float:
        return float(np.median(np.diff(np.sort(self.values))))

    @property
    def is_even(self) -> bool:
        gaps = np.diff(np.sort(self.values))
        slack = max(_EVEN * self.step, 10.0**-self.decimals if self.decimals else 0.0)
        return bool(gaps.min() > 0 and np.all(np.abs(gaps - self.step) <= slack))


def in_order(paths: Sequence[Path], what: str) -> list[Path]:
    """Sort the files of slices by the number in their names.

    Numbers may be signed and have decimals. They must form one evenly spaced row.

    Parameters
    ----------
    paths : sequence of Path
        Files of one folder, one for each slice.
    what : str
        Name of the folder in messages.

    Raises
    ------
    InputError
        If names differ in more than numbers, a number is missing or used for two
        slices, or two numbers in the names give different orders.
    """
    if len(paths) < 2:
        return list(paths)
    paths = sorted(paths, key=lambda path: path.name)
    rows = [row for row in _rows(paths, what) if np.ptp(row.values) > 0]
    even = [row for row in rows if row.is_even]
    if not even:
        _refuse(rows, paths, what)
    order = even[0].order
    for row in even[1:]:
        if row.order != order:
            raise InputError(
                f"{what}: two numbers in the names of the slices give different orders: "
                f"{paths[order[0]].name} or {paths[row.order[0]].name} first. Rename the slices "
                "with one number each."
            )
    return [paths[k] for k in order]


def _rows(paths: Sequence[Path], what: str) -> list[_Row]:
    """Return the numbers in the names, which must otherwise be equal."""
    for pattern in (_SIGNED, _AFTER_LETTERS):
        split = [pattern.split(path.stem.lower()) for path in paths]
        numbers = [_apart(parts[1::2]) for parts in split]
        odd = [k for k, parts in enumerate(split) if parts[::2] != split[0][::2]]
        odd = odd or [k for k, found in enumerate(numbers) if len(found) != len(numbers[0])]
        if not odd:
            return [_row([found[k] for found in numbers]) for k in range(len(numbers[0]))]
    raise InputError(
        f"{what}: the names of the slices differ in more than a number ({paths[0].name}, "
        f"{paths[odd[0]].name}), so their order is unknown. Keep the slices of one image, and "
        "number them, such as slice001.tif."
    )


def _apart(numbers: Sequence[str]) -> list[str]:
    """Split numbers that have several points, such as dates and UIDs, into parts."""
    found: list[str] = []
    for number in numbers:
        parts = re.split("[.,]", number)
        found += parts if len(parts) > 2 else [".".join(parts)]
    return found


def _row(numbers: Sequence[str]) -> _Row:
    decimals = max(len(number.partition(".")[2]) for number in numbers)
    return _Row(np.array([float(number) for number in numbers]), decimals)


def _refuse(rows: Sequence[_Row], paths: Sequence[Path], what: str) -> None:
    """Raise InputError with the reason why the numbers are not an evenly spaced row."""
    if not rows:
        raise InputError(
            f"{what}: several slices have the same number in their names: "
            f"{', '.join(path.name for path in paths[:4])}. Keep the slices of one image."
        )
    row = max(rows, key=lambda row: len(set(row.values.tolist())))
    values, order = row.values[row.order], row.order
    gaps = np.diff(values)
    if gaps.min() <= 0:
        twice = int(np.argmin(gaps))
        names = f"{paths[order[twice]].name} and {paths[order[twice + 1]].name}"
        raise InputError(
            f"{what} has two slices numbered {values[twice]:g}: {names}. Keep the slices of one "
            "image, and number them from 1."
        )
    raise InputError(
        f"{what} {_gap_in_words(values, [paths[k].name for k in order])}. Complete the slices, or "
        "resample them at even distances."
    )


def _gap_in_words(values: FloatArray, names: Sequence[str]) -> str:
    gaps = np.diff(values)
    step, wide = float(np.median(gaps)), int(np.argmax(gaps))
    between = f"between {names[wide]} and {names[wide + 1]}"
    times = gaps / step
    if np.all(np.abs(times - np.rint(times)) < 2 * _EVEN):
        lost = [
            f"{value + step * k:g}"
            for value, count in zip(values[:-1], np.rint(times).astype(int), strict=True)
            for k in range(1, count)
        ]
        more = f" and {len(lost) - 8} more" if len(lost) > 8 else ""
        return f"lacks slices: number {', '.join(lost[:8])}{more} ({between})"
    return (
        f"has unevenly numbered slices: numbers differ by {gaps[wide]:g} {between}, "
        f"by {step:g} elsewhere"
    )
