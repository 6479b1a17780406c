"""The state of a level at a moment of the loading, and what it owes to the way there."""

from dataclasses import dataclass, field, replace

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.contact.frictional_contact import PlateFriction
from palpate.workers.mechanics.fem.contact.plate_surface import Gap, PlateSurface, plate_surfaces
from palpate.workers.mechanics.fem.problem.array_types import Float32Array
from palpate.workers.mechanics.fem.problem.loads import Device


@dataclass(frozen=True, eq=False)
class History:
    """History variables: what an equilibrium depends on besides positions and load.

    Friction and follower pressure have no energy. The forces here are held while an
    energy is minimised; `Level.update_history` brings them up to date.

    Parameters
    ----------
    friction : tuple of PlateFriction
        Of the lower and the upper plate; empty without friction.
    follower_force : ndarray, shape (n, 3), optional
        Of the full follower pressures, in N; None before the first update.
    eigenvector : ndarray of float32, shape (n, 4), optional
        Estimate of the stiffest mode of the smoothed tangent, from which the next
        power iteration of the linear solver starts; it changes last digits only.
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
        How far the plates have closed.
    history : History
    """

    x: FloatArray
    travel_mm: float
    history: History = field(default_factory=History)

    def moved_to(self, x: FloatArray, travel_mm: float) -> "State":
        """Return a state at other positions with the same history."""
        return State(x, travel_mm, self.history)

    def moved_along(self, length: float, u: FloatArray, travel: float) -> "State":
        """Return the state so far along a step, the directions of friction moved with it."""
        x, t = self.x + length * u, self.travel_mm + length * travel
        friction = tuple(
            f.with_direction_moved(length, self.x, self.travel_mm, u, travel)
            for f in self.history.friction
        )
        return State(x, t, replace(self.history, friction=friction))

    def with_free_directions(self) -> "State":
        """Return the state with directions of friction that are unknowns of their own."""
        friction = tuple(
            replace(f, dual=f.direction(self.x, self.travel_mm)) for f in self.history.friction
        )
        return replace(self, history=replace(self.history, friction=friction))

    def with_directions_of_slip(self) -> "State":
        """Return the state with the directions of friction that its slips have."""
        friction = tuple(replace(f, dual=None) for f in self.history.friction)
        return replace(self, history=replace(self.history, friction=friction))

    def with_eigenvector(self, eigenvector: Float32Array | None) -> "State":
        """Return the same state with another estimate of the stiffest mode."""
        return replace(self, history=replace(self.history, eigenvector=eigenvector))


@dataclass(frozen=True, slots=True)
class Stage:
    """The load at one moment of the loading.

    Parameters
    ----------
    gap : Gap or None
        Where the plates stand at zero travel; None without plates.
    force_n : float or None
        Force that the plates carry; None where they stay at `gap`.
    fraction : float
        Of gravity, forces, pressures and prescribed displacements.
    device : Device
    """

    gap: Gap | None
    force_n: float | None
    fraction: float
    device: Device

    def gap_at(self, travel_mm: float) -> Gap | None:
        """Return where the plates stand along the axis after `travel_mm`."""
        if self.gap is None or self.force_n is None:
            return self.gap
        return self.gap.closed_by(travel_mm, self.device.lower_share)

    def plates(self, travel_mm: float) -> tuple[PlateSurface, ...]:
        """Return the plates after `travel_mm`."""
        gap = self.gap_at(travel_mm)
        return () if gap is None else plate_surfaces(self.device, gap)
