"""Make the two segmentations of this example, and the constants that they hide.

::

    python examples/own-images/make.py

The breast is compressed by the solver of the blind tests, which shares no mechanics with the one
that a study uses: quadratic elements, its own contact, tighter tolerances. The boundaries are then
redrawn with an error of 0.25 mm, and both volumes are saved the way 3D Slicer saves a segmentation:
in patient coordinates (right, anterior, superior), with named segments.
"""

import tempfile
from pathlib import Path

import nrrd
import numpy as np

from palpate.volumes import Volume, read_volume
from palpate.workers.blind.breast_scene import Anatomy, Constants
from palpate.workers.blind.case_files import write_case
from palpate.workers.blind.random_case import Load, Truth

HERE = Path(__file__).parent
FORCE_N = 35.0
TRUTH = Truth(
    seed=43,
    kind="control",
    causes=(),
    anatomy=Anatomy(
        seed=43,
        lower_mm=62.0,
        upper_mm=78.0,
        half_width_mm=45.0,
        depth_mm=52.0,
        compartments=60,
        glandular_fraction=0.25,
    ),
    constants=Constants(E_fat_kpa=9.2, E_gl_kpa=33.0, eta_kpa=85.0),
    loads=(Load("y", FORCE_N),),
    noise_sd_mm=0.25,
)
SEGMENTS = {1: ("Fat", "0.9 0.83 0.53"), 2: ("Glandular", "0.87 0.55 0.45")}
PATIENT_MM = np.array([95.0, 62.0, -18.0])  # right, anterior, superior: of the body's origin


def in_patient_space(body: Volume) -> tuple[np.ndarray, np.ndarray]:
    """Return voxels [right, anterior, superior] and the centre of the first one, in mm.

    The frame of the body has x superior, y right and z anterior.
    """
    voxels = np.transpose(body.values, (1, 0, 2))
    x, y, z = body.origin_mm
    return voxels, PATIENT_MM + np.array([y, z, x])


def save(path: Path, body: Volume) -> None:
    """Write a segmentation as 3D Slicer does."""
    voxels, origin = in_patient_space(body)
    header = {
        "space": "right-anterior-superior",
        "space directions": np.eye(3) * body.spacing_mm[0],
        "space origin": origin,
        "space units": ["mm", "mm", "mm"],
        "kinds": ["domain"] * 3,
        "encoding": "gzip",
    }
    for number, (label, (name, colour)) in enumerate(SEGMENTS.items()):
        header |= {
            f"Segment{number}_ID": f"Segment_{label}",
            f"Segment{number}_Name": name,
            f"Segment{number}_Color": colour,
            f"Segment{number}_LabelValue": str(label),
            f"Segment{number}_Layer": "0",
        }
    nrrd.write(str(path), voxels, header, index_order="F")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder, "case")
        write_case(TRUTH, case, Path(folder, "truth"))
        save(HERE / "rest.seg.nrrd", read_volume(case / "reference.nrrd"))
        save(HERE / "compressed.seg.nrrd", read_volume(case / "deformed_y1.nrrd"))
