"""Keys of the file of a bench experiment; see examples/beam.yaml.

Every key includes its unit. Positions and directions are in the frame of the body. A block has
one corner at the origin and extends along positive x, y and z. The keys describe the recordings,
the body and its regions, holds, loads and loaded states, and the materials.
"""

from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Triple
from palpate.workers.common_keys import Door, Finite, LawName, Positive, validated
from palpate.workers.file_keys import Pairs
from palpate.workers.input_files import parse_yaml, read_text
from palpate.workers.mechanics.materials.law_plugins import DEFAULT_LAW, law_named, law_of_constant
from palpate.workers.mechanics.model_parameters import Bounds, Vocabulary, unknown_name

FinitePoint = tuple[Finite, Finite, Finite]


class MarkerSpec(Door):
    """Stated position of a marker on the surface of the body.

    ``outward`` is the normal of the surface there; the default is the normal of the nearest face.

    Parameters
    ----------
    outward
        Normal of the surface at the marker. Default: the normal of the nearest face.
    """

    at_mm: FinitePoint = Field(description="[x, y, z] in mm on the surface of the body at rest")
    outward: FinitePoint | None = None

    @model_validator(mode="after")
    def _some_direction(self) -> Self:
        if self.outward is not None and not np.linalg.norm(self.outward) > 0:
            raise ValueError("outward must not be zero")
        return self


class FrameSpec(Door):
    """Position of the cameras relative to the body, from markers at rest.

    A rigid motion is fitted to the positions of the markers, including those of the base.

    Parameters
    ----------
    at_rest_mm
        Positions of at least three markers in the frame of the body, [x, y, z] in mm at rest.
    """

    at_rest_mm: Annotated[dict[str, FinitePoint], Field(min_length=3)]


Window = tuple[Finite, Finite]


class MarkersSpec(Door):
    """Recordings of markers: a table per file, a row per time.

    ``column`` is the pattern of column names, with the marker and the axis. The displacement of
    a marker is its mean position in ``loaded_s`` minus its mean position in ``rest_s``. Negative
    times count from the end of the recording. Empty cells, nan and the placeholders of trackers
    for a lost marker are missing values. ``noise_confirmed: true`` accepts repeats that scatter
    by far more than ``sd_mm``.

    Parameters
    ----------
    time
        Column of the time in s.
    column
        Names of the other columns, with ``{marker}`` and ``{axis}``.
    mm_per_unit
        Length of one unit of the recordings, in mm.
    frame
        The position of the cameras. Default: recordings are in the frame of the body.
    sd_mm
        Error of one component of one marker, standard deviation in mm.
    common_sd_mm
        Error that all markers of a recording share, standard deviation in mm.
    noise_confirmed
        Accepts repeats that scatter by far more than `sd_mm`.
    """

    time: str = "t_s"
    column: str = "{marker}_{axis}_mm"
    mm_per_unit: Positive = 1.0
    rest_s: Window = Field(
        description="[from, to] in s before any motion; negative times count from the end"
    )
    loaded_s: Window = Field(
        description="[from, to] in s after all motion; negative times count from the end"
    )
    markers: Annotated[dict[str, MarkerSpec], Field(min_length=1)] = Field(
        description="the markers, by their names in the recordings"
    )
    frame: FrameSpec | None = None
    sd_mm: Positive = 0.1
    common_sd_mm: Positive | None = None
    noise_confirmed: bool = False

    @model_validator(mode="after")
    def _named_places(self) -> Self:
        if "{marker}" not in self.column or "{axis}" not in self.column:
            raise ValueError("column needs {marker} and {axis} in it, as in '{marker}_{axis}_mm'")
        rest = self.column.replace("{marker}", "").replace("{axis}", "")
        if "{" in rest or "}" in rest:
            raise ValueError(
                f"column may have no braces except in {{marker}} and {{axis}}, found "
                f"{self.column[:60]!r}"
            )
        return self


