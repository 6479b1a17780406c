r"""Noise of the points in the scans: its components, voxel layers, plates, and anchored readings.

The components are those of a case, at the first fit of its constants.

**Voxel layers.** A plate flattens skin, mostly parallel to the layers of voxels. Labels then show
the whole face at a border between two layers, up to half a voxel from its true position: all its
points share one error, uniformly distributed over a voxel of edge h. (On nine blind bodies without
a missing effect, in voxels of 0.8 mm, faces under the plates scattered by 0.26 mm, with an error
nearly linear in their position between two layers.) The mean of independent noise at the points is
never that large. A face tilted by theta relative to the layers crosses them within the correlation
length l of the segmentation, and its error averages out. Residuals of one interface in one scan
whose normals point the same way along a voxel axis therefore have

.. math:: C_{ij} = \frac{h^2}{12} w_i w_j e^{-4 |x_i - x_j| / h}, \quad
    w = \exp \left( -\frac{1}{2} \left( \frac{\pi l \tan \theta}{h} \right)^2 \right)

with x along that axis.

**Plates.** A point of the outline pressed by a plate is on the plate wherever it was drawn. The
points of a diagnosis are on the drawn outline, while the mesh faces cut the corners of a smoothed
outline, so a point is a few tenths of a millimetre above or below a face. On the free surface, this
offset moves with the body; under a plate, the surface becomes flat. A pressed point is therefore
followed at its foot on the mesh, and its residual excludes the segmentation error at rest.
(Followed with their offsets, points of three controls were outside the plate by 0.1 to 0.5 mm, all
in the same direction, since flat faces are inside a round body.) Labels at rest without such an
error come from one of our own meshes, which moves the offsets too; their points are followed as on
the free surface.

**Anchored readings.** Anchored scans have the same noise for every hypothesis. A residual is
evaluated at the predicted position of a material point. A hypothesis that moves the body by a few
mm evaluates it at another position on the segmented interface, with a different error. The misfits
of two hypotheses would then differ by the difference between two noise draws: tens of nats for a
thousand points, without any information. The error is therefore evaluated once, at the points
predicted by the nominal model.
Changes of a residual come from the interface averaged over a disc, which has less noise but the
same shape:

.. math:: r(x) = d(x_0) + (\bar d(x) - \bar d(x_0)) / |\nabla \bar d(x_0)|

A wider disc reduces the noise but, on a curved interface, also the slope. Each point uses the
widest disc on which its interface is flat, and the distance is scaled to restore the slope.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags_array
from scipy.spatial import KDTree

from palpate.storage.values import BoolArray, FloatArray, IntArray, Triple
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.comparison.observation.segmentation_noise import correlation, covariance
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.noise.noise_components import (
    LearntNoise,
    drawing_columns,
    pivoted,
    pose_columns,
    smooth_columns,
)
from palpate.workers.diagnosis.problem.inverse_problem import (
    Compare,
    FollowedPoints,
    InverseProblem,
    Scan,
)
from palpate.workers.diagnosis.problem.scan_prediction import ComparedScan
from palpate.workers.mechanics.fem.discretisation import LevelModel


def voxel_steps(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> FloatArray:
    """Return columns whose outer product is the module's covariance, shape (m, q), in mm.

    Parameters
    ----------
    inverse : InverseProblem
    predictions : sequence of ComparedScan
        Predicted points of each scan.
    """
    k, columns = len(inverse.points), [np.zeros((len(inverse.bias), 0))]
    for number, (scan, prediction) in enumerate(zip(inverse.scans, predictions, strict=True)):
        if scan.voxel_mm is None:
            continue
        for which, of_face in _faces(inverse, prediction, scan.voxel_mm):
            factor = pivoted(of_face, SETTINGS.noise.voxel_variance_mm2)
            placed = np.zeros((len(inverse.bias), factor.shape[1]))
            placed[number * k + np.flatnonzero(which)] = factor
            columns.append(placed)
    return np.hstack(columns)


def _faces(
    inverse: InverseProblem, at: ComparedScan, voxel_mm: Triple
) -> Iterator[tuple[BoolArray, FloatArray]]:
    """Yield masks of points facing one way along a voxel axis, with their covariance."""
    along = at.normals / np.maximum(np.linalg.norm(at.normals, axis=1), 1e-9)[:, None]
    for axis, h in enumerate(voxel_mm):
        cosine = np.clip(along[:, axis], -1.0, 1.0)
        slope = np.sqrt(1.0 - cosine**2) / np.maximum(np.abs(cosine), 1e-9)
        weight = np.exp(-0.5 * (np.pi * inverse.noise.correlation_mm * slope / h) ** 2)
        sd_mm = weight * h / np.sqrt(12.0)
        for interface in np.unique(inverse.points.interface):
            for side in (cosine > 0, cosine < 0):
                flat = sd_mm**2 > SETTINGS.noise.voxel_variance_mm2
                which = flat & side & (inverse.points.interface == interface)
                if which.any():
                    x = at.points[which, axis]
                    alike = np.exp(-4.0 * np.abs(x[:, None] - x) / h)
                    yield which, sd_mm[which][:, None] * sd_mm[which] * alike


def stated_noise(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> LearntNoise:
    """Return the noise as stated, for a problem whose constants have been fitted once.

    Parameters
    ----------
    inverse : InverseProblem
        Problem with the bias of its mesh and the given covariance.
    predictions : sequence of ComparedScan
        Comparison with each scan.
    """
    groups = np.tile(inverse.points.interface, len(inverse.scans))
    return LearntNoise(
        stated=stated_covariance(inverse),
        groups=groups,
        fixed=np.hstack([_drawing(inverse), voxel_steps(inverse, predictions)]),
        numerical=_numerical(inverse, predictions),
        scales=np.ones(int(groups.max()) + 1),
    )


def planned_covariance(inverse: InverseProblem) -> FloatArray:
    """Return the noise covariance of planned scans, shape (m, m), in mm^2.

    It is the given covariance, with poses and contour bias, for the points at rest.
    """
    scans, points = len(inverse.scans), inverse.points
    carried = np.ones((scans, len(points)))
    drawn = covariance(points, inverse.noise, scans) + _smoother(inverse, carried)
    fixed = _drawing(inverse)
    if inverse.is_segmented:
        centre_mm, at_rest = inverse.frame.centre_mm, ([points.points], [points.normals])
        moved, normals = (one * scans for one in at_rest)
        fixed = np.hstack([pose_columns(moved, normals, centre_mm, *inverse.pose_sd), fixed])
    return np.asarray(drawn + fixed @ fixed.T)


def _drawing(inverse: InverseProblem) -> FloatArray:
    """Return the columns of contour bias."""
    sd_mm = inverse.noise.sd_mm
    each = SETTINGS.pose.drawing * sd_mm if inverse.is_segmented else 0.0
    common = SETTINGS.noise.common * sd_mm
    return drawing_columns(inverse.points.interface, len(inverse.scans), common, each)


def stated_covariance(inverse: InverseProblem) -> FloatArray:
    """Return the given covariance of the noise, with its smoother part, (m, m) in mm^2."""
    carried = _carried(inverse)
    drawn = inverse.covariance
    if inverse.is_segmented:
        drawn = covariance(inverse.points, inverse.noise, len(inverse.scans), carried)
    return drawn + _smoother(inverse, carried)


def _carried(inverse: InverseProblem) -> FloatArray:
    """Return the share of the error at rest that enters each scan's residuals, shape (s, k)."""
    return 1.0 - np.stack([inverse.followed(scan).pressed for scan in inverse.scans])


