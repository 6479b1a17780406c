"""Arrays for the pictures of a diagnosis: bodies, their shapes and the map of causes.

::

    local_<when>, local_<when>_sd              residuals averaged around each point
    shape_<interface>_vertices, _triangles     interfaces of the body at rest; see `shapes`
    labels_rest, labels_rest_frame             the body at rest
    labels_<scan>, labels_<scan>_frame         observed, before and after, in a common box
    cause_<when>, cause_frame                  scores between the places, nan where unknown
    cause_places                               places where a lump was tried

A frame is an array of shape (2, 3): the spacing and the centre of the first voxel, (x, y, z) in mm.
<when> is "before" for the fitted nominal model, or "after" for the model with the named effects.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.values import FloatArray, IntArray, Volume
from palpate.workers.comparison.observation.interface import InterfacePoints
from palpate.workers.comparison.similarity.score import Score
from palpate.workers.diagnosis.algebra.linear_fit import LinearFit
from palpate.workers.diagnosis.algebra.linearisation import Linearised
from palpate.workers.diagnosis.outcome.pictures.cause_map import CauseMap, voxels
from palpate.workers.diagnosis.outcome.pictures.local_mean import local_mean
from palpate.workers.diagnosis.outcome.pictures.overlap import (
    Distances,
    distances,
    on_one_box,
    overlaps,
    reachable_jc,
)
from palpate.workers.diagnosis.problem.acquisition import INTERFACES
from palpate.workers.diagnosis.schema.summary import LoudestPlace, OverlapFigures, OverlapRow
from palpate.workers.scan_threads import Each

Arrays = dict[str, NDArray[Any]]


def bodies(
    reference: Volume,
    observed: Sequence[Volume],
    predicted: Mapping[str, Sequence[Volume]],
) -> Arrays:
    """Return the labels of the body at rest and of every scan.

    Parameters
    ----------
    reference : Volume
        `Tissue` labels of the body at rest.
    observed : sequence of Volume
        Labels of the loaded scans.
    predicted : mapping of str to sequence of Volume
        Predicted labels for "before", and for "after" if an effect is named, cropped like the
        scans; see `workers.diagnosis.outcome.pictures.overlap.predict`.

    Raises
    ------
    InputError
        If a prediction is not on the lattice of its scan.
    """
    arrays: Arrays = {
        "labels_rest": np.asarray(reference.values, np.uint8),
        "labels_rest_frame": frame(reference),
    }
    for scan, body in enumerate(observed):
        shown = [
            body,
            *(predicted[when][scan] for when in ("before", "after") if when in predicted),
        ]
        box, origin = on_one_box(shown)
        arrays[f"labels_{scan}"] = box
        arrays[f"labels_{scan}_frame"] = np.array([body.spacing_mm, origin])
    return arrays


def local_means(fits: Mapping[str, Linearised], points: InterfacePoints) -> Arrays:
    """Return locally averaged residuals, which show regions rather than the noise of points.

    Parameters
    ----------
    fits : mapping of str to Linearised
        Linearised fits for "before", and for "after" if an effect is named.
    points : InterfacePoints
        The k points of the body at rest, compared in each scan.
    """
    arrays: Arrays = {}
    for when, fit in fits.items():
        mean, sd = local_mean(
            points.points,
            points.normals,
            points.interface,
            fit.residual.reshape(-1, len(points)),
            LinearFit(fit).covariance,
        )
        arrays[f"local_{when}"], arrays[f"local_{when}_sd"] = mean, sd
    return arrays


def overlap_rows(
    names: Sequence[str],
    areas_mm2: Sequence[Sequence[float]],
    observed: Sequence[Volume],
    predicted: Mapping[str, Sequence[Volume]],
    residuals: Mapping[str, FloatArray],
    noise: FloatArray,
    interface: IntArray,
    each: Each = map,
) -> list[OverlapRow]:
    """Compare bodies before and after, for every scan and interface.

    Parameters
    ----------
    names : sequence of str
        Names of the scans.
    areas_mm2 : sequence of sequence of float
        Areas of the interfaces in each scan.
    observed, predicted
        See `bodies`.
    residuals : mapping of str to ndarray, shape (scans, k)
        Signed distances in mm, with the keys of `predicted`.
    noise : ndarray, shape (scans, k)
        Standard deviations of the nominal residuals.
    interface : ndarray of int, shape (k,)
        The interface of each point.
    each : callable
        Applies a function to every item; see `workers.scan_threads`.

    Returns
    -------
    list of OverlapRow
        One row for each scan and interface; interfaces without points are omitted.
    """

    def rows_of(scan: int) -> list[OverlapRow]:
        body = observed[scan]
        scores = {when: overlaps(p[scan], body) for when, p in predicted.items()}
        rows = []
        for number, one in enumerate(INTERFACES):
            own = interface == number
            if not own.any():
                continue
            figures = {
                when: _figures(found[one.name], distances(residuals[when][scan], interface, number))
                for when, found in scores.items()
            }
            reachable = reachable_jc(body, one, areas_mm2[scan][number], noise[scan, own])
            after = figures.get("after")
            rows.append(OverlapRow(names[scan], one.name, reachable, figures["before"], after))
        return rows

    return [row for rows in each(rows_of, range(len(names))) for row in rows]


def _figures(score: Score, apart: Distances) -> OverlapFigures:
    return OverlapFigures(
        score.jc,
        score.dice,
        score.mhd_mm,
        score.mhd_voxels,
        score.gsf,
        apart.p50_mm,
        apart.p95_mm,
        apart.signed_mean_mm,
        apart.points,
    )


def causes(maps: Mapping[str, CauseMap], body: Volume) -> Arrays:
    """Return the interpolated scores for "before" and, if present, for "after"."""
    arrays: Arrays = {}
    for when, found in maps.items():
        drawn = voxels(found, body)
        arrays[f"cause_{when}"] = drawn.values
        arrays["cause_frame"] = frame(drawn)
        arrays["cause_places"] = found.places
    return arrays


def loudest_place(found: CauseMap) -> LoudestPlace:
    """Return the most significant place of a map, in plain numbers."""
    at = found.loudest
    x, y, z = found.places[at].tolist()
    return LoudestPlace(
        score=float(found.z[at]),
        x_mm=x,
        y_mm=y,
        z_mm=z,
        ln_ratio=float(found.estimate[at]),
        ln_ratio_sd=float(found.sd[at]),
        reached_by_noise=found.reached_by_noise,
        places=len(found.z),
        places_seen=int(found.seen.sum()),
    )


def frame(volume: Volume) -> FloatArray:
    """Return the spacing and origin of a volume, shape (2, 3)."""
    return np.array([volume.spacing_mm, volume.origin_mm], np.float64)
