"""Model options of a corneal section other than mesh, constants and load."""

from dataclasses import dataclass
from typing import Literal, get_args

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.mesh.quadrature import QUADRATURE

Kind = Literal["plane stress", "plane strain", "axisymmetric"]
PrestressMethod = Literal["additive", "mulf", "inverse", "none"]


@dataclass(frozen=True, slots=True)
class CorneaModel:
    """Options of a simulation.

    Parameters
    ----------
    kind : {"plane stress", "plane strain", "axisymmetric"}
        In an axisymmetric section each half is revolved by half a turn about x = 0, so the mesh
        needs an edge there.
    prestress : {"additive", "mulf", "inverse", "none"}
        How the imaged cornea is brought into equilibrium with the intraocular pressure; see
        `prestress`. With "none" the imaged cornea is stress-free.
    limbus_mpa_per_mm : float or None
        Stiffness of an elastic support of the limbus, per area; None clamps it.
    depth_gradient, side_gradient : float
        Change of ln(modulus) from the anterior to the posterior surface, and from left to
        right; the mean over the section is kept at zero.
    quadrature_points : {3, 7}
        Number per triangle.
    tolerance_mm : float
        Error of the displacement at which Newton's method stops.
    prestress_tolerance_mm : float
        Displacement from the image at which the iteration for the prestress stops.

    Raises
    ------
    InputError
        If an option is unknown, or a stiffness or tolerance is not positive.
    """

    kind: Kind = "plane stress"
    prestress: PrestressMethod = "additive"
    limbus_mpa_per_mm: float | None = None
    depth_gradient: float = 0.0
    side_gradient: float = 0.0
    quadrature_points: int = 3
    tolerance_mm: float = 1e-7
    prestress_tolerance_mm: float = 1e-5

    def __post_init__(self) -> None:
        options = (
            ("kind of section", self.kind, get_args(Kind)),
            ("prestress", self.prestress, get_args(PrestressMethod)),
            ("number of quadrature points", self.quadrature_points, tuple(QUADRATURE)),
        )
        for name, value, allowed in options:
            if value not in allowed:
                raise InputError(
                    f"The {name} of a corneal model must be one of {', '.join(map(str, allowed))}; "
                    f"got {value!r}."
                )
        if self.limbus_mpa_per_mm is not None and not self.limbus_mpa_per_mm > 0:
            raise InputError(
                "An elastic limbus needs a positive stiffness, got "
                f"{1e3 * self.limbus_mpa_per_mm:g} kPa/mm. Omit it to clamp the limbus."
            )
        if not (self.tolerance_mm > 0 and self.prestress_tolerance_mm > 0):
            raise InputError(
                "Tolerances of a corneal model must be positive, got "
                f"{self.tolerance_mm:g} and {self.prestress_tolerance_mm:g} mm."
            )