def _smoother(inverse: InverseProblem, carried: FloatArray) -> FloatArray:
    """Return the covariance of the part of the noise that is smoother than given.

    `carried` is the share of the error at rest that enters each scan's residuals, shape (s, k).
    """
    settings, noise, scans = SETTINGS.noise, inverse.noise, len(inverse.scans)
    smooth = correlation(inverse.points, settings.smoother_lengths * noise.correlation_mm)
    at_rest = noise.reference_sd_mm * carried.ravel()
    found = np.kron(np.eye(scans), noise.sd_mm**2 * smooth)
    found += np.tile(smooth, (scans, scans)) * np.outer(at_rest, at_rest)
    return np.asarray(settings.smoother**2 * found)


def _numerical(inverse: InverseProblem, predictions: Sequence[ComparedScan]) -> FloatArray:
    """Return the columns of the numerical error, which grows with element size and load."""
    settings, shape = SETTINGS.numerical, (len(inverse.scans), -1)
    difference = np.sqrt((inverse.bias.reshape(shape) ** 2).mean(axis=1))
    least_mm = max(settings.least_mm, settings.of_nugget * inverse.noise.nugget_mm)
    each = np.hypot(settings.of_difference * difference, least_mm)
    alike = settings.state_correlation
    if not inverse.is_segmented:
        each = settings.of_difference * difference
        alike = settings.state_correlation_markers
    return smooth_columns(
        np.tile(inverse.points.points, (len(inverse.scans), 1)),
        np.concatenate([prediction.normals for prediction in predictions]),
        inverse.rows,
        np.repeat(each, len(inverse.points)),
        settings.length_mm,
        alike.between(inverse.directions),
    )


