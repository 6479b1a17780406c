r"""Scans whose noise stays the same for every hypothesis.

A residual is read where the model puts a material point. A hypothesis that lets the body slide
by some mm reads it elsewhere on the drawn interface, where its error is another one: misfits of two
hypotheses then differ by the difference of two draws of noise, which is tens of nats for a thousand
points, and tells nothing of either. So the error is read once, where the nominal model puts the
points, or the best effect (`diagnosis.verdict.second_reading`); how a hypothesis changes a residual
is read off the interface averaged over a disc, which has little noise left but the same shape:

.. math:: r(x) = d(x_0) + (\bar d(x) - \bar d(x_0)) / |\nabla \bar d(x_0)|

The wider the disc, the less noise is left of it, but on a curved interface also the less of its
slope: each point has the widest disc on which its interface is flat, and is stretched by what is
missing.
"""

from dataclasses import replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.diagnosis.problem.inverse_problem import Compare, Scan
from palpate.workers.diagnosis.settings.values import SETTINGS


def anchored(
    scan: Scan, anchor: FloatArray, points: InterfacePoints, correlation_mm: float
) -> Scan:
    """Return a scan whose noise is that of one place.

    Parameters
    ----------
    scan : Scan
    anchor : ndarray, shape (k, 3)
        Where the model puts the points, and the noise is read.
    points : InterfacePoints
        Of the reference.
    correlation_mm : float
        Of the noise, in which radii of discs are counted.
    """
    drawn = scan.drawn or scan.compare
    there, raw = drawn(anchor, points)
    disc = _flat_disc(drawn, anchor, points, raw, correlation_mm)
    average, along = _averaged(drawn, disc, anchor, points)
    slope = np.linalg.norm(along, axis=1)
    steeper = 1.0 / np.clip(slope, SETTINGS.points.least_slope, 1.0)
    error = there - steeper * average

    def compare(moved: FloatArray, of: InterfacePoints) -> tuple[FloatArray, FloatArray]:
        distance, normals = _averaged(drawn, disc, moved, of)
        return steeper * distance + error, steeper[:, None] * normals

    return replace(scan, compare=compare, drawn=drawn)


def _flat_disc(
    compare: Compare,
    anchor: FloatArray,
    points: InterfacePoints,
    normals: FloatArray,
    correlation_mm: float,
) -> FloatArray:
    """Return offsets, shape (n, k, 3), over the widest disc on which each interface is flat."""
    first, *wider = SETTINGS.points.discs
    _, along = _averaged(compare, _disc(normals, first * correlation_mm), anchor, points)
    found = _disc(along, first * correlation_mm)
    for radius in wider:
        disc = _disc(along, radius * correlation_mm)
        _, average = _averaged(compare, disc, anchor, points)
        flat = np.linalg.norm(average, axis=1) > SETTINGS.points.flat
        found[:, flat] = disc[:, flat]
    return found


def _averaged(
    compare: Compare, disc: FloatArray, moved: FloatArray, points: InterfacePoints
) -> tuple[FloatArray, FloatArray]:
    """Return distances and their derivatives over a disc about each point."""
    found = [compare(moved + offset, points) for offset in disc]
    distances, normals = zip(*found, strict=True)
    return np.mean(distances, axis=0), np.mean(normals, axis=0)


def _disc(normals: FloatArray, radius_mm: float) -> FloatArray:
    """Return offsets across each normal, shape (n, k, 3)."""
    n = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-9)[:, None]
    least = np.eye(3)[np.abs(n).argmin(axis=1)]
    u = np.cross(n, least)
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(n, u)
    offsets = [np.zeros_like(n)]
    for part, count in SETTINGS.points.disc:
        turns = 2 * np.pi * np.arange(count) / count
        offsets += [part * radius_mm * (np.cos(t) * u + np.sin(t) * v) for t in turns]
    return np.stack(offsets)
