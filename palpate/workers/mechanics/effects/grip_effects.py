"""Effects of grips, load cells, and the bed of a sheet."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray, IntArray
from palpate.workers.mechanics.effects.effect import (
    Effect,
    Values,
    from_zero,
    sum_of_vectors,
    two_sided,
    unchanged_problem,
)
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem
from palpate.workers.mechanics.model_parameters import KPA_PER_MM, NUMBER, N, percent

SKIN_BETWEEN_PADS = "A. Elouneg et al., Comput. Methods Appl. Mech. Eng. 373 (2021) 113503"

# --- grip slip
# Let moved regions follow their grips only in part.


GRIP_SLIP_NAME = "grip_slip"


def _grip_slip(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Shorten the prescribed displacements."""
    part = 1.0 - values[GRIP_SLIP_NAME]
    return replace(problem, holds=tuple(hold.scaled(part) for hold in problem.holds))


GRIP_SLIP = Effect(
    name="grip_slip",
    family="boundary",
    summary="The body slips in the grip that moves it.",
    parameters=(
        from_zero(
            GRIP_SLIP_NAME,
            NUMBER,
            0.9,
            "part of the grip's displacement that the body does not follow",
            limit=1.0,
            reading=percent("% of the displacement"),
        ),
    ),
    prior_sd=(0.2,),
    steps=(1e-3,),
    transform=_grip_slip,
    references=(SKIN_BETWEEN_PADS,),
)


# --- elastic bed
# Let the tissue under a sheet resist its displacement.


BED_NAME = "bed_stiffness"


def _elastic_bed(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add springs along the sheet."""
    stiffness = values[BED_NAME]
    springs = sum_of_vectors(problem.wall.spring_mpa_per_mm, (stiffness, stiffness, 0.0))
    return replace(problem, wall=replace(problem.wall, spring_mpa_per_mm=springs))


# 0.05 kPa/mm spreads a pull on skin of 25 N/m over sqrt(25 / 50) m/m: 22 mm.
ELASTIC_BED = Effect(
    name="elastic_bed",
    family="boundary",
    summary="The sheet is attached to tissue under it, which resists its displacement.",
    parameters=(
        from_zero(
            BED_NAME, KPA_PER_MM, KPA_PER_MM.to_inside(1.0), "stiffness of the bed of the sheet"
        ),
    ),
    prior_sd=(KPA_PER_MM.to_inside(0.05),),
    steps=(KPA_PER_MM.to_inside(1e-4),),
    transform=_elastic_bed,
    references=(SKIN_BETWEEN_PADS, "S. Evans, C. A. Holt, J. Strain Anal. Eng. Des. 44 (2009) 337"),
)


# --- load cell offset
# Let a load cell show a force without a load.


@dataclass(frozen=True, slots=True)
class OffsetColumns:
    """Columns of an offset of load cells, the last points of an experiment."""

    mm_per_n: tuple[float, ...]

    def __call__(
        self, points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
    ) -> FloatArray:
        """Return the change of each reading, in mm, for 1 N on each cell, shape (k, cells)."""
        cells = len(self.mm_per_n)
        found = np.zeros((len(points), cells))
        found[len(points) - cells :] = np.diag(self.mm_per_n)
        return found


def load_cell_offset(mm_per_n: Sequence[float], sd_n: float) -> Effect:
    """Return the effect of load cells with a constant offset.

    Parameters
    ----------
    mm_per_n : sequence of float
        Displacement that represents a force of 1 N, for each cell.
    sd_n : float
        Prior standard deviation of an offset.
    """
    names = [
        f"cell_offset_{n}" if len(mm_per_n) > 1 else "cell_offset"
        for n in range(1, 1 + len(mm_per_n))
    ]
    return Effect(
        name="load_cell_offset",
        family="observation",
        summary="The load cell reads a force without a load, or was zeroed under load.",
        parameters=tuple(
            two_sided(n, N, 20 * sd_n, "reading of the load cell without a load") for n in names
        ),
        prior_sd=(sd_n,) * len(names),
        steps=(0.01 * sd_n,) * len(names),
        transform=unchanged_problem,
        references=("ISO 376:2011, Metallic materials: calibration of force-proving instruments",),
        observation=OffsetColumns(tuple(mm_per_n)),
        sees="cells",
    )
