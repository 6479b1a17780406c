"""What the interfaces of a study's volumes are taken to err by, where nobody states it."""

from storage.values import Volume
from workers.comparison.observation.noise import SegmentationNoise

# What an image that somebody has drawn is taken to err by, in voxels, and over which length.
DRAWN_VOXELS, DRAWN_LENGTH_MM = 0.5, 4.0
# The same of labels that the model has moved: their voxels, and what its mesh cuts off the
# body's rim (0.07 mm of a body of 1 mm voxels and 1,500 nodes).
MOVED_VOXELS, MOVED_LENGTH_VOXELS = 0.25, 2.0
NUGGET_VOXELS = 0.08


def study_noise(reference: Volume, target: Volume, imaged: bool) -> SegmentationNoise:
    """Return half a voxel over 4 mm for images, else what voxels leave of an interface.

    Parameters
    ----------
    imaged : bool
        Whether the target is an image; else the model has made it.
    """
    voxel = max(*reference.spacing_mm, *target.spacing_mm)
    nugget = NUGGET_VOXELS * voxel
    if imaged:
        drawn = DRAWN_VOXELS * voxel
        return SegmentationNoise(drawn, DRAWN_LENGTH_MM, drawn, nugget)
    return SegmentationNoise(MOVED_VOXELS * voxel, MOVED_LENGTH_VOXELS * voxel, 0.0, nugget)
