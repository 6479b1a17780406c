"""Keys of the body of a bench experiment: its shape, its regions and its materials."""

from functools import cached_property
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from palpate.storage.errors import InputError
from palpate.workers.common_keys import Door, Finite, LawName, Positive
from palpate.workers.file_keys import Pairs
from palpate.workers.mechanics.materials.law_plugins import DEFAULT_LAW, law_named, law_of_constant
from palpate.workers.mechanics.model_parameters import Bounds, Vocabulary

FinitePoint = tuple[Finite, Finite, Finite]
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
