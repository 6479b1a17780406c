"""The equations of a cornea: out-of-balance force and tangent under a stage of the load."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.material.constants import CorneaConstants, OgdenLaw
from palpate.workers.organs.cornea.material.load import CorneaLoad
from palpate.workers.organs.cornea.mesh.t6_geometry import point_geometry
from palpate.workers.organs.cornea.solver.envelope_lu import Factors, factorise, new_values
from palpate.workers.organs.cornea.solver.prepared_mesh import PreparedMesh
from palpate.workers.organs.cornea.solver.surface_pressure import (
    SurfacePoints,
    add_pressure,
    jet_points,
)
from palpate.workers.organs.cornea.solver.t6_assembly import NOTHING, Elements, assemble


class Prestress(NamedTuple):
    """The state of the imaged cornea; each method of `prestress` uses a part of it.

    Parameters
    ----------
    initial_stress : ndarray, shape (m, q, 4)
        S11, S22, S12, S33 in MPa.
    prestretch : ndarray, shape (m, q, 4)
        F11, F12, F21, F22 from the stress-free state to `rest_mm`.
    out_of_plane : ndarray, shape (m, q)
        Stretch along z or around the axis from the stress-free state to the image.
    rest_mm : ndarray, shape (n, 2)
        Nodes without pressure.
    support_mm : ndarray, shape (k, 2)
        Positions at which the elastic support of the limbus carries no force.
    """

    initial_stress: FloatArray
    prestretch: FloatArray
    out_of_plane: FloatArray
    rest_mm: FloatArray
    support_mm: FloatArray


class Stage(NamedTuple):
    """Pressures in MPa and the fraction of the motion of the eye."""

    iop_mpa: float
    jet_mpa: float
    motion: float

    def towards(self, other: "Stage", fraction: float) -> "Stage":
        """Return the stage at a fraction of the way to another one."""
        return Stage(*(a + fraction * (b - a) for a, b in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class System:
    """A cornea with its constants, load and prestress.

    Parameters
    ----------
    prepared : PreparedMesh
    law : OgdenLaw
    load : CorneaLoad
    jet : SurfacePoints
    prestress : Prestress
    elements : Elements
    """

    prepared: PreparedMesh
    law: OgdenLaw
    load: CorneaLoad
    jet: SurfacePoints
    prestress: Prestress
    elements: Elements

    @property
    def image_stage(self) -> Stage:
        """Return the stage in the image of the undeformed cornea."""
        return Stage(self.load.iop_mpa, 0.0, 0.0)

    @property
    def jet_stage(self) -> Stage:
        """Return the stage under the full jet."""
        load = self.load
        return Stage(load.iop_mpa + load.iop_rise_mpa, load.jet_pressure_mpa, 1.0)

    def with_prestress(self, prestress: Prestress) -> "System":
        """Return the system in another state of prestress."""
        elements = _elements(self.prepared, prestress)
        return replace(self, prestress=prestress, elements=elements)

    def from_rest(self, u: FloatArray) -> FloatArray:
        """Return a displacement relative to the prestretch, given one relative to the image."""
        return u + (self.prepared.mesh.nodes_mm - self.prestress.rest_mm)

    def held_at(self, u: FloatArray, stage: Stage) -> FloatArray:
        """Return a displacement with the clamped limbus at its position in the stage."""
        if not self.prepared.clamped:
            return u
        u = u.copy()
        u[self.prepared.limbus.nodes] = self.prepared.limbus.motion(self.load, stage.motion)
        return u

    def residual(self, u: FloatArray, stage: Stage) -> tuple[FloatArray, float]:
        """Return the out-of-balance force of the unknowns and the smallest J."""
        return self._evaluate(u, stage, NOTHING)

    def linearise(self, u: FloatArray, stage: Stage) -> tuple[FloatArray, float, Factors]:
        """Return the out-of-balance force, the smallest J and the factored tangent."""
        residual, min_j, values = self.tangent(u, stage)
        return residual, min_j, factorise(self.prepared.envelope, values, self.prepared.unknowns)

    def tangent(self, u: FloatArray, stage: Stage) -> tuple[FloatArray, float, FloatArray]:
        """Return the out-of-balance force, the smallest J and the entries of the tangent."""
        values = new_values(self.prepared.envelope)
        residual, min_j = self._evaluate(u, stage, values)
        return residual, min_j, values

    def _evaluate(
        self, u: FloatArray, stage: Stage, values: FloatArray
    ) -> tuple[FloatArray, float]:
        prepared = self.prepared
        equations, envelope = prepared.equations, prepared.envelope
        residual = np.zeros(prepared.unknowns)
        inside = self.from_rest(u)
        min_j = assemble(
            inside, self.elements, self.law, prepared.kind, equations, residual, envelope, values
        )
        x = prepared.mesh.nodes_mm + u
        for points, pressure in ((prepared.posterior, stage.iop_mpa), (self.jet, stage.jet_mpa)):
            if pressure != 0:
                add_pressure(x, points, pressure, equations, residual, envelope, values)
        if prepared.model.limbus_mpa_per_mm is not None:
            self._add_support(x, stage, residual, values)
        return residual, min_j

    def _add_support(
        self, x: FloatArray, stage: Stage, residual: FloatArray, values: FloatArray
    ) -> None:
        """Add the force and the stiffness of an elastic limbus."""
        prepared, limbus = self.prepared, self.prepared.limbus
        assert prepared.model.limbus_mpa_per_mm is not None
        stiffness = prepared.model.limbus_mpa_per_mm * limbus.mass
        anchor = self.prestress.support_mm + limbus.motion(self.load, stage.motion)
        force = stiffness @ (x[limbus.nodes] - anchor)
        rows, columns = np.nonzero(stiffness)
        for component in range(2):
            unknowns = prepared.equations[limbus.nodes, component]
            free = unknowns >= 0
            residual[unknowns[free]] += force[free, component]
            if len(values):
                i, j = unknowns[rows], unknowns[columns]
                both = (i >= 0) & (j >= 0)
                at = prepared.envelope.row_starts[i[both]] + j[both]
                values[at] += stiffness[rows[both], columns[both]]


def system_of(prepared: PreparedMesh, constants: CorneaConstants, load: CorneaLoad) -> System:
    """Return a cornea that is stress-free in the image.

    Raises
    ------
    InputError
        If the jet extends beyond the cornea.
    """
    mesh = prepared.mesh
    jet = jet_points(mesh.nodes_mm, mesh.anterior, load, prepared.axisymmetric)
    shape = prepared.geometry.weights.shape
    prestretch = np.zeros((*shape, 4))
    prestretch[..., [0, 3]] = 1.0
    prestress = Prestress(
        initial_stress=np.zeros((*shape, 4)),
        prestretch=prestretch,
        out_of_plane=np.ones(shape),
        rest_mm=mesh.nodes_mm,
        support_mm=prepared.limbus.position_mm,
    )
    elements = _elements(prepared, prestress)
    return System(prepared, constants.law(), load, jet, prestress, elements)


def _elements(prepared: PreparedMesh, prestress: Prestress) -> Elements:
    """Return the triangles relative to their stress-free state."""
    method = prepared.model.prestress
    geometry = prepared.geometry
    if method == "inverse" and prestress.rest_mm is not prepared.mesh.nodes_mm:
        geometry = point_geometry(
            prepared.mesh,
            prestress.rest_mm,
            prepared.model.quadrature_points,
            prepared.axisymmetric,
        )
    gradients, hoop, weights = geometry
    stretch = prestress.out_of_plane
    if method == "mulf":
        F0 = prestress.prestretch.reshape(*weights.shape, 2, 2)
        area = F0[..., 0, 0] * F0[..., 1, 1] - F0[..., 0, 1] * F0[..., 1, 0]
        gradients = np.swapaxes(F0, -1, -2) @ gradients
        hoop = hoop * stretch[..., None]
        weights = weights / (area * stretch)
    elif method == "inverse":
        weights = weights / stretch
    return Elements(
        prepared.mesh.triangles,
        gradients,
        hoop,
        weights,
        prestress.prestretch,
        stretch if method == "mulf" else np.ones_like(stretch),
        prestress.initial_stress,
        prepared.stiffness,
    )
