r"""Overlap of predicted and observed bodies, in the usual measures for comparing images.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, TetMesh, Tissue, Triple, Volume
from palpate.workers.comparison.observation.interface import Interface
from palpate.workers.comparison.similarity.score import Score, Scorer
from palpate.workers.comparison.warp.surface_layer import warp_with_skin
from palpate.workers.diagnosis.problem.acquisition import INTERFACES


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
