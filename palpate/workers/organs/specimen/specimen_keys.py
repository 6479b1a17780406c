"""Keys of the file of a bench experiment; see examples/beam.yaml.

Every key includes its unit. Positions and directions are in the frame of the body. A block has
one corner at the origin and extends along positive x, y and z. The keys here describe holds, loads
and loaded states; an experiment joins them with its recordings, body, regions and materials.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Triple
from palpate.workers.common_keys import Door, Finite, Positive, validated
from palpate.workers.file_keys import Pairs
from palpate.workers.input_files import parse_yaml, read_text
from palpate.workers.mechanics.materials.law_plugins import DEFAULT_LAW
from palpate.workers.mechanics.model_parameters import unknown_name
from palpate.workers.organs.specimen.specimen_body_keys import (
    Axis,
    BodySpec,
    FinitePoint,
    MaterialSpec,
    RegionSpec,
)
from palpate.workers.organs.specimen.specimen_recording_keys import FieldSpec, MarkersSpec


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

    @property
    def measured_moves(self) -> tuple[MoveSpec, ...]:
        """The moves that the field prescribes."""
        return tuple(move for move in self.moves if move.measured)


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
        read = [(reaction.region, reaction.axis) for reaction in self.reactions]
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
    files
        Recordings of a held-out state, one for each repeat. They move the regions that move as
        measured; all other points are only compared with the prediction.
    """

    later_keys: ClassVar[tuple[str, ...]] = (*LoadsSpec.later_keys, "files")

    name: Annotated[str, Field(min_length=1)]
    files: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _measured_by_files(self) -> Self:
        if self.measured_moves and not self.files:
            raise ValueError(
                f"state {self.name}: {self.measured_moves[0].region} moves as measured, but "
                "there is no recording: give files, or displacement_mm"
            )
        return self


def no_repeats(what: str, names: Sequence[str]) -> None:
    """Raise a validation error if a name is repeated."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{what}: list each name once; repeated: {', '.join(twice)}")


# At most one material for each label of a voxel.
MATERIALS = tuple(tissue for tissue in Tissue if tissue is not Tissue.AIR)


class SpecimenSpec(Door):
    """A bench experiment.

    Parameters
    ----------
    organ
        Kind of the experiment.
    gravity
        Whether the model includes the weight of the body.
    holds
        Regions that are held.
    markers
        Recordings of markers.
    field
        Recordings of displacement fields.
    predict
        States to predict, not measured or held out.
    """

    exactly_one: ClassVar[Pairs] = (("markers", "field"),)

    organ: Literal["specimen"]
    name: Annotated[str, Field(min_length=1)] = Field(description="a name for the report")
    body: BodySpec = Field(description="the specimen: a block, a mesh file or a sheet")
    regions: dict[str, RegionSpec] = Field(
        description="regions that are held, loaded or moved: a plane or a box"
    )
    materials: Annotated[
        dict[str, MaterialSpec], Field(min_length=1, max_length=len(MATERIALS))
    ] = Field(description="the materials of the specimen")
    down: FinitePoint = Field(description="direction of gravity, such as [0, -1, 0]")
    gravity: Literal["not modelled", "modelled"] = "not modelled"
    holds: tuple[HoldSpec, ...] = ()
    markers: MarkersSpec | None = None
    field: FieldSpec | None = None
    states: Annotated[tuple[StateSpec, ...], Field(min_length=1)] = Field(
        description="the loaded states, each with its load and its files"
    )
    predict: tuple[PredictSpec, ...] = ()

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if not np.linalg.norm(self.down) > 0:
            raise ValueError("down must not be zero: give the direction of gravity")
        self._check_boundary()
        wanted = [h.region for h in self.holds]
        wanted += [name for load in (*self.states, *self.predict) for name in load.regions]
        _all_known("region", wanted, self.regions)
        _all_known("material", (self.body.labels or {}).values(), self.materials)
        if self.body.labels is None and len(self.materials) > 1:
            raise ValueError("several materials need body.labels, with a material for each label")
        read = [[(entry.region, entry.axis) for entry in state.reactions] for state in self.states]
        if any(entry != read[0] for entry in read):
            raise ValueError("reactions must be the same in all states, in the same order")
        no_repeats(
            "states", [entry.name for entry in self.states] + [entry.name for entry in self.predict]
        )
        return self

    def _check_boundary(self) -> None:
        loads = (*self.states, *self.predict)
        if not self.holds and not all(any(len(m.axes) == 3 for m in x.moves) for x in loads):
            raise ValueError("nothing holds the body: give holds, or move a region in each state")
        if self.field is None and any(m.measured for x in loads for m in x.moves):
            raise ValueError("measured: true needs a field; markers do not measure a boundary")
        if self.body.sheet is None and any(x.pressure_kpa is not None for x in loads):
            raise ValueError("pressure_kpa inflates a sheet, but the body is not one: leave it out")

    @property
    def recorded(self) -> tuple[StateSpec | PredictSpec, ...]:
        """All states that may have recordings, those to predict last."""
        return (*self.states, *self.predict)

    @property
    def measured_moves(self) -> tuple[MoveSpec, ...]:
        """The moves of all measured states that the field prescribes."""
        return tuple(move for state in self.states for move in state.measured_moves)

    @property
    def stated_sd_mm(self) -> float:
        """Stated error of one component of one point in one recording."""
        stated = self.markers or self.field
        if stated is None:
            raise AssertionError("an experiment has markers or a field")
        return float(np.hypot(stated.sd_mm, stated.common_sd_mm or 0.0))

    @property
    def moved_regions(self) -> tuple[str, ...]:
        """Names of the regions that move in any measured state, each once."""
        moves = (move for state in self.states for move in state.moves)
        return tuple(
            dict.fromkeys(m.region for m in moves if m.measured or any(m.displacement_mm or ()))
        )

    @property
    def unit_down(self) -> Triple:
        """Unit vector of gravity."""
        x, y, z = np.asarray(self.down) / np.linalg.norm(self.down)
        return float(x), float(y), float(z)

    @property
    def can_stiffen(self) -> bool:
        """Whether the effect of strain stiffening applies: to neo-Hookean materials only."""
        return any(material.law == DEFAULT_LAW for material in self.materials.values())

    def tissue_of(self, material: str) -> Tissue:
        """Return the label of a material in voxels and meshes."""
        return MATERIALS[list(self.materials).index(material)]


def read_spec(path: Path) -> SpecimenSpec:
    """Read and validate the file of an experiment.

    Raises
    ------
    InputError
        If the file cannot be read or is invalid.
    """
    try:
        text = read_text(path)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text: {error}. Save it as UTF-8.") from error
    data = parse_yaml(text, str(path))
    if not isinstance(data, dict):
        raise InputError(f"{path} is not an experiment: expected keys such as organ: specimen.")
    return validated(SpecimenSpec, data, str(path), text)


def _all_known(kind: str, wanted: Iterable[str], known: Iterable[str]) -> None:
    names = list(known)
    for name in wanted:
        if name not in names:
            raise ValueError(unknown_name(kind, name, names))
