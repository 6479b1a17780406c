"""Boundary value problems, the input of the solver, and their outcome. Units: mm, N, MPa.

A problem has constants for each tissue, fields inside the body (fibre directions, gradients of
stiffness, inclusions) and loads. Its outcome::

    solve --> converged                      a displacement in equilibrium
          `-> diverged(reason)               an ordinary ending, scored worst
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray, Tissue, Triple
from palpate.workers.mechanics.fem.loads_and_regions import (
    SLIDING_WALL,
    Attachment,
    DeadForce,
    Hold,
    Load,
    Pressure,
    Wall,
)
from palpate.workers.mechanics.materials.elastic_law import Isochoric


@dataclass(frozen=True, slots=True)
class Frame:
    """Box around the undeformed body; its faces have the coordinates -1 and 1."""

    centre_mm: Triple = (0.0, 0.0, 0.0)
    half_mm: Triple = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if not min(self.half_mm) > 0:
            raise InputError(f"A frame needs a size along x, y and z, got {self.half_mm} mm.")

    def normalised(self, points: FloatArray) -> FloatArray:
        """Return `points`, shape (k, 3) in mm, in units of the box."""
        return np.asarray((points - np.asarray(self.centre_mm)) / np.asarray(self.half_mm))


def frame_of(nodes: FloatArray) -> Frame:
    """Return the frame of the body with these `nodes`, shape (n, 3) in mm."""
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    return Frame(_triple((low + high) / 2), _triple((high - low) / 2))


def _triple(values: FloatArray) -> Triple:
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True, slots=True)
class FibreField:
    """Directions of the fibres in the undeformed body.

    At normalised coordinates (a, b) along x and y the fibre is `axis`, turned by
    ``turn_deg[1] + fan_deg[1] b`` towards y and by ``turn_deg[0] + fan_deg[0] a``
    towards x.

    Parameters
    ----------
    axis : tuple of float
        From chest wall to nipple.
    turn_deg, fan_deg : tuple of float
        Towards x and towards y.
    second_axis : tuple of float
        Direction of the second family, if constants give it a stiffness.
    frame : Frame
    """

    axis: Triple = (0.0, 0.0, 1.0)
    turn_deg: tuple[float, float] = (0.0, 0.0)
    fan_deg: tuple[float, float] = (0.0, 0.0)
    second_axis: Triple = (0.0, 1.0, 0.0)
    frame: Frame = Frame()

    def __post_init__(self) -> None:
        for direction in (self.axis, self.second_axis):
            if not np.linalg.norm(direction) > 0:
                raise InputError(f"The fibre direction must not be zero, got {direction}.")

    def directions(self, points: FloatArray) -> FloatArray:
        """Return unit vectors of the first family at `points`, shape (k, 3)."""
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        directions = np.tile(axis, (len(points), 1))
        if any(self.turn_deg) or any(self.fan_deg):
            place = self.frame.normalised(points)
            for k in range(2):
                angle = np.radians(self.turn_deg[k] + self.fan_deg[k] * place[:, k])
                directions[:, k] += np.tan(angle)
            directions /= np.linalg.norm(directions, axis=1)[:, None]
        return directions

    def second_directions(self, points: FloatArray) -> FloatArray:
        """Return unit vectors of the second family at `points`, shape (k, 3)."""
        return np.tile(
            np.asarray(self.second_axis) / np.linalg.norm(self.second_axis), (len(points), 1)
        )


WALL_TO_NIPPLE = FibreField()


@dataclass(frozen=True, slots=True)
class Gradient:
    """Exponential gradient of the stiffness: ln of the factor from the centre to each face.

    Parameters
    ----------
    log_per_half : tuple of float
        Along x, y and z.
    frame : Frame
    tissues : tuple of Tissue
        Tissues it applies to; empty means all.
    """

    log_per_half: Triple
    frame: Frame
    tissues: tuple[Tissue, ...] = ()

    def log_factor(self, points: FloatArray) -> FloatArray:
        """Return ln of the factor at `points`, shape (k, 3)."""
        return np.asarray(self.frame.normalised(points) @ np.asarray(self.log_per_half))


# An inclusion fades over this length, so that its position and size have derivatives.
EDGE_MM = 1.0
# Beyond so many of these lengths from its surface it has no effect: tanh is 1 to the last digit.
GONE_AFTER = 20.0


@dataclass(frozen=True, slots=True)
class Inclusion:
    """Ball in which the stiffness of every tissue is multiplied by exp(`log_ratio`)."""

    log_ratio: float
    centre_mm: Triple
    radius_mm: float
    tissues: tuple[Tissue, ...] = ()

    def __post_init__(self) -> None:
        if not self.radius_mm > 0:
            raise InputError(f"An inclusion needs a radius > 0, got {self.radius_mm:g} mm.")

    def log_factor(self, points: FloatArray) -> FloatArray:
        """Return ln of the factor at `points`, shape (k, 3)."""
        away = np.linalg.norm(points - np.asarray(self.centre_mm), axis=1) - self.radius_mm
        return np.asarray(self.log_ratio * 0.5 * (1 - np.tanh(away / EDGE_MM)))

    def reaches(self, nodes: FloatArray) -> BoolArray:
        """Test whether its factor at each of `nodes`, shape (n, 3), may differ from 1."""
        away = nodes - np.asarray(self.centre_mm)
        reach = self.radius_mm + GONE_AFTER * EDGE_MM
        return np.asarray(np.einsum("ij,ij->i", away, away) < reach**2)


Variation = Gradient | Inclusion


def stiffness_factors(
    variations: Iterable[Variation], nodes: FloatArray, tets: IntArray, n_tissues: int
) -> FloatArray:
    """Return the stiffness factor of each tissue in each element, shape (m, tissues).

    The logarithm is averaged over the corners and the centroid of the element.
    """
    log = np.zeros((len(tets), n_tissues))
    centroids = _mean_of_corners(nodes, tets)
    for variation in variations:
        of = [int(t) for t in variation.tissues] or list(range(n_tissues))
        at_corners = _mean_of_corners(variation.log_factor(nodes), tets)
        log[:, of] += (0.8 * at_corners + 0.2 * variation.log_factor(centroids))[:, None]
    return np.exp(log)


def elements_reached(
    inclusions: Iterable[Inclusion], nodes: FloatArray, tets: IntArray, centroids: FloatArray
) -> BoolArray:
    """Find the elements in which inclusions may change the stiffness, shape (m,)."""
    corners, middles = np.zeros(len(nodes), np.bool_), np.zeros(len(tets), np.bool_)
    for ball in inclusions:
        corners |= ball.reaches(nodes)
        middles |= ball.reaches(centroids)  # for elements larger than the ball
    for corner in tets.T:
        middles |= corners[corner]
    return middles


def _mean_of_corners(values: FloatArray, tets: IntArray) -> FloatArray:
    """Average nodal values, (n, ...), over the corners of each element, (m, ...)."""
    a, b, c, d = tets.T
    return np.asarray((values[a] + values[b] + values[c] + values[d]) / 4)


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
        Fold where it would be compressed, see `workers.mechanics.fem.membrane`. A sheet
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


# A result with an element squeezed below this volume ratio is not to be trusted.
SQUEEZED_J = 0.3


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a simulation, with measures of its reliability.

    Parameters
    ----------
    converged : bool
    reason : str
        Reason for divergence; empty if it converged.
    newton_iterations, cg_iterations : tuple of int
        Iterations on each level, coarse to fine.
    residual_n : float
        Norm of the out-of-balance force on the free degrees of freedom.
    plate_displacement_mm : float
        Downward displacement of the upper plate.
    plate_force_n : float
        Force on the upper plate.
    contact_area_mm2 : float
        Undeformed surface area pressed against the upper plate.
    penetration_mm : float
        Deepest node inside a plate, a measure of the penalty's error.
    min_j : float
        Smallest volume ratio of an element.
    energy_mj : float
        Stored energy in mJ (= N mm).
    force_imbalance : float
        ``|upper - lower| / upper`` of the forces on the two plates.
    wall_force_n : float
        Reaction of the chest wall along z.
    squeezed : bool
        Whether it converged, but with an element of J < 0.3.
    """

    converged: bool
    reason: str
    newton_iterations: tuple[int, ...]
    cg_iterations: tuple[int, ...]
    residual_n: float
    plate_displacement_mm: float
    plate_force_n: float
    contact_area_mm2: float
    penetration_mm: float
    min_j: float
    energy_mj: float
    force_imbalance: float
    wall_force_n: float
    squeezed: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the values as a JSON-serialisable dict."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Displacement of the finest mesh, shape (n, 3) in mm, and the outcome."""

    displacement_mm: FloatArray
    outcome: Outcome
