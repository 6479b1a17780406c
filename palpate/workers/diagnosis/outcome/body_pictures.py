r"""Pictures of a diagnosis as arrays: bodies, their overlap with the scans, shapes and maps.

::

    local_<when>, local_<when>_sd              residuals averaged around each point
    shape_<interface>_vertices, _triangles     interfaces of the body at rest; see `shapes`
    labels_rest, labels_rest_frame             the body at rest
    labels_<scan>, labels_<scan>_frame         observed, before and after, in a common box
    cause_<when>, cause_frame                  scores between the places, nan where unknown
    cause_places                               places where a lump was tried

A frame is an array of shape (2, 3): the spacing and the centre of the first voxel, (x, y, z) in mm.
<when> is "before" for the fitted nominal model, or "after" for the model with the named effects.
A body without voxels is outlined by its sharp edges, at rest and deformed.

The overlap of predicted and observed bodies is given in the usual measures for comparing images.
The reference labels are moved by the simulated displacement onto the lattice of the observed scan
and compared interface by interface: Jaccard and Dice coefficients, modified Hausdorff distance and
geometric similarity function. The verdict does not use these numbers, because they saturate and
ignore the noise. They show the size of a gap in familiar terms.

The Jaccard coefficient that is reachable despite segmentation noise follows from the area S of an
interface and the mean distance by which the noise moves it, because two bodies of volume V then
differ by :math:`D = S \,\overline{|e|}`:

.. math:: JC = \frac{V - D/2}{V + D/2}, \qquad
          \overline{|e|} = \sqrt{2/\pi}\,\overline{\sigma} .
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Triple, Volume
from palpate.workers.comparison.observation.interface_residual import Interface, InterfacePoints
from palpate.workers.comparison.similarity_score import Score, Scorer
from palpate.workers.comparison.surface_layer import warp_with_skin
from palpate.workers.diagnosis.linearisation import LinearFit, Linearised
from palpate.workers.diagnosis.outcome.diagnosis_summary import (
    CauseMapSummary,
    LoudestPlace,
    OverlapFigures,
    OverlapRow,
    Summary,
)
from palpate.workers.diagnosis.outcome.residual_maps import CauseMap, cause_map, local_mean, voxels
from palpate.workers.diagnosis.problem.planned_acquisition import INTERFACES
from palpate.workers.diagnosis.problem.prepared_parts import SHAPES, ReadPrepared
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect


@dataclass(frozen=True, slots=True)
class Distances:
    """Distances of the points on one interface from the scan.

    Parameters
    ----------
    p50_mm, p95_mm : float
        Median and 95th percentile of the absolute distance.
    signed_mean_mm : float
        Mean signed distance; positive if the model is, on average, outside the observed tissue.
    points : int
    """

    p50_mm: float
    p95_mm: float
    signed_mean_mm: float
    points: int


def predict(labels: Volume, mesh: TetMesh, displacement_mm: FloatArray, observed: Volume) -> Volume:
    """Return the deformed body on the lattice of a scan, starting at its first slice with tissue.

    Below the lowest slice in which it shows the body, the scan may have been cropped.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels of the body at rest.
    mesh : TetMesh
        Mesh of the body at rest, n nodes.
    displacement_mm : ndarray, shape (n, 3)
    observed : Volume
        The scan to compare with.

    Raises
    ------
    InputError
        If the displacement does not fit the mesh or is not finite.
    """
    found = warp_with_skin(labels, mesh, displacement_mm, observed)
    x, y, z = found.origin_mm
    below = max(0, round((observed.origin_mm[2] - z) / found.spacing_mm[2]))
    origin_mm = (x, y, z + below * found.spacing_mm[2])
    return replace(found, values=found.values[below:], origin_mm=origin_mm) if below else found


def overlaps(
    predicted: Volume, observed: Volume, interfaces: Sequence[Interface] = INTERFACES
) -> dict[str, Score]:
    """Compare the volumes that each interface encloses in two bodies on one lattice.

    Parameters
    ----------
    predicted, observed : Volume
        `Tissue` labels; their boxes may differ.
    interfaces : sequence of Interface

    Returns
    -------
    dict of str to Score
        Score by interface name.

    Raises
    ------
    InputError
        If the lattices differ, or `observed` has no tissue inside an interface.
    """
    return {i.name: Scorer(observed, i.inside).score(predicted) for i in interfaces}


def reachable_jc(
    observed: Volume, interface: Interface, area_mm2: float, noise_mm: FloatArray
) -> float:
    """Return the Jaccard coefficient that a perfect model would reach despite the noise.

    Parameters
    ----------
    observed : Volume
        `Tissue` labels.
    interface : Interface
    area_mm2 : float
        Area of the interface in the scan.
    noise_mm : ndarray, shape (k,)
        Standard deviations of the residuals of points on the interface, small compared with
        the thickness of the tissue.

    Raises
    ------
    InputError
        If there are no points.
    """
    if not len(noise_mm):
        raise InputError(f"The noise of the {interface.name} needs at least one point, found none.")
    inside = np.isin(observed.values, [int(tissue) for tissue in interface.inside])
    volume = float(inside.sum()) * observed.voxel_mm3
    differing = area_mm2 * float(np.sqrt(2.0 / np.pi) * noise_mm.mean())
    return max(0.0, (volume - differing / 2) / (volume + differing / 2))


def distances(residual_mm: FloatArray, interface: IntArray, number: int) -> Distances:
    """Return the distance statistics of one interface in one scan.

    Parameters
    ----------
    residual_mm : ndarray, shape (k,)
        Signed distances, positive outside the observed tissue.
    interface : ndarray of int, shape (k,)
        The interface of each point.
    number : int
        Index of the interface.

    Raises
    ------
    InputError
        If the interface has no points.
    """
    own = residual_mm[interface == number]
    if not own.size:
        raise InputError(f"Interface number {number} has none of the {len(residual_mm)} points.")
    p50, p95 = np.quantile(np.abs(own), (0.5, 0.95))
    return Distances(float(p50), float(p95), float(own.mean()), own.size)


def on_one_box(volumes: Sequence[Volume]) -> tuple[NDArray[np.uint8], Triple]:
    """Return labels on one lattice as a single array, in a common bounding box.

    Parameters
    ----------
    volumes : sequence of Volume
        n volumes of `Tissue` labels; their boxes may differ.

    Returns
    -------
    labels : ndarray of uint8, shape (n, nz, ny, nx)
        Labels; air where a volume has no voxel.
    origin_mm : tuple of float
        Centre of the first voxel of the box, (x, y, z).

    Raises
    ------
    InputError
        If the volumes are on different lattices.
    """
    first = volumes[0]
    spacing = np.asarray(first.spacing_mm)
    starts = []
    for volume in volumes:
        if not volume.on_lattice_of(first):
            raise InputError(
                "The labels must share a lattice, but the first volume has voxels of "
                f"{first.spacing_mm} mm from {first.origin_mm} mm and another has voxels of "
                f"{volume.spacing_mm} mm from {volume.origin_mm} mm. Warp the labels onto the "
                "lattice of the scan."
            )
        away = (np.asarray(volume.origin_mm) - first.origin_mm) / spacing
        starts.append(np.rint(away).astype(int)[::-1])
    low = np.min(starts, axis=0)
    ends = [s + v.values.shape for s, v in zip(starts, volumes, strict=True)]
    box = np.full((len(volumes), *np.max(ends, axis=0) - low), Tissue.AIR, np.uint8)
    for into, volume, start in zip(box, volumes, starts, strict=True):
        z, y, x = start - low
        nz, ny, nx = volume.values.shape
        into[z : z + nz, y : y + ny, x : x + nx] = volume.values
    ox, oy, oz = (np.asarray(first.origin_mm) + low[::-1] * spacing).tolist()
    return box, (ox, oy, oz)


Arrays = dict[str, NDArray[Any]]


def bodies(
    reference: Volume, observed: Sequence[Volume], predicted: Mapping[str, Sequence[Volume]]
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
        scans; see `workers.diagnosis.outcome.body_pictures.predict`.

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
        Standard deviations of the segmentation.
    interface : ndarray of int, shape (k,)
        The interface of each point.
    each : callable
        Applies a function to every item; see `workers.kernels_and_threads`.

    Returns
    -------
    list of OverlapRow
        One row for each scan and interface; interfaces without points are omitted.
    """

    def rows_of(scan: int) -> list[OverlapRow]:
        body = observed[scan]
        scores = {when: overlaps(p[scan], body) for when, p in predicted.items()}
        rows = []
        for number, boundary in enumerate(INTERFACES):
            own = interface == number
            if not own.any():
                continue
            figures = {
                when: _figures(
                    overlap[boundary.name], distances(residuals[when][scan], interface, number)
                )
                for when, overlap in scores.items()
            }
            reachable = reachable_jc(body, boundary, areas_mm2[scan][number], noise[scan, own])
            after = figures.get("after")
            rows.append(OverlapRow(names[scan], boundary.name, reachable, figures["before"], after))
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
    index = found.loudest
    x, y, z = found.places[index].tolist()
    return LoudestPlace(
        score=float(found.z[index]),
        x_mm=x,
        y_mm=y,
        z_mm=z,
        ln_ratio=float(found.estimate[index]),
        ln_ratio_sd=float(found.sd[index]),
        reached_by_noise=found.reached_by_noise,
        places=len(found.z),
        places_seen=int(found.seen.sum()),
    )


