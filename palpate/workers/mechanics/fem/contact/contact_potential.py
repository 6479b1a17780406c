"""Nodes and faces that may touch a plate, and the contact energy with its derivatives."""

from dataclasses import dataclass

import numpy as np

from palpate.storage.values import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class ContactFaces:
    """Triangles between the contact nodes.

    Parameters
    ----------
    corners : ndarray of int32, shape (f, 3)
        Indices into the contact nodes.
    stiffness : ndarray, shape (f,)
        Area times penalty, in N/mm.
    """

    corners: IntArray
    stiffness: FloatArray


NO_FACES = ContactFaces(np.zeros((0, 3), np.int32), np.zeros(0))


@dataclass(frozen=True, eq=False)
class ContactNodes:
    """Nodes that may touch a plate.

    Parameters
    ----------
    index : ndarray of int32, shape (c,)
        Their numbers in the mesh.
    stiffness : ndarray, shape (c,)
        Nodal area times penalty, in N/mm.
    faces : ContactFaces
        Without faces, an edge acts at the nodes alone.
    """

    index: IntArray
    stiffness: FloatArray
    faces: ContactFaces = NO_FACES


@dataclass(frozen=True, eq=False)
class ContactPotential:
    """Energy E(x, t) of the contact nodes and the travel t, with its derivatives.

    Parameters
    ----------
    energy : float
        mJ.
    force : ndarray, shape (c, 3)
        dE/dx of each contact node, in N.
    stiffness : ndarray, shape (c, 3, 3)
        N/mm.
    travel_force : float
        dE/dt, the force that closes the plates, in N.
    coupling : ndarray, shape (c, 3)
        Mixed second derivative with respect to x and t, in N/mm.
    travel_stiffness : float
    """

    energy: float
    force: FloatArray
    stiffness: FloatArray
    travel_force: float
    coupling: FloatArray
    travel_stiffness: float

    def __add__(self, other: "ContactPotential") -> "ContactPotential":
        return ContactPotential(
            self.energy + other.energy,
            self.force + other.force,
            self.stiffness + other.stiffness,
            self.travel_force + other.travel_force,
            self.coupling + other.coupling,
            self.travel_stiffness + other.travel_stiffness,
        )


def no_contact(nodes: ContactNodes) -> ContactPotential:
    """Return a potential that is zero."""
    c = len(nodes.index)
    return ContactPotential(0.0, np.zeros((c, 3)), np.zeros((c, 3, 3)), 0.0, np.zeros((c, 3)), 0.0)
