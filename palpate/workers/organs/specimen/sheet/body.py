"""Bodies of experiments on thin sheets."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import csr_matrix

from palpate.storage.values import FloatArray, IntArray, Volume
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.fem.problem.regions import Box
from palpate.workers.mechanics.sheet.mesh import sheet_mesh
from palpate.workers.mechanics.sheet.model import SheetModel
from palpate.workers.organs.specimen.body import FARTHEST_MM, Body
from palpate.workers.organs.specimen.keys.bodies import SheetSpec
from palpate.workers.organs.specimen.load_cells import LoadCell
from palpate.workers.organs.specimen.problem import region_of
from palpate.workers.organs.specimen.sheet.forward import SheetForward
from palpate.workers.organs.specimen.spec import SpecimenSpec


def body_of(spec: SpecimenSpec, voxels: Volume | None) -> Body:
    """Return the body of an experiment; see `Body`."""
    return SheetBody(spec, spec.body.sheet) if spec.body.sheet else Body(spec, voxels)


class SheetBody(Body):
    """A sheet at z = 0.

    Parameters
    ----------
    spec : SpecimenSpec
    sheet : SheetSpec
    """

    def __init__(self, spec: SpecimenSpec, sheet: SheetSpec) -> None:
        super().__init__(spec, None)
        self.outline_mm = np.array(sheet.corners_mm, np.float64)
        self.thickness_mm = sheet.thickness_mm

    @property
    def box_mm(self) -> tuple[FloatArray, FloatArray]:
        """See `Body.box_mm`."""
        low, high = self.outline_mm.min(axis=0), self.outline_mm.max(axis=0)
        return np.append(low, 0.0), np.append(high, 0.0)

    @property
    def wall_mm(self) -> float:
        """Always nan: a sheet has no wall."""
        return float("nan")

    def model(self, nodes: int) -> SheetModel:
        """See `Body.model`."""
        return sheet_mesh(self.outline_mm, self._borders(), nodes, self.thickness_mm)

    def frame(self, model: SheetModel) -> Frame:
        """See `Body.frame`."""
        return model.frame

    def at_points(self, model: SheetModel, points_mm: FloatArray) -> csr_matrix:
        """See `Body.at_points`."""
        return model.at_points(points_mm, FARTHEST_MM)

    def forward(self, cells: Sequence[LoadCell]) -> SheetForward:
        """See `Body.forward`."""
        return SheetForward(cells)

    def edges(self, model: SheetModel) -> IntArray:
        """See `Body.edges`."""
        return np.concatenate([model.border[:, [0, 2]], model.border[:, [2, 1]]])

    def _borders(self) -> Iterator[FloatArray]:
        """Yield the sides of all box regions, clipped to the surroundings of the sheet."""
        low, high = self.box_mm
        beyond = float(np.linalg.norm(high - low))
        for region in self.spec.regions.values():
            box = region_of(region)
            if not isinstance(box, Box):
                continue
            a = np.maximum(box.lower_mm, low - beyond)[:2]
            b = np.minimum(box.upper_mm, high + beyond)[:2]
            a, b = (np.round(corner, 2) for corner in (a, b))
            if (b > a).all() and box.lower_mm[2] <= 0 <= box.upper_mm[2]:
                corners = np.array([a, (b[0], a[1]), b, (a[0], b[1])])
                yield from np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
