"""A mesh with its latest preparation, for the candidates of one process."""

from palpate.workers.organs.cornea.material.model import CorneaModel
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.solver.prepared_mesh import PreparedMesh, prepare


class MeshForModels:
    """A mesh that is prepared for a model on first use, and again for another model.

    Candidates of a search share one preparation unless an option of the model varies.

    Parameters
    ----------
    mesh : T6Mesh
    """

    def __init__(self, mesh: T6Mesh) -> None:
        self.mesh = mesh
        self._last: PreparedMesh | None = None

    def prepared(self, model: CorneaModel) -> PreparedMesh:
        """Return the mesh prepared for a model.

        Raises
        ------
        InputError
            As for `workers.organs.cornea.solver.prepared_mesh.prepare`.
        """
        last = self._last
        if last is None or last.model != model:
            last = self._last = prepare(self.mesh, model)
        return last
