"""Export of volumes as NIfTI-1, with the names of labels in a ``LabelTable``.

The table is a header extension, as written by TotalSegmentator and Connectome Workbench and
read by `workers.body.images.nifti`; 3D Slicer shows the labels without their names.
"""

from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import escape

import nibabel as nib
import numpy as np

from palpate.storage.backends.atomic import explained, replacing
from palpate.storage.values import Volume

SCANNER = 1
NO_PLACE = 0
IGNORED_BY_OTHERS = 0
"""Extension code that programs skip unless they look for its text."""


def export_nifti(path: Path, volume: Volume, names: Mapping[int, str]) -> None:
    """Write a volume in RAS; one with unknown position keeps only its spacing.

    Parameters
    ----------
    path : Path
        Ends in ``.nii`` or ``.nii.gz``.
    volume : Volume
    names : mapping of int to str
        Names of the labels.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    values = np.asarray(volume.values)
    if values.dtype.kind in "biu":  # NIfTI programs rarely read 64-bit labels
        values = values.astype(np.min_scalar_type(max(int(values.max(initial=0)), 1)))
    affine = np.diag([*volume.spacing_mm, 1.0])
    affine[:3, 3] = volume.origin_mm
    affine[:2] *= -1  # LPS to RAS
    image = nib.Nifti1Image(values.transpose(), affine)
    image.header.set_xyzt_units("mm")
    code = SCANNER if volume.place_known else NO_PLACE
    image.set_sform(affine, code)
    image.set_qform(affine, code)
    if names:
        extension = nib.nifti1.Nifti1Extension(IGNORED_BY_OTHERS, _table(names).encode())
        image.header.extensions.append(extension)
    with explained(path), replacing(path) as temporary:
        nib.save(image, temporary)


def _table(names: Mapping[int, str]) -> str:
    labels = "".join(f'<Label Key="{k}">{escape(name)}</Label>' for k, name in names.items())
    return (
        '<?xml version="1.0" encoding="UTF-8"?><CaretExtension><VolumeInformation Index="0">'
        f"<LabelTable>{labels}</LabelTable><VolumeType>Label</VolumeType>"
        "</VolumeInformation></CaretExtension>"
    )
