"""The printed results of the thesis: the numbers of chapters 3 and 4, with their tables.

M. A. Lago, "A new approach for the in-vivo characterization of the biomechanical behavior of
the breast and the cornea", UPV 2014. Distances in voxels refer to 0.2 mm.
"""

from dataclasses import dataclass

from palpate.workers.thesis.mesh_quality import MeshKind
from palpate.workers.thesis.phantom_compression import TargetName, View

VOXEL_MM = 0.2
HOURS, CORES, SIMULATIONS = 48.0, 12, 1000
MACHINE = "Intel Xeon X5650, 2.66 GHz, 12 cores, 64 GB"


@dataclass(frozen=True)
class Aspect:
    """A row of Table 4.2."""

    average: float
    worst: float


ASPECTS: dict[MeshKind, Aspect] = {
    "adaptive": Aspect(1.70, 8.86),
    "homogeneous": Aspect(1.55, 5.33),
}
ELEMENTS: dict[MeshKind, int] = {"adaptive": 900_000, "homogeneous": 425_000}
NODES = {"adaptive": 180_000, "homogeneous": 90_000}


@dataclass(frozen=True)
class Compared:
    """A row of Table 4.3: means of ten phantoms over their glandular compartments."""

    centroid_mm: float
    volume_mm3: float
    jc: float | None
    mhd_mm: float | None


TABLE_43: dict[View, Compared] = {
    "CC": Compared(2.54 * VOXEL_MM, 1759.4 * VOXEL_MM**3, 0.8257, 1.1792 * VOXEL_MM),
    "MLO": Compared(0.2683 * VOXEL_MM, 197.9 * VOXEL_MM**3, 0.8723, 1.2772 * VOXEL_MM),
}
MOONEY_RIVLIN: dict[View, Compared] = {
    "CC": Compared(0.66, 16.3, None, None),
    "MLO": Compared(0.17, 2.63, None, None),
}
SECONDS_PER_1000: dict[MeshKind, float] = {"adaptive": 23.0, "homogeneous": 15.0}
HOURS_OF_A_COMPRESSION = {
    ("adaptive", "CC"): 7.0,
    ("homogeneous", "CC"): 2.0,
    ("adaptive", "MLO"): 2.0,
    ("homogeneous", "MLO"): 1.45,
}

Constants = tuple[float, ...]
"""E_fat, eta_fat, E_glandular, eta_glandular and, with skin, E_skin, in kPa."""


@dataclass(frozen=True)
class Estimated:
    """A row of Tables 4.4 to 4.6; distances are in voxels of 0.2 mm."""

    phantom: int
    constants_kpa: Constants
    jc: float
    mhd_voxels: float


@dataclass(frozen=True)
class SearchTable:
    """One of Tables 4.4 to 4.6.

    Parameters
    ----------
    name : str
    rows : tuple of Estimated
    mean, sd : tuple of float
        In kPa.
    error : tuple of float
        Mean relative error of each constant, as a fraction.
    note : str
        Inconsistencies of the table.
    """

    name: str
    rows: tuple[Estimated, ...]
    mean: Constants
    sd: Constants
    error: Constants
    note: str = ""


SEARCHES: dict[TargetName, SearchTable] = {
    "X1": SearchTable(
        "Table 4.4",
        (
            Estimated(1, (9.746, 107.720, 49.812, 119.410), 0.947, 0.689),
            Estimated(2, (10.036, 104.840, 40.049, 126.520), 0.988, 0.20),
            Estimated(3, (9.766, 119.430, 47.541, 114.900), 0.944, 0.788),
            Estimated(4, (10.086, 113.560, 37.552, 110.840), 0.978, 0.422),
            Estimated(5, (10.303, 91.353, 40.256, 60.956), 0.913, 0.90),
        ),
        (9.987, 107.381, 43.042, 106.525),
        (0.234, 10.569, 5.314, 26.130),
        (0.0183, 0.1084, 0.1005, 0.2898),
    ),
    "X2": SearchTable(
        "Table 4.5",
        (
            Estimated(6, (7.538, 73.112, 29.826, 121.820), 0.991, 0.226),
            Estimated(7, (6.785, 96.682, 31.488, 154.810), 0.926, 0.667),
            Estimated(8, (7.523, 95.324, 28.292, 74.674), 0.953, 0.652),
            Estimated(9, (6.520, 75.593, 34.445, 180.770), 0.923, 0.850),
            Estimated(10, (7.532, 71.527, 29.717, 99.797), 0.988, 0.258),
        ),
        (7.180, 82.448, 30.754, 126.374),
        (0.490, 12.468, 2.353, 42.330),
        (0.0477, 0.1279, 0.0540, 0.3030),
    ),
    "X3": SearchTable(
        "Table 4.6",
        (
            Estimated(1, (10.086, 101.290, 37.390, 160.110, 1577.800), 0.933, 0.72),
            Estimated(2, (10.116, 102.534, 69.040, 159.300, 1492.338), 0.91, 2.29),
            Estimated(3, (9.886, 84.556, 40.958, 87.594, 1637.200), 0.961, 1.71),
            Estimated(4, (11.372, 87.682, 30.150, 165.830, 1502.500), 0.949, 1.18),
            Estimated(5, (11.452, 77.835, 40.307, 191.230, 1499.500), 0.90, 1.29),
        ),
        (10.369, 92.845, 37.817, 155.159, 1572.020),
        (1.029, 14.076, 4.503, 39.549, 69.689),
        (0.0795, 0.1282, 0.0700, 0.2008, 0.0456),
        "The printed row of phantom 2 does not give the printed statistics (its E_glandular alone "
        "would make that error 21.4 %); a row of 9049, 112862, 40280, 171031, 1643100 Pa gives "
        "all means and deviations and four of five errors. The row and the statistics are from "
        "two versions; the statistics are compared here.",
    ),
}

# Fig. 4.22: over the whole interval of eta_glandular.
LOWEST_JC, MOST_MHD_VOXELS = 0.93, 1.0
