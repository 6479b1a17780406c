"""Boundary value problems, the input of the solver. Units: mm, N, MPa."""

from collections.abc import Mapping
from dataclasses import dataclass

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Triple
from palpate.workers.mechanics.fem.problem.fields import WALL_TO_NIPPLE, FibreField, Variation
from palpate.workers.mechanics.fem.problem.loads import (
    SLIDING_WALL,
    Attachment,
    DeadForce,
    Hold,
    Load,
    Pressure,
    Wall,
)
from palpate.workers.mechanics.materials.base import Isochoric

# Gravity in mm/s^2.
GRAVITY_MM_PER_S2 = 9806.65


@dataclass(frozen=True, slots=True)
class Constants:
    """Elastic constants of one tissue.

    Parameters
    ----------
    young_mpa : float
        Young's modulus E, > 0.
    poisson : float
        Poisson's ratio, in (0, 0.5).
    fibre_mpa : float
        Fibre stiffness eta of thesis Eq. 4.6, >= 0.
    second_fibre_mpa : float
        Stiffness of a second family of fibres, >= 0.
    stiffening : float
        c2 / mu of Yeoh's law, ``mu ((I1bar - 3) / 2 + c2/mu (I1bar - 3)^2)``, >= 0.
    density_t_per_mm3 : float
        Density; 1e-9 for water.
    law : Isochoric, optional
        Another law for the matrix instead of neo-Hooke's and Yeoh's. Young's modulus and
        Poisson's ratio then only determine the bulk modulus.
    growth : float
        Ratio of the stress-free volume of the tissue to its volume in the undeformed body, > 0;
        the same along all axes.

    Raises
    ------
    InputError
        If a constant is outside its range.
    """

    young_mpa: float
    poisson: float = 0.49
    fibre_mpa: float = 0.0
    second_fibre_mpa: float = 0.0
    stiffening: float = 0.0
    density_t_per_mm3: float = 1e-9
    law: Isochoric | None = None
    growth: float = 1.0

    def __post_init__(self) -> None:
        if not (self.young_mpa > 0 and 0 < self.poisson < 0.5):
            raise InputError(
                "A tissue needs E > 0 and 0 < nu < 0.5, got "
                f"E = {self.young_mpa * 1e3:g} kPa, nu = {self.poisson:g}."
            )
        if min(self.fibre_mpa, self.second_fibre_mpa, self.stiffening, self.density_t_per_mm3) < 0:
            raise InputError(
                "A tissue needs eta, its strain stiffening and its density >= 0, got "
                f"eta = {self.fibre_mpa * 1e3:g} and {self.second_fibre_mpa * 1e3:g} kPa, "
                f"c2/mu = {self.stiffening:g}, density {self.density_t_per_mm3 * 1e12:g} kg/m3."
            )
        if not self.growth > 0:
            raise InputError(f"A tissue needs a growth > 0, got {self.growth:g}.")

    @property
    def mu_mpa(self) -> float:
        """Shear modulus mu = E / 2(1 + nu) (thesis Eq. 4.8)."""
        return self.young_mpa / (2 * (1 + self.poisson))

    @property
    def kappa_mpa(self) -> float:
        """Bulk modulus kappa = E / 3(1 - 2 nu), so that d = 2 / kappa (thesis Eq. 4.8)."""
        return self.young_mpa / (3 * (1 - 2 * self.poisson))


@dataclass(frozen=True, slots=True)
class Membrane:
    """Skin as an incompressible neo-Hookean sheet on the free surface.

    Parameters
    ----------
    young_mpa : float
        Young's modulus E, > 0.
    thickness_mm : float
        > 0.
    wrinkles : bool
        Fold where it would be compressed, see `workers.mechanics.fem.elements.membrane`. A sheet
        that does not wrinkle resists compression, and inverts elements under it if it is much
        stiffer than they are.

    Raises
    ------
    InputError
        If a constant is outside its range.
    """

    young_mpa: float
    thickness_mm: float
    wrinkles: bool = True

    def __post_init__(self) -> None:
        if not (self.young_mpa > 0 and self.thickness_mm > 0):
            raise InputError(
                "Skin needs E > 0 and thickness > 0, got "
                f"E = {self.young_mpa * 1e3:g} kPa, thickness = {self.thickness_mm:g} mm."
            )


@dataclass(frozen=True, slots=True)
class Problem:
    """Boundary value problem: one loading of one body.

    Parameters
    ----------
    constants : mapping of Tissue to Constants
        Must include every tissue in the mesh.
    load : ForceControl, DistanceControl or NoPlates
    membrane : Membrane, optional
        Skin on the free surface, if the mesh does not resolve it.
    fibres : FibreField
        Fibre directions in the undeformed body.
    literal_fibre : bool
        Let fibres also resist compression, as a literal reading of thesis Eq. 4.6
        implies. Many equilibria may then exist; by default fibres act in tension
        only.
    isochoric_fibre : bool
        Measure fibres by I4bar = J^(-2/3) I4, as FEBio does.
    wall : Wall
        Support by the chest wall.
    attachments : tuple of Attachment
        Springs on patches of the boundary.
    variations : tuple of Gradient or Inclusion
        Deviations of the stiffness from that of the tissue.
    gravity_g : tuple of float
        Body force in multiples of gravity.
    imaged_gravity_g : tuple of float
        Gravity during imaging, in multiples of gravity: the imaged shape is then not
        stress-free, and the stress-free shape is computed first.
    pressures : tuple of Pressure
    forces : tuple of DeadForce
    holds : tuple of Hold
    plain_elements : bool
        Textbook linear tetrahedra without the nodal average; they lock, and do not grow.
    tolerance_mm : float
        Upper bound of the last full Newton step on the finest mesh.
    friction_steps : int
        Load steps in which friction is followed, each ending in equilibrium; >= 1. The plates'
        travel with four steps agrees with eight within 0.3 %.
    restarts : bool
        Solve from rest if starting from the equilibrium of a similar problem fails.

    Raises
    ------
    InputError
        If plain elements are combined with growth.
    """

    constants: Mapping[Tissue, Constants]
    load: Load
    membrane: Membrane | None = None
    fibres: FibreField = WALL_TO_NIPPLE
    literal_fibre: bool = False
    isochoric_fibre: bool = False
    wall: Wall = SLIDING_WALL
    attachments: tuple[Attachment, ...] = ()
    variations: tuple[Variation, ...] = ()
    gravity_g: Triple = (0.0, 0.0, 0.0)
    imaged_gravity_g: Triple = (0.0, 0.0, 0.0)
    pressures: tuple[Pressure, ...] = ()
    forces: tuple[DeadForce, ...] = ()
    holds: tuple[Hold, ...] = ()
    plain_elements: bool = False
    tolerance_mm: float = 2e-3
    friction_steps: int = 8
    restarts: bool = True

    def __post_init__(self) -> None:
        if self.plain_elements and any(c.growth != 1 for c in self.constants.values()):
            raise InputError("Plain elements cannot grow; leave out plain_elements or growth.")


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Two problems around the present one, `step` apart in a parameter."""

    plus: Problem
    minus: Problem
    step: float
