"""A cornea prepared and solved in one call."""

from palpate.workers.organs.cornea.cornea_problem import prepare
from palpate.workers.organs.cornea.corneal_model import CorneaConstants, CorneaLoad, CorneaModel
from palpate.workers.organs.cornea.prestressed_equilibrium import CorneaSolution, solve_prepared
from palpate.workers.organs.cornea.section_mesh import T6Mesh


def solve_cornea(
    mesh: T6Mesh, constants: CorneaConstants, load: CorneaLoad, model: CorneaModel
) -> CorneaSolution:
    """Return the solution of one cornea on a given mesh."""
    return solve_prepared(prepare(mesh, model), constants, load)
