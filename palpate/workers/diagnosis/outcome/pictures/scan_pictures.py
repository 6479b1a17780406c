"""Arrays and table rows for the report on a scanned body."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from palpate.storage.values import FloatArray, TetMesh, Volume
from palpate.workers.diagnosis.outcome.pictures.cause_map import cause_map
from palpate.workers.diagnosis.outcome.pictures.drawings import (
    Arrays,
    bodies,
    causes,
    local_means,
    loudest_place,
    overlap_rows,
)
from palpate.workers.diagnosis.outcome.pictures.overlap import predict
from palpate.workers.diagnosis.problem.preparation import SHAPES, ReadPrepared
from palpate.workers.diagnosis.schema.summary import CauseMapSummary, Summary
from palpate.workers.diagnosis.verdict.diagnosis import Diagnosis
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.scan_threads import Each

Displacements = Mapping[str, Sequence[FloatArray]]
"""Displacements of the finest nodes in mm for each scan, "before" and "after" any named effects."""


def pictures_of_scans(
    diagnosis: Diagnosis,
    effects: Sequence[Effect],
    displacements: Displacements,
    summary: Summary,
    reference: Volume,
    observed: Sequence[Volume],
    prepared: ReadPrepared,
    each: Each = map,
) -> tuple[Arrays, Summary]:
    """Return bodies, maps and overlaps before and after.

    Parameters
    ----------
    diagnosis : Diagnosis
    effects : sequence of Effect
        The catalogue; the map of the first effect that has one is drawn.
    displacements : mapping of str to sequence of ndarray
    summary : Summary
        Summary of the diagnosis.
    reference, observed : Volume and sequence of Volume
        `Tissue` labels.
    prepared : callable
        See `workers.diagnosis.problem.preparation`.
    each : callable
        Applies a function to every item; see `workers.scan_threads`.

    Returns
    -------
    arrays : dict of str to ndarray
        See `workers.diagnosis.outcome.pictures.drawings`.
    summary : Summary
        Summary with ``overlap``, and with ``cause_map`` if an effect with a map was tried.
    """
    analysis = diagnosis.analysis
    finest = analysis.inverse.model.finest
    mesh = TetMesh(finest.nodes, finest.elements.tets)
    predicted = {
        when: list(each(lambda u, scan: predict(reference, mesh, u, scan), us, observed))
        for when, us in displacements.items()
    }
    fits = {"before": analysis.linear}
    if "after" in displacements and diagnosis.best is not None:
        fits["after"] = diagnosis.best.fit.linearised(analysis.inverse)
    points = analysis.inverse.points
    shape = (len(observed), len(points))
    noise = np.sqrt((analysis.linear.covariance_factor**2).sum(axis=1)).reshape(shape)
    residuals = {when: fit.residual.reshape(shape) for when, fit in fits.items()}
    names = [scan.name for scan in analysis.inverse.scans]
    areas_mm2 = [scan.interface_mm2 for scan in analysis.inverse.scans]
    arrays = prepared(SHAPES) | bodies(reference, observed, predicted) | local_means(fits, points)
    overlap = overlap_rows(
        names, areas_mm2, observed, predicted, residuals, noise, points.interface, each
    )
    summary = replace(summary, overlap=tuple(overlap))
    mapped = next((e for e in effects if e.is_mapped), None)
    sensitivity = None if mapped is None else analysis.sensitivity_by_name.get(mapped.name)
    if mapped is not None and sensitivity is not None:
        centres = analysis.places(mapped) + np.asarray(analysis.inverse.frame.centre_mm)
        maps = {when: cause_map(fit, sensitivity, centres) for when, fit in fits.items()}
        arrays |= causes(maps, reference)
        loudest = {when: loudest_place(one) for when, one in maps.items()}
        causes_found = CauseMapSummary(loudest["before"], loudest.get("after"))
        summary = replace(summary, cause_map=causes_found)
    return arrays, summary