def frame(volume: Volume) -> FloatArray:
    """Return the spacing and origin of a volume, shape (2, 3)."""
    return np.array([volume.spacing_mm, volume.origin_mm], np.float64)


SHARP_DEGREES = 40.0


def edge_arrays(
    nodes: FloatArray, edges: IntArray, displacements: Mapping[str, Sequence[FloatArray]]
) -> Arrays:
    """Return the edges of a body at rest and deformed, for pictures.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
        Positions at rest, in mm.
    edges : ndarray, shape (e, 2)
        See `sharp_edges`.
    displacements : mapping of str to sequence of ndarray, shape (n, 3)
        Displacements in every state, "before" and "after"; those on another mesh are ignored.

    Returns
    -------
    dict of str to ndarray
        ``edges_rest`` (e, 2, 3), ``edges_before`` and ``edges_after`` (states, e, 2, 3), in mm.
    """
    found: Arrays = {"edges_rest": nodes[edges]}
    for when, states in displacements.items():
        if all(np.shape(u) == nodes.shape for u in states):
            found[f"edges_{when}"] = np.stack([(nodes + u)[edges] for u in states])
    return found


def sharp_edges(nodes: FloatArray, triangles: IntArray, degrees: float = SHARP_DEGREES) -> IntArray:
    """Return the edges where a closed surface bends by more than an angle, shape (e, 2).

    Examples
    --------
    >>> from palpate.workers.body.mesh.mesh_geometry import boundary_triangles
    >>> nodes = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    >>> faces = boundary_triangles(np.array([[0, 1, 2, 3]], np.int32))
    >>> len(sharp_edges(nodes, faces))
    6
    """
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    pairs = np.sort(triangles[:, ((0, 1), (1, 2), (2, 0))].reshape(-1, 2), axis=1)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    # In a closed surface, every edge occurs twice, once for each adjacent triangle.
    first, second = order[::2], order[1::2]
    bend = (normals[first // 3] * normals[second // 3]).sum(axis=1)
    return np.asarray(pairs[first[bend < np.cos(np.radians(degrees))]])


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
        See `workers.diagnosis.problem.prepared_parts`.
    each : callable
        Applies a function to every item; see `workers.kernels_and_threads`.

    Returns
    -------
    arrays : dict of str to ndarray
        See `workers.diagnosis.outcome.body_pictures`.
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
    if analysis.inverse.learnt is not None:
        # What the model misses can make the learnt noise too large, never the stated one.
        noise = noise / np.maximum(1.0, analysis.inverse.learnt.scales[points.interface])
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
        loudest = {when: loudest_place(fit_map) for when, fit_map in maps.items()}
        causes_found = CauseMapSummary(loudest["before"], loudest.get("after"))
        summary = replace(summary, cause_map=causes_found)
    return arrays, summary
