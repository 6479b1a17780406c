"""Printed results of chapter 5 of the thesis: two synthetic eyes and 24 measured ones.

M. A. Lago, PhD thesis, Universitat Politecnica de Valencia, 2014, Tables 5.1 and 5.2.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from palpate.workers.thesis.phantom_compression import Scale


class OgdenConstants(NamedTuple):
    """Constants of a two-term Ogden material as printed in the thesis."""

    mu1_pa: float
    alpha1: float
    mu2_pa: float
    alpha2: float

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus at rest G0 = 1/2 sum mu alpha, for terms mu/alpha (Eq. 5.1)."""
        return 0.5e-6 * (self.mu1_pa * self.alpha1 + self.mu2_pa * self.alpha2)


@dataclass(frozen=True)
class SyntheticEye:
    """One half of Table 5.1: known constants and the result of the thesis' search.

    Parameters
    ----------
    name : {"X1", "X2"}
    target, estimate : OgdenConstants
    printed_errors_percent : OgdenConstants
        Relative errors as printed, rounded by hand in places.
    jc, mhd_um : float
        Similarity of the two deformed sections.
    iop_mmhg, pachymetry_um : float
    """

    name: Literal["X1", "X2"]
    target: OgdenConstants
    estimate: OgdenConstants
    printed_errors_percent: OgdenConstants
    jc: float
    mhd_um: float
    iop_mmhg: float = 10.5
    pachymetry_um: float = 595.0

    @property
    def shear_modulus_error(self) -> float:
        """Relative error of the printed estimate's shear modulus at rest."""
        return self.estimate.shear_modulus_mpa / self.target.shear_modulus_mpa - 1


@dataclass(frozen=True)
class CohortEye:
    """One row of Table 5.2: a measured eye and its constants from the thesis.

    Parameters
    ----------
    patient : int
        1 to 12.
    side : {"left", "right"}
        The order left, right is given only in the table's caption.
    iop_mmhg, pachymetry_um : float
        Measured.
    constants : OgdenConstants
        Found by the thesis' search.
    jc, mhd_um : float
        Similarity of the simulated to the imaged deformed section.
    """

    patient: int
    side: Literal["left", "right"]
    iop_mmhg: float
    pachymetry_um: float
    constants: OgdenConstants
    jc: float
    mhd_um: float


TABLE_5_1 = (
    SyntheticEye(
        name="X1",
        target=OgdenConstants(11000, 30, 35000, 80),
        estimate=OgdenConstants(10711, 31.32, 33751, 82.44),
        printed_errors_percent=OgdenConstants(2.63, 4.4, 3.6, 3.05),
        jc=0.99,
        mhd_um=4.6,
    ),
    SyntheticEye(
        name="X2",
        target=OgdenConstants(36000, 50, 32500, 88),
        estimate=OgdenConstants(34031, 50.07, 32694, 89.71),
        printed_errors_percent=OgdenConstants(5.47, 0.14, 0.6, 1.94),
        jc=0.99,
        mhd_um=4.8,
    ),
)

# The thesis prints no bounds; these include every constant of Table 5.2.
EYE_BOUNDS: dict[str, tuple[float, float]] = {
    "mu1_pa": (1.0, 40_000.0),
    "alpha1": (0.1, 100.0),
    "mu2_pa": (1.0, 40_000.0),
    "alpha2": (0.1, 100.0),
}
# A section at rest, meshed with so many 6-node triangles; the target with three times as many.
EYE_ELEMENTS: dict[Scale, int] = {"sketch": 240, "reduced": 960, "full": 960}
FINER_TARGET = 3
# A cornea is thicker at the limbus; the tables print the centre alone.
THICKER_AT_LIMBUS_MM = 0.105