class FieldSpec(Door):
    """Displacements of landmarks, nodes or image correlation: a table per file, a row per point.

    The columns ``x_mm``, ``y_mm`` and ``z_mm`` are the positions of the points at rest in the
    frame of the body; ``ux_mm``, ``uy_mm`` and ``uz_mm`` are their displacements. One or two
    displacement columns may be absent, and single cells empty or nan: missing components are not
    compared. All recordings must list the same points in the same order.

    ``sd_mm`` is the standard deviation of one component of one point, ``common_sd_mm`` of an
    error that all points of a recording share, such as a motion of the camera.
    ``noise_confirmed: true`` accepts repeats that scatter by far more.

    Parameters
    ----------
    sd_mm
        Error of one component of one point, standard deviation in mm.
    common_sd_mm
        Error that all points of a recording share, such as a motion of the camera, standard
        deviation in mm.
    noise_confirmed
        Accepts repeats that scatter by far more than `sd_mm`.
    """

    sd_mm: Positive
    common_sd_mm: Positive | None = None
    noise_confirmed: bool = False


Sizes = tuple[Positive, Positive, Positive]


Axis = Literal["x", "y", "z"]


class SheetSpec(Door):
    """A thin sheet such as skin or a membrane, flat at z = 0 and free on both faces.

    It resists stretching but not bending, and does not wrinkle. Its material may follow any law.
    The data determine E times the thickness, so an error in the thickness becomes an error in E.

    Parameters
    ----------
    size_mm
        [x, y] of a rectangle with one corner at the origin, in mm.
    outline_mm
        Corners [x, y] of the sheet in mm, in order around it.
    """

    exactly_one: ClassVar[Pairs] = (("size_mm", "outline_mm"),)

    size_mm: tuple[Positive, Positive] | None = None
    outline_mm: Annotated[tuple[tuple[Finite, Finite], ...], Field(min_length=3)] | None = None
    thickness_mm: Positive = Field(description="uniform thickness at rest, in mm")

    @property
    def corners_mm(self) -> tuple[tuple[float, float], ...]:
        """Corners of the sheet, in order around it."""
        if self.outline_mm is not None:
            return self.outline_mm
        x, y = self.size_mm or (0.0, 0.0)
        return (0.0, 0.0), (x, 0.0), (x, y), (0.0, y)


class BodySpec(Door):
    """A block, a mesh file or a sheet.

    A mesh file contains the surface (.stl) or the volume (.vtk, .msh, .inp) of a body.

    Volume cells are tetrahedra, hexahedra, wedges or pyramids, of which only the corners are
    used; a surface must be closed, in a file without volume cells. A body from a file is filled
    with voxels of ``voxel_mm`` and meshed like a scan. ``mm_per_unit`` is 1000 for metres.
    ``labels`` assigns a material to each cell label of a volume; ``label_array`` is the name of
    the cell data with the labels.

    Parameters
    ----------
    mm_per_unit
        Length of one unit of the mesh file, in mm: 1000 for metres.
    voxel_mm
        Size of the voxels that fill a body from a file, in mm: about a tenth of its thinnest part.
    labels
        The material of each cell label of a volume.
    label_array
        Name of the cell data with the labels.
    sheet
        A thin sheet with its thickness.
    """

    exactly_one: ClassVar[Pairs] = (("box_mm", "mesh", "sheet"),)
    later_keys: ClassVar[tuple[str, ...]] = ("sheet",)

    box_mm: Sizes | None = Field(default=None, description="[x, y, z] of a block in mm")
    mesh: str | None = Field(default=None, description="a mesh file: .stl, .vtk or .msh")
    mm_per_unit: Positive = 1.0
    voxel_mm: Positive | None = None
    labels: dict[int, str] | None = None
    label_array: str | None = None
    sheet: SheetSpec | None = None

    @model_validator(mode="after")
    def _one_body(self) -> Self:
        if self.mesh is not None and self.voxel_mm is None:
            raise ValueError("a mesh needs voxel_mm, about a tenth of its thinnest part")
        if self.mesh is None and (self.voxel_mm or self.labels or self.label_array):
            other = "box_mm" if self.box_mm is not None else "a sheet"
            raise ValueError(f"voxel_mm, labels and label_array are for a mesh, not for {other}")
        return self


class BoxSpec(Door):
    """All points between two corners."""

    lower: FinitePoint = Field(description="corner with the smallest x, y and z, in mm")
    upper: FinitePoint = Field(description="corner with the largest x, y and z, in mm")

    @model_validator(mode="after")
    def _ascending(self) -> Self:
        if any(a > b for a, b in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"needs lower <= upper, found {self.lower} and {self.upper}")
        return self


