r"""Scans with the same noise for every hypothesis.

A residual is evaluated at the predicted position of a material point. A hypothesis that moves the
body by a few mm evaluates it at another position on the segmented interface, with a different
error. The misfits of two hypotheses would then differ by the difference between two noise draws:
tens of nats for a thousand points, without any information. The error is therefore evaluated once,
at the points predicted by the nominal model or the best effect
(`diagnosis.verdict.second_reading`). Changes of a residual come from the interface averaged over a
disc, which has less noise but the same shape:

.. math:: r(x) = d(x_0) + (\bar d(x) - \bar d(x_0)) / |\nabla \bar d(x_0)|

A wider disc reduces the noise but, on a curved interface, also the slope. Each point uses the
widest disc on which its interface is flat, and the distance is scaled to restore the slope.
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
    """Return a scan with the noise fixed at its value at an anchor.

    Parameters
    ----------
    scan : Scan
    anchor : ndarray, shape (k, 3)
        Predicted positions of the points, at which the noise is evaluated.
    points : InterfacePoints
        Points of the reference scan.
    correlation_mm : float
        Correlation length of the noise, in which the discs' radii are measured.
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
    """Return distances and their derivatives averaged over a disc about each point."""
    found = [compare(moved + offset, points) for offset in disc]
    distances, normals = zip(*found, strict=True)
    return np.mean(distances, axis=0), np.mean(normals, axis=0)


def _disc(normals: FloatArray, radius_mm: float) -> FloatArray:
    """Return offsets perpendicular to each normal, shape (n, k, 3)."""
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
