"""Default noise of the interfaces of label volumes, for studies and diagnoses."""

from palpate.storage.values import Volume
from palpate.workers.comparison.observation.noise import SegmentationNoise

# Error of a segmented image: half a voxel, the accuracy of labels at a boundary, correlated over
# 4 mm, an assumption. A second segmentation of the scan at rest measures both.
DRAWN_VOXELS, DRAWN_LENGTH_MM = 0.5, 4.0
# The same for labels moved by the model: their voxels, and the rim of the body outside the mesh
# (0.07 mm for a body of 1 mm voxels and 1,500 nodes).
MOVED_VOXELS, MOVED_LENGTH_VOXELS = 0.25, 2.0
NUGGET_VOXELS = 0.08


def study_noise(reference: Volume, *loaded: Volume, imaged: bool) -> SegmentationNoise:
    """Return the assumed noise of images, or the voxel error of simulated scans.

    Parameters
    ----------
    imaged : bool
        Whether the loaded scans are images rather than simulated by the model.
    """
    voxel = max(side for scan in (reference, *loaded) for side in scan.spacing_mm)
    nugget = NUGGET_VOXELS * voxel
    if imaged:
        drawn = DRAWN_VOXELS * voxel
        return SegmentationNoise(drawn, DRAWN_LENGTH_MM, drawn, nugget)
    return SegmentationNoise(MOVED_VOXELS * voxel, MOVED_LENGTH_VOXELS * voxel, 0.0, nugget)
