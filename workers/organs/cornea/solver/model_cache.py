"""A mesh with what was last prepared from it, for the candidates of one process."""

from palpate.workers.organs.cornea.material.model import CorneaModel
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.solver.prepared_mesh import PreparedMesh, prepare


class MeshForModels:
    """A mesh that is prepared when a model is first asked for, and again for another model.

    Candidates of a search that varies no option of the model share one preparation.

    Parameters
    ----------
    mesh : T6Mesh
    """

    def __init__(self, mesh: T6Mesh) -> None:
        self.mesh = mesh
        self._last: PreparedMesh | None = None

    def prepared(self, model: CorneaModel) -> PreparedMesh:
        """Return the mesh, prepared for a model.

        Raises
        ------
        InputError
            As for `workers.organs.cornea.solver.prepared_mesh.prepare`.
        """
        last = self._last
        if last is None or last.model != model:
            last = self._last = prepare(self.mesh, model)
        return last
