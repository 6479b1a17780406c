"""FElupe as an independent solver: tetrahedra, or locking-free hexahedra, in pure Python.

Its `NeoHooke` is ``mu/2 (I1bar - 3) + kappa/2 (J - 1)^2``, as in our law.
"""

from dataclasses import dataclass

import felupe
import numpy as np

from palpate.storage.values import FloatArray, TetMesh, Triple

GRAVITY_MM_PER_S2 = 9806.65
TOLERANCE = 1e-10  # out-of-balance force over the force of the supports


@dataclass(frozen=True, eq=False)
class Answer:
    """Displacement, (n, 3) in mm, and internal force of the body on each node, (n, 3) in N.

    At held nodes the internal force is exerted by the support and gravity.
    """

    displacement_mm: FloatArray
    force_n: FloatArray


def solve_tets(
    mesh: TetMesh, mu_mpa: FloatArray, kappa_mpa: FloatArray, held_mm: FloatArray, steps: int = 4
) -> Answer:
    """Return the equilibrium of plain linear tetrahedra, with the load applied in `steps`.

    Parameters
    ----------
    mesh : TetMesh
    mu_mpa, kappa_mpa : ndarray, shape (m,)
    held_mm : ndarray, shape (n, 3)
        Prescribed displacement; NaN if free.
    """
    region = felupe.RegionTetra(felupe.Mesh(mesh.nodes, mesh.tets, "tetra"))
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    # Quadrature points first, then elements.
    law = felupe.NeoHooke(mu=mu_mpa[None], bulk=kappa_mpa[None])
    return _march(felupe.SolidBody(law, field), field, held_mm, (0.0, 0.0, 0.0), 0.0, steps)


def solve_hexahedra(
    mesh: felupe.Mesh,
    mu_mpa: float,
    kappa_mpa: float,
    held_mm: FloatArray,
    gravity_g: Triple,
    density_t_per_mm3: float = 1e-9,
    steps: int = 4,
) -> Answer:
    """Return the equilibrium of hexahedra with separate pressure and volume ratio (Q1-P0)."""
    field = felupe.FieldContainer([felupe.Field(felupe.RegionHexahedron(mesh), dim=3)])
    law = felupe.NeoHooke(mu=mu_mpa)
    solid = felupe.SolidBodyNearlyIncompressible(law, field, bulk=kappa_mpa)
    return _march(solid, field, held_mm, gravity_g, density_t_per_mm3, steps)


def _march(
    solid: felupe.SolidBody,
    field: felupe.FieldContainer,
    held_mm: FloatArray,
    gravity_g: Triple,
    density_t_per_mm3: float,
    steps: int,
) -> Answer:
    weight = felupe.SolidBodyForce(field, scale=density_t_per_mm3)
    where = np.isfinite(held_mm).ravel()
    for step in range(1, steps + 1):
        part = step / steps
        weight.update(part * GRAVITY_MM_PER_S2 * np.array(gravity_g))
        felupe.newtonraphson(
            items=[solid, weight],
            dof0=np.flatnonzero(where),
            dof1=np.flatnonzero(~where),
            ext0=part * held_mm.ravel()[where],
            tol=TOLERANCE,
            verbose=0,
        )
    force = solid.results.force.toarray().reshape(-1, 3)
    return Answer(field[0].values.copy(), force)