# Number of faces near a point that are searched for its foot.
NEAREST_FACES = 16


def with_pressed_points(inverse: InverseProblem, pressed: Sequence[FloatArray]) -> InverseProblem:
    """Return the problem with pressed points followed on the mesh surface.

    Parameters
    ----------
    inverse : InverseProblem
    pressed : sequence of ndarray, shape (k,)
        Pressed share of each point, 0 to 1, in each scan; see `pressed_shares`. If no point is
        pressed in any scan, the problem is returned unchanged.
    """
    if not any(share.any() for share in pressed):
        return inverse
    feet = _feet(inverse.model.finest, inverse.points.points)
    on_surface = feet @ inverse.model.finest.nodes
    scans = []
    for scan, share in zip(inverse.scans, pressed, strict=True):
        free = diags_array(1.0 - share)
        points = free @ inverse.points.points + share[:, None] * on_surface
        at_points = csr_matrix(free @ inverse.at_points + diags_array(share) @ feet)
        scans.append(replace(scan, followed=FollowedPoints(points, at_points, share)))
    return replace(inverse, scans=scans)


def pressed_shares(inverse: InverseProblem, pressed: BoolArray) -> FloatArray:
    """Return the pressed share of each point, shape (k,): 1 in a face with all corners pressed.

    Parameters
    ----------
    inverse : InverseProblem
    pressed : ndarray of bool, shape (n,)
        Nodes that a plate presses.
    """
    share = _feet(inverse.model.finest, inverse.points.points) @ pressed.astype(np.float64)
    return np.where(inverse.points.interface == 0, share, 0.0)


def _feet(level: LevelModel, points: FloatArray) -> csr_matrix:
    """Return the interpolation matrix from the nodes to the feet of points on the free surface.

    The foot is the projection on the plane of a face, moved to its rim if it misses the face.
    """
    faces = level.contact_nodes.index[level.contact_nodes.faces.corners]
    corners = level.nodes[faces]
    near = np.asarray(KDTree(corners.mean(axis=1)).query(points, k=NEAREST_FACES)[1])
    weights = _barycentric(points[:, None], corners[near])
    feet = np.einsum("kfc,kfcx->kfx", weights, corners[near])
    best = np.linalg.norm(feet - points[:, None], axis=2).argmin(axis=1)
    rows = np.arange(len(points))
    columns: IntArray = faces[near[rows, best]]
    shape = (len(points), len(level.nodes))
    return csr_matrix((weights[rows, best].ravel(), (np.repeat(rows, 3), columns.ravel())), shape)


def _barycentric(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return nonnegative weights of the corners (k, f, 3, 3), with sum 1, at points (k, 1, 3)."""
    a, b = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    p = points - corners[:, :, 0]
    aa, ab, bb = ((x * y).sum(axis=2) for x, y in ((a, a), (a, b), (b, b)))
    pa, pb = (p * a).sum(axis=2), (p * b).sum(axis=2)
    area = np.maximum(aa * bb - ab**2, 1e-12)
    second, third = (bb * pa - ab * pb) / area, (aa * pb - ab * pa) / area
    found = np.maximum(np.stack([1.0 - second - third, second, third], axis=2), 0.0)
    return np.asarray(found / found.sum(axis=2, keepdims=True))


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
    offsets = _disc(along, first * correlation_mm)
    for radius in wider:
        disc = _disc(along, radius * correlation_mm)
        _, average = _averaged(compare, disc, anchor, points)
        flat = np.linalg.norm(average, axis=1) > SETTINGS.points.flat
        offsets[:, flat] = disc[:, flat]
    return offsets


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
