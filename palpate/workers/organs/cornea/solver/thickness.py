"""A section whose posterior surface is deeper than it appears."""

from dataclasses import replace

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.mesh.t6_mesh import T6Mesh
from palpate.workers.organs.cornea.solver.candidate import Candidate
from palpate.workers.organs.cornea.solver.prepared_mesh import prepare
from palpate.workers.organs.cornea.solver.sensitivity import Change

# Difference step in millimetres.
STEP_MM = 1e-5


def thickness_change(candidate: Candidate) -> Change:
    """Return the change to a uniformly thicker cornea, per mm."""
    plus, minus = (thickened(candidate, sign * STEP_MM) for sign in (1, -1))
    return Change(plus, minus, STEP_MM)


def thickened(candidate: Candidate, by_mm: float, sideways: float = 0.0) -> Candidate:
    """Return a candidate with a deeper posterior surface.

    Parameters
    ----------
    candidate : Candidate
    by_mm : float
        Distance along the normal; negative makes the cornea thinner.
    sideways : float
        From -1 to 1: 0 moves the whole surface alike, 1 the middle but not the edges, like a
        distortion that grows towards the middle of an image.
    """
    prepared = candidate.prepared
    nodes = deeper(prepared.mesh, by_mm, sideways)
    mesh = replace(prepared.mesh, nodes_mm=nodes)
    return replace(candidate, prepared=prepare(mesh, prepared.model))


def deeper(mesh: T6Mesh, by_mm: float, sideways: float = 0.0) -> FloatArray:
    """Return the nodes of a mesh with a moved posterior surface; those in between follow."""
    x = mesh.nodes_mm
    above, normal = _nearest(x, x[mesh.anterior])
    below, _ = _nearest(x, x[mesh.posterior])
    depth = above / (above + below)
    middle, half = (x[:, 0].max() + x[:, 0].min()) / 2, np.ptp(x[:, 0]) / 2
    bow = 1.0 - sideways * ((x[:, 0] - middle) / half) ** 2
    return np.asarray(x - by_mm * (depth * bow)[:, None] * normal)


def _nearest(points: FloatArray, line: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distances of points from a polyline, and its outward normals there."""
    start, along = line[:-1], np.diff(line, axis=0)
    arm = points[:, None] - start
    part = np.clip((arm * along).sum(-1) / (along**2).sum(-1), 0, 1)
    distance = np.linalg.norm(arm - part[..., None] * along, axis=-1)
    nearest = distance.argmin(axis=1)
    tangent = along[nearest] / np.linalg.norm(along[nearest], axis=1, keepdims=True)
    return distance.min(axis=1), np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
