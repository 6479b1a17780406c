"""Keys of holds, loads and loaded states."""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from palpate.workers.missing_keys import Pairs
from palpate.workers.organs.specimen.keys.bodies import Axis
from palpate.workers.organs.specimen.readings.spec import FinitePoint
from palpate.workers.spec import Door, Finite, Positive


class HoldSpec(Door):
    """A hold: a region and the axes along which it is fixed.

    Parameters
    ----------
    axes
        Axes along which the region is fixed.
    """

    region: str = Field(description="name of the held region")
    axes: Annotated[tuple[Axis, ...], Field(min_length=1)] = ("x", "y", "z")


class ForceSpec(Door):
    """A force or a hanging mass on a region, with a constant direction."""

    exactly_one: ClassVar[Pairs] = (("force_n", "mass_g"),)

    region: str = Field(description="name of the loaded region")
    force_n: FinitePoint | None = Field(default=None, description="[x, y, z] in N")
    mass_g: Positive | None = Field(default=None, description="a hanging mass in g")


class MoveSpec(Door):
    """A displacement prescribed on a region: uniform, or as measured by the field.

    Parameters
    ----------
    region
        Name of the moved region.
    displacement_mm
        Displacement along x, y and z, in mm.
    measured
        Whether the region moves as measured by `field`.
    axes
        Axes along which the displacement is prescribed.
    """

    region: str
    displacement_mm: FinitePoint | None = None
    measured: bool = False
    axes: Annotated[tuple[Axis, ...], Field(min_length=1)] = ("x", "y", "z")

    @model_validator(mode="after")
    def _one_displacement(self) -> Self:
        if (self.displacement_mm is None) != self.measured:
            raise ValueError("give exactly one of displacement_mm and measured: true")
        return self


class ReactionSpec(Door):
    """The force on the body by which a region is moved along an axis, read by a load cell.

    Parameters
    ----------
    region
        Name of the moved region.
    axis
        Axis of the load cell.
    force_n
        Reading of the load cell in N: the force on the body.
    sd_n
        Standard deviation of the reading, in N.
    """

    region: str
    axis: Axis
    force_n: Finite
    sd_n: Positive


class LoadsSpec(Door):
    """Loads of one state; gravity is the same in all states.

    Parameters
    ----------
    forces
        Forces and hanging masses.
    moves
        Prescribed displacements.
    pressure_kpa
        Pressure under a sheet in kPa, which inflates it towards +z.
    """

    later_keys: ClassVar[tuple[str, ...]] = ("pressure_kpa",)

    forces: tuple[ForceSpec, ...] = ()
    moves: tuple[MoveSpec, ...] = ()
    pressure_kpa: Finite | None = None

    @property
    def regions(self) -> list[str]:
        """Names of the loaded and moved regions."""
        return [one.region for one in self.forces] + [one.region for one in self.moves]


class StateSpec(LoadsSpec):
    """A loaded state: its loads and recordings, one file for each repeat.

    Parameters
    ----------
    reactions
        Readings of load cells, the same ones in all states.
    """

    name: Annotated[str, Field(min_length=1)] = Field(description="a name for the report")
    files: Annotated[tuple[str, ...], Field(min_length=1)] = Field(
        description="the recordings of this state, one for each repeat"
    )
    reactions: tuple[ReactionSpec, ...] = ()

    @model_validator(mode="after")
    def _reactions_of_moves(self) -> Self:
        moved = [(move.region, axis) for move in self.moves for axis in move.axes]
        read = [(one.region, one.axis) for one in self.reactions]
        for region, axis in read:
            if (region, axis) not in moved:
                raise ValueError(
                    f"state {self.name} has a reaction of {region} along {axis}, which does not "
                    "move there: list it under moves, or give the force under forces"
                )
        no_repeats(f"reactions of state {self.name}", [f"{r} along {a}" for r, a in read])
        return self


class PredictSpec(LoadsSpec):
    """A state to predict, not measured or held out.

    Parameters
    ----------
    name
        A name for the report.
    """

    name: Annotated[str, Field(min_length=1)]


def no_repeats(what: str, names: Sequence[str]) -> None:
    """Raise a validation error if a name is repeated."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{what}: list each name once; repeated: {', '.join(twice)}")