class PlaneSpec(Door):
    """All points of a plane normal to an axis."""

    axis: Axis = Field(description="x, y or z, normal to the plane")
    at_mm: Finite = Field(description="position of the plane along the axis, in mm")


class CircleSpec(Door):
    """All points at least a radius from an axis along z, such as the clamped rim of a sheet."""

    centre: tuple[Finite, Finite] = Field(description="[x, y] of the axis in mm")
    radius: Positive = Field(description="radius in mm, a little less than the radius of the body")


class RegionSpec(Door):
    """A region of the body: a box, a plane or everything outside a circle.

    Parameters
    ----------
    box_mm
        All points between two corners.
    plane
        All points of a plane normal to an axis.
    outside_circle_mm
        All points at least a radius from an axis along z.
    """

    exactly_one: ClassVar[Pairs] = (("box_mm", "plane", "outside_circle_mm"),)
    later_keys: ClassVar[tuple[str, ...]] = ("outside_circle_mm",)

    box_mm: BoxSpec | None = None
    plane: PlaneSpec | None = None
    outside_circle_mm: CircleSpec | None = None


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


Poisson = Annotated[float, Field(gt=0, lt=0.5)]


class MaterialSpec(Door):
    """A material: its law, stiffness, Poisson's ratio and density.

    ``E_kpa`` is the interval in which Young's modulus is expected: a prior, which data may
    overrule; a fit outside it is reported. ``nu`` is a number, or an interval that bounds the
    fit. ``constants`` are shape constants of the law: fixed, such as ``yeoh_c2: 0.5``, or fitted
    with an expected interval, such as ``yeoh_c2: [0.1, 2]``. A constant that is not listed has its
    neo-Hookean value, mostly 0.

    Parameters
    ----------
    law
        The material law; `palpate parameters --law NAME` lists its constants.
    constants
        Shape constants of the law, fixed (``yeoh_c2: 0.5``) or fitted with an expected interval
        (``yeoh_c2: [0.1, 2]``).
    """

    later_keys: ClassVar[tuple[str, ...]] = ("constants",)

    law: LawName = DEFAULT_LAW
    E_kpa: tuple[Positive, Positive] = Field(
        description="interval in which Young's modulus is searched, [lower, upper] in kPa"
    )
    nu: Poisson | tuple[Poisson, Poisson] = Field(
        description="Poisson's ratio, or an interval in which it is searched"
    )
    density_kg_per_m3: Positive = Field(description="density in kg/m3, for its weight")
    constants: dict[str, Finite | tuple[Positive, Positive]] = Field(default_factory=dict)

    @cached_property
    def shape(self) -> Vocabulary:
        """The shape constants of the law."""
        return Vocabulary(law_named(self.law).constants())

    @property
    def shape_held(self) -> dict[str, float]:
        """The fixed shape constants, by internal names and in internal units."""
        given = self.constants.items()
        return self.shape.from_door({n: v for n, v in given if isinstance(v, float)})

    @property
    def shape_free(self) -> dict[str, Bounds]:
        """Intervals of the fitted shape constants, by internal names and in internal units."""
        given = self.constants.items()
        return self.shape.bounds_from_door({n: v for n, v in given if isinstance(v, tuple)})

    @model_validator(mode="after")
    def _shape_of_the_law(self) -> Self:
        for name in self.constants:
            other = law_of_constant(name)
            if name not in self.shape.door_names and other not in ("", self.law):
                raise ValueError(
                    f"constants: {name} belongs to the law {other}, but law is {self.law}"
                )
        try:
            _ = self.shape_held, self.shape_free
        except InputError as error:
            raise ValueError(f"constants: {error}") from None
        return self

    @model_validator(mode="after")
    def _intervals(self) -> Self:
        for name, interval in (("E_kpa", self.E_kpa), ("nu", self.nu)):
            if isinstance(interval, tuple) and not interval[0] < interval[1]:
                low, high = interval
                raise ValueError(
                    f"{name} needs [lower, upper] with lower < upper, found {low}, {high}"
                )
        return self


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
