"""What the report shows of a body that was scanned: arrays to draw, rows to print."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from storage.values import FloatArray, TetMesh, Volume
from workers.diagnosis.diagnosis import Diagnosis
from workers.effects.inclusion import INCLUSION
from workers.pictures.cause_map import cause_map
from workers.pictures.drawings import (
    Arrays,
    bodies,
    cause_record,
    causes,
    local_means,
    overlap_rows,
)
from workers.pictures.overlap import predict

Json = dict[str, Any]
Moved = Mapping[str, Sequence[FloatArray]]
"""Displacements of the finest nodes in mm, one for each scan: "before", and "after" with the
effects accused, if there are any."""


def pictures_of_scans(
    found: Diagnosis,
    moved: Moved,
    reference: Volume,
    observed: Sequence[Volume],
    cut: Callable[[Volume], Volume],
) -> tuple[Arrays, Json]:
    """Bodies, maps and overlaps before and after.

    Parameters
    ----------
    found : Diagnosis
    moved : mapping of str to sequence of ndarray
    reference, observed : Volume and sequence of Volume
        `Tissue` labels.
    cut : callable
        Takes off what the scans do not show below the chest wall.

    Returns
    -------
    arrays : dict of str to ndarray
        See `workers.pictures.drawings`.
    told : dict
        ``overlap``: rows for each scan and interface; ``cause_map``: its loudest place.
    """
    seen = found.look
    finest = seen.subject.model.finest
    mesh = TetMesh(finest.nodes, finest.elements.tets)
    predicted = {
        when: [cut(predict(reference, mesh, u, scan)) for u, scan in zip(us, observed, strict=True)]
        for when, us in moved.items()
    }
    fits = {"before": seen.linear}
    if "after" in moved and found.best is not None:
        fits["after"] = found.best.fit.linearised(seen.subject)
    points = seen.subject.points
    shape = (len(observed), len(points))
    noise = np.sqrt((seen.linear.covariance_factor**2).sum(axis=1)).reshape(shape)
    residuals = {when: fit.residual.reshape(shape) for when, fit in fits.items()}
    names = [scan.name for scan in seen.subject.scans]
    arrays = bodies(reference, observed, predicted) | local_means(fits, points)
    told: Json = {
        "overlap": overlap_rows(names, observed, predicted, residuals, noise, points.interface)
    }
    if INCLUSION.name in seen.prints:
        centres = seen.places.offsets + np.asarray(seen.subject.frame.centre_mm)
        maps = {w: cause_map(f, seen.prints[INCLUSION.name], centres) for w, f in fits.items()}
        arrays |= causes(maps, reference)
        told["cause_map"] = {when: cause_record(m) for when, m in maps.items()}
    return arrays, told
