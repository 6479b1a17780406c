"""What is asked of the solver: constants, skin, plates. Units mm, N, MPa."""

from collections.abc import Mapping
from dataclasses import dataclass

from storage.errors import InputError
from storage.values import Tissue, Triple


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

    Raises
    ------
    InputError
        If a constant lies outside its range.
    """

    young_mpa: float
    poisson: float = 0.49
    fibre_mpa: float = 0.0

    def __post_init__(self) -> None:
        if not (self.young_mpa > 0 and 0 < self.poisson < 0.5 and self.fibre_mpa >= 0):
            raise InputError(
                "A tissue needs E > 0, 0 < nu < 0.5 and eta >= 0, got "
                f"E = {self.young_mpa * 1e3:g} kPa, nu = {self.poisson:g}, "
                f"eta = {self.fibre_mpa * 1e3:g} kPa."
            )

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
    """Skin as an incompressible neo-Hookean sheet on the free surface."""

    young_mpa: float
    thickness_mm: float

    def __post_init__(self) -> None:
        if not (self.young_mpa > 0 and self.thickness_mm > 0):
            raise InputError(
                "Skin needs E > 0 and thickness > 0, got "
                f"E = {self.young_mpa * 1e3:g} kPa, thickness = {self.thickness_mm:g} mm."
            )


@dataclass(frozen=True, slots=True)
class ForceControl:
    """The upper plate is pushed down along -y until it carries `force_n`.

    The plates start at ``y = lower_mm`` and ``y = upper_mm``.
    """

    force_n: float
    lower_mm: float
    upper_mm: float

    def __post_init__(self) -> None:
        if not self.force_n > 0:
            raise InputError(f"The plate force must be positive, got {self.force_n:g} N.")
        _check_plates(self.lower_mm, self.upper_mm)


@dataclass(frozen=True, slots=True)
class DistanceControl:
    """The plates end at ``y = lower_mm`` and ``y = upper_mm``, whatever force that takes."""

    lower_mm: float
    upper_mm: float

    def __post_init__(self) -> None:
        _check_plates(self.lower_mm, self.upper_mm)


Load = ForceControl | DistanceControl


@dataclass(frozen=True, slots=True)
class Problem:
    """One compression of one body.

    Parameters
    ----------
    constants : mapping of Tissue to Constants
        Every tissue present in the mesh must be named.
    load : ForceControl or DistanceControl
        Two rigid frictionless plates normal to y.
    membrane : Membrane, optional
        Skin on the free surface, when the mesh does not resolve it.
    fibre : tuple of float
        Fibre direction in the undeformed body; chest wall to nipple.
    literal_fibre : bool
        Let fibres push back under compression too, as thesis Eq. 4.6 says when
        read literally. Many equilibria may then exist; the default acts in
        tension only.
    wall_fixed : tuple of bool
        Which displacement components are held at the chest wall.
    plain_elements : bool
        Textbook linear tetrahedra without the nodal average; they lock.
    tolerance_mm : float
        The last full Newton step on the finest mesh is shorter than this.
    """

    constants: Mapping[Tissue, Constants]
    load: Load
    membrane: Membrane | None = None
    fibre: Triple = (0.0, 0.0, 1.0)
    literal_fibre: bool = False
    wall_fixed: tuple[bool, bool, bool] = (False, False, True)
    plain_elements: bool = False
    tolerance_mm: float = 2e-3


def _check_plates(lower_mm: float, upper_mm: float) -> None:
    if not upper_mm > lower_mm:
        raise InputError(
            f"The upper plate (y = {upper_mm:g} mm) must lie above the lower one "
            f"(y = {lower_mm:g} mm)."
        )
