"""A cornea prepared and solved in one call."""

from palpate.workers.organs.cornea.material.constants import CorneaConstants
from palpate.workers.organs.cornea.material.load import CorneaLoad
from palpate.workers.organs.cornea.material.model import CorneaModel
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.solver.prepared_mesh import prepare
from palpate.workers.organs.cornea.solver.solve import CorneaSolution, solve_prepared


def solve_cornea(
    mesh: T6Mesh, constants: CorneaConstants, load: CorneaLoad, model: CorneaModel
) -> CorneaSolution:
    """Return the solution of one cornea on a given mesh."""
    return solve_prepared(prepare(mesh, model), constants, load)
