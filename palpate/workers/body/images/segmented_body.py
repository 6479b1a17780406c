"""A segmented body as one piece without holes, surrounded by air, or in coarser voxels."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import label

from palpate.storage.values import BoolArray, Tissue, Volume
from palpate.workers.body.images.tissue_labels import crop_to_body, resample_labels

# Width of the added air, larger than the blur of an interface.
AIR_VOXELS = 4


def one_body(labels: Volume, filling: Tissue = Tissue.FAT) -> Volume:
    """Keep the largest connected piece of tissue and fill its enclosed air.

    Air inside a breast and tissue outside it are segmentation errors; each would
    be an interface that the other scans of the body lack.

    Parameters
    ----------
    labels : Volume
        `Tissue` labels.
    filling : Tissue
        Tissue that replaces enclosed air.

    Returns
    -------
    Volume
        On the same lattice; the volume itself if there is nothing to do.
    """
    tissue = labels.values != Tissue.AIR
    pieces, count = label(tissue)
    body = tissue
    if count > 1:
        body = pieces == int(np.argmax(np.bincount(pieces[tissue])))
    # Holes open to the chest wall, where the scan was cut, are kept.
    whole = _filled(body)
    if count <= 1 and np.array_equal(whole, tissue):
        return labels
    values = np.where(body, labels.values, labels.values.dtype.type(Tissue.AIR))
    values[whole & ~body] = filling
    return replace(labels, values=values)


def _filled(body: BoolArray) -> BoolArray:
    """Return the body and all air inside it that is not connected to the outside by faces."""
    # Four times as fast as `binary_fill_holes`, which dilates the outside step by step.
    pieces, _ = label(np.pad(~body, 1, constant_values=True))
    return np.asarray(pieces[1:-1, 1:-1, 1:-1] != pieces[0, 0, 0])


def in_air(labels: Volume) -> Volume:
    """Return the body in a box with air around it, except at the chest wall, where it is cut.

    A volume may end where the body touches a plate; its surface there is not a cut.

    Raises
    ------
    InputError
        If the volume is all air.
    """
    tight = crop_to_body(labels, margin_voxels=0)
    more = AIR_VOXELS
    values = np.pad(tight.values, ((0, more), (more, more), (more, more)))
    x, y, z = tight.origin_mm
    dx, dy, _ = tight.spacing_mm
    return replace(tight, values=values, origin_mm=(x - more * dx, y - more * dy, z))


def in_coarser_voxels(volume: Volume, spacing_mm: float) -> Volume:
    """Resample a volume over the same box at a coarser spacing, by nearest neighbour.

    A volume whose voxels are already (almost) that large is returned unchanged.
    """
    if max(volume.spacing_mm) > spacing_mm * (1 - 1e-6):
        return volume
    spacing = np.asarray(volume.spacing_mm)
    size = spacing * np.asarray(volume.shape_xyz)
    nx, ny, nz = (int(n) for n in np.ceil(size / spacing_mm - 1e-6))
    ox, oy, oz = (float(o) for o in volume.origin_mm - spacing / 2 + spacing_mm / 2)
    three = (spacing_mm, spacing_mm, spacing_mm)
    return resample_labels(volume, Volume(np.empty((nz, ny, nx), np.uint8), three, (ox, oy, oz)))
