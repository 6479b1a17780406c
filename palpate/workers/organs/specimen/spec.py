"""Keys of the file of a bench experiment; see examples/beam.yaml.

Every key includes its unit. Positions and directions are in the frame of the body. A block has
one corner at the origin and extends along positive x, y and z.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Triple
from palpate.workers.documents import parse_yaml
from palpate.workers.input_files import read_text
from palpate.workers.mechanics.materials.law_plugins import (
    DEFAULT_LAW,
)
from palpate.workers.mechanics.parameters import unknown_name
from palpate.workers.missing_keys import Pairs
from palpate.workers.organs.specimen.keys.bodies import BodySpec, RegionSpec
from palpate.workers.organs.specimen.keys.loads import HoldSpec, PredictSpec, StateSpec, no_repeats
from palpate.workers.organs.specimen.keys.materials import MaterialSpec
from palpate.workers.organs.specimen.readings.spec import FieldSpec, FinitePoint, MarkersSpec
from palpate.workers.spec import Door, validated

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
        read = [[(one.region, one.axis) for one in state.reactions] for state in self.states]
        if any(one != read[0] for one in read):
            raise ValueError("reactions must be the same in all states, in the same order")
        no_repeats("states", [one.name for one in self.states] + [one.name for one in self.predict])
        return self

    def _check_boundary(self) -> None:
        loads = (*self.states, *self.predict)
        if not self.holds and not all(any(len(m.axes) == 3 for m in x.moves) for x in loads):
            raise ValueError("nothing holds the body: give holds, or move a region in each state")
        if self.field is None and any(m.measured for x in loads for m in x.moves):
            raise ValueError("measured: true needs a field; markers do not measure a boundary")
        if any(m.measured for one in self.predict for m in one.moves):
            raise ValueError("a state under predict was not measured: give displacement_mm")
        if self.body.sheet is None and any(x.pressure_kpa is not None for x in loads):
            raise ValueError("pressure_kpa inflates a sheet, but the body is not one: leave it out")

    @property
    def measured_regions(self) -> tuple[str, ...]:
        """Names of the regions that move as measured by the field in any state, each once."""
        moves = (move for state in self.states for move in state.moves)
        return tuple(dict.fromkeys(move.region for move in moves if move.measured))

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
    return validated(SpecimenSpec, data, str(path))


def _all_known(kind: str, wanted: Iterable[str], known: Iterable[str]) -> None:
    names = list(known)
    for name in wanted:
        if name not in names:
            raise ValueError(unknown_name(kind, name, names))