def case_of_eye(eye: SyntheticEye | CohortEye, elements: int) -> dict[str, Any]:
    """Return the case of a study, in the format of `workers.common_keys`.

    The jet has 15 kPa: with the printed 15 mmHg no cornea turns concave.
    """
    centre_mm = eye.pachymetry_um / 1000
    return {
        "organ": "cornea",
        "reference": {
            "section": {"central_mm": centre_mm, "peripheral_mm": centre_mm + THICKER_AT_LIMBUS_MM}
        },
        "mesh": {"elements": elements},
        "load": {"iop_mmhg": eye.iop_mmhg, "jet": {"pressure_kpa": 15}},
    }


# Mean row and standard deviations of Table 5.2 as printed: constants, JC, MHD in um. The printed
# mean of mu2 is truncated, not rounded (22962.6), and the rows give a mean MHD of 25.3 um.
PRINTED_AVERAGE = (OgdenConstants(26034, 75.11, 22962, 63.70), 0.87, 25.4)
PRINTED_SD = (OgdenConstants(9960, 26.03, 9531, 25.01), 0.03, 6.8)

# Section 5.5: the average constants of the table in every eye, mean and sd over the eyes.
AVERAGE_CORNEA_JC = (0.536, 0.256)
AVERAGE_CORNEA_MHD_UM = (79.38, 163.77)

# IOP mmHg, pachymetry um, mu1 Pa, alpha1, mu2 Pa, alpha2, JC, MHD um; left then right eye.
_ROWS = (
    (15.0, 533, 36508, 71.62, 13220, 50.17, 0.88, 22.6),
    (12.0, 535, 25239, 74.73, 15360, 79.10, 0.88, 23.0),
    (11.5, 499, 38160, 91.73, 29536, 83.21, 0.87, 21.2),
    (11.0, 520, 27220, 82.29, 31040, 90.24, 0.87, 23.0),
    (12.5, 458, 27261, 91.06, 29539, 46.53, 0.84, 30.8),
    (8.5, 479, 39492, 96.80, 14822, 6.13, 0.87, 24.4),
    (12.0, 520, 30434, 92.28, 7327, 32.74, 0.88, 25.0),
    (11.5, 524, 29588, 86.80, 31693, 4.37, 0.89, 19.8),
    (11.5, 580, 38885, 77.89, 29141, 60.15, 0.83, 31.4),
    (11.0, 601, 22120, 98.86, 13096, 91.94, 0.82, 32.2),
    (11.0, 567, 24495, 33.37, 19519, 80.66, 0.88, 21.6),
    (12.0, 568, 22546, 74.73, 16950, 80.65, 0.87, 23.0),
    (10.5, 527, 10978, 31.38, 33946, 79.82, 0.88, 21.0),
    (9.0, 540, 22921, 68.02, 20739, 70.84, 0.88, 21.0),
    (13.0, 595, 39721, 60.32, 14361, 69.21, 0.90, 19.8),
    (14.0, 588, 27156, 18.03, 38305, 80.82, 0.89, 20.6),
    (13.5, 606, 17503, 91.11, 32674, 53.86, 0.89, 21.4),
    (12.5, 613, 23161, 91.77, 3731, 78.22, 0.89, 21.0),
    (14.0, 584, 26511, 84.26, 23502, 37.52, 0.90, 20.6),
    (17.0, 596, 5119, 97.99, 34767, 56.81, 0.89, 19.8),
    (8.0, 513, 8458, 98.14, 27897, 91.71, 0.80, 41.0),
    (8.5, 522, 30704, 98.98, 15862, 43.92, 0.79, 43.2),
    (12.5, 558, 12330, 79.19, 21224, 83.78, 0.83, 35.8),
    (14.5, 555, 38327, 11.27, 32852, 76.47, 0.88, 24.4),
)

TABLE_5_2 = tuple(
    CohortEye(
        patient=number // 2 + 1,
        side="right" if number % 2 else "left",
        iop_mmhg=row[0],
        pachymetry_um=row[1],
        constants=OgdenConstants(*row[2:6]),
        jc=row[6],
        mhd_um=row[7],
    )
    for number, row in enumerate(_ROWS)
)
