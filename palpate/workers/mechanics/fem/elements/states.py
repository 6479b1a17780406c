"""State of a level at one stage of the loading, and its history variables."""

from dataclasses import dataclass, field, replace

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.contact.frictional_contact import PlateFriction
from palpate.workers.mechanics.fem.contact.plate_surface import Gap, PlateSurface, plate_surfaces
from palpate.workers.mechanics.fem.problem.array_types import Float32Array
from palpate.workers.mechanics.fem.problem.loads import Device


@dataclass(frozen=True, eq=False)
class History:
    """History variables, on which an equilibrium depends in addition to positions and load.

    Friction and follower pressure have no energy. These forces are held while an energy is
    minimised; `Level.update_history` updates them.

    Parameters
    ----------
    friction : tuple of PlateFriction
        For the lower and the upper plate; empty without friction.
    follower_force : ndarray, shape (n, 3), optional
        Force of the full follower pressures, in N; None before the first update.
    eigenvector : ndarray of float32, shape (n, 4), optional
        Estimate of the stiffest mode of the smoothed tangent, which starts the next power
        iteration of the linear solver; it affects only the last digits.
    """

    friction: tuple[PlateFriction, ...] = ()
    follower_force: FloatArray | None = None
    eigenvector: Float32Array | None = None


@dataclass(frozen=True, eq=False)
class State:
    """Positions, travel of the plates, and history.

    Parameters
    ----------
    x : ndarray, shape (n, 3)
        Positions of the nodes in mm.
    travel_mm : float
        Closing distance of the plates.
    history : History
    """

    x: FloatArray
    travel_mm: float
    history: History = field(default_factory=History)

    def moved_to(self, x: FloatArray, travel_mm: float) -> "State":
        """Return a state at other positions with the same history."""
        return State(x, travel_mm, self.history)

    def moved_along(self, length: float, u: FloatArray, travel: float) -> "State":
        """Return the state after a fraction of a step, directions of friction included."""
        x, t = self.x + length * u, self.travel_mm + length * travel
        friction = tuple(
            f.with_direction_moved(length, self.x, self.travel_mm, u, travel)
            for f in self.history.friction
        )
        return State(x, t, replace(self.history, friction=friction))

    def with_free_directions(self) -> "State":
        """Return the state with the directions of friction as separate unknowns."""
        friction = tuple(
            replace(f, dual=f.direction(self.x, self.travel_mm)) for f in self.history.friction
        )
        return replace(self, history=replace(self.history, friction=friction))

    def with_directions_of_slip(self) -> "State":
        """Return the state with the directions of friction taken from its slips."""
        friction = tuple(replace(f, dual=None) for f in self.history.friction)
        return replace(self, history=replace(self.history, friction=friction))

    def with_eigenvector(self, eigenvector: Float32Array | None) -> "State":
        """Return the same state with another estimate of the stiffest mode."""
        return replace(self, history=replace(self.history, eigenvector=eigenvector))


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of the loading.

    Parameters
    ----------
    gap : Gap or None
        Position of the plates at zero travel; None without plates.
    force_n : float or None
        Force on the plates; None where they stay at `gap`.
    fraction : float
        Fraction of the full gravity, forces, pressures and prescribed displacements.
    device : Device
    """

    gap: Gap | None
    force_n: float | None
    fraction: float
    device: Device

    def gap_at(self, travel_mm: float) -> Gap | None:
        """Return the positions of the plates along the axis after `travel_mm`."""
        if self.gap is None or self.force_n is None:
            return self.gap
        return self.gap.closed_by(travel_mm, self.device.lower_share)

    def plates(self, travel_mm: float) -> tuple[PlateSurface, ...]:
        """Return the plates after `travel_mm`."""
        gap = self.gap_at(travel_mm)
        return () if gap is None else plate_surfaces(self.device, gap)
