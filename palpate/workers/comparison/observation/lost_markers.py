"""Detection of the frames in which a marker was lost, however they are recorded.

A tracker that loses a marker leaves the cell empty, writes the same number for all three
coordinates (0, -1, 9999), misplaces the marker for some frames, or repeats its
last position while all others move.
"""

import itertools
from collections.abc import Mapping

import numpy as np

from palpate.storage.values import BoolArray, FloatArray, IntArray

# A marker that moves this many times more than any other has jumped.
ALONE = 5.0
# So has a marker that moves this many times more than usual.
UNUSUAL = 20.0
# Minimum number of frames that repeat a position, while other markers move, to be stale.
STALE_FRAMES = 3
# Steps smaller than this fraction of the largest count as rest.
REST = 0.1
# Markers at rest more often than this while others move are never considered stale.
OFTEN_STILL = 0.1


def without_lost(places_mm: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the positions of markers, shape (t, 3) each, with nan where a marker was lost."""
    names = list(places_mm)
    seen = np.stack([np.asarray(places_mm[name], np.float64) for name in names])
    seen[~np.isfinite(seen)] = np.nan
    lost = np.isnan(seen).any(axis=2) | (seen == 0).all(axis=2)
    lost |= _placeholders(seen, lost)
    lost |= _excursions(seen, lost)
    lost |= _stale(seen, lost)
    seen = np.where(lost[..., None], np.nan, seen)
    return dict(zip(names, seen, strict=True))


def _placeholders(seen: FloatArray, lost: BoolArray) -> BoolArray:
    """Return a mask of frames with a placeholder number in all coordinates, shape (k, t)."""
    same = ~lost & (seen[..., 0] == seen[..., 1]) & (seen[..., 1] == seen[..., 2])
    found = np.zeros_like(lost)
    for number in np.unique(seen[..., 0][same]):
        here = same & (seen[..., 0] == number)
        if here.any(axis=1).sum() > 1:
            found |= here
        else:
            found |= here & _jumped(seen, lost | here, here)
    return found


def _jumped(seen: FloatArray, lost: BoolArray, asked: BoolArray) -> BoolArray:
    """Return a mask of the `asked` frames in which the marker is far from its other positions."""
    found = np.zeros_like(lost)
    for marker, frame in np.argwhere(asked):
        known = np.flatnonzero(~lost[marker])
        if not len(known):
            continue
        nearest = known[np.abs(known - frame).argmin()]
        jump = np.linalg.norm(seen[marker, frame] - seen[marker, nearest])
        others = np.linalg.norm(seen[:, frame] - seen[:, nearest], axis=1)[~lost[:, frame]]
        steps = np.linalg.norm(np.diff(seen[marker, known], axis=0), axis=1)
        usual = _usual(steps) * abs(frame - nearest)
        found[marker, frame] = jump > ALONE * max(usual, others.max(initial=0.0))
    return found


def _usual(steps: FloatArray) -> float:
    """Return a typical nonzero step; 0 if there are too few.

    It is the lower quartile, because many of the few steps may be jumps.
    """
    moved = steps[steps > 0]
    return float(np.quantile(moved, 0.25)) if len(moved) > 4 else 0.0


def _excursions(seen: FloatArray, lost: BoolArray) -> BoolArray:
    """Return a mask of frames in which a single marker has jumped away, before it jumps back."""
    found = np.zeros_like(lost)
    if len(seen) < 2:
        return found
    for marker, places in enumerate(seen):
        known = np.flatnonzero(~lost[marker]).astype(np.int32)
        steps = np.linalg.norm(np.diff(places[known], axis=0), axis=1)
        others = _largest_other_step(seen, lost, marker, known)
        limit = np.maximum(ALONE * others, UNUSUAL * _usual(steps))
        jumps = np.flatnonzero(steps > limit)
        returned = -1
        for out, back in itertools.pairwise(jumps.tolist()):
            apart = np.linalg.norm(places[known[back + 1]] - places[known[out]])
            if out != returned and apart * ALONE < min(steps[out], steps[back]):
                found[marker, known[out + 1 : back + 1]] = True
                returned = back
    return found


def _largest_other_step(
    seen: FloatArray, lost: BoolArray, marker: int, known: IntArray
) -> FloatArray:
    """Return the longest step of any other marker between known frames, shape (len(known) - 1,)."""
    steps = np.linalg.norm(np.diff(seen[:, known], axis=1), axis=2)
    bad = lost[:, known]
    steps = np.where(bad[:, 1:] | bad[:, :-1], 0.0, steps)
    return np.asarray(np.delete(steps, marker, axis=0).max(axis=0, initial=0.0))


def _stale(seen: FloatArray, lost: BoolArray) -> BoolArray:
    """Return a mask of frames that repeat a marker's last position while others move."""
    found = np.zeros_like(lost)
    if len(seen) < 2 or seen.shape[1] < STALE_FRAMES + 2:
        return found
    places = np.where(lost[..., None], np.nan, seen)
    changes = np.abs(np.diff(places, axis=1))
    steps = np.linalg.norm(changes, axis=2)
    resolution = float(changes[changes > 0].min(initial=np.inf))
    for marker, own in enumerate(steps):
        rest = np.nan_to_num(np.delete(steps, marker, axis=0))
        others = np.median(rest, axis=0)
        moving = others > REST * others.max(initial=0.0)
        for first, last in _runs(own == 0):
            outside = moving.copy()
            outside[first : last + 1] = False
            usual = own[outside & np.isfinite(own)]
            if moving[first : last + 1].sum() < STALE_FRAMES or not len(usual):
                continue
            net = np.linalg.norm(places[:, last + 1] - places[:, first], axis=1)
            if np.median(np.nan_to_num(np.delete(net, marker))) < ALONE * resolution:
                continue  # no motion beyond rounding
            goes_along = np.median(usual) > REST * np.median(others[outside])
            if goes_along and (usual == 0).mean() < OFTEN_STILL:
                found[marker, first + 1 : last + 2] = True
    return found


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the first and last index of each run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
