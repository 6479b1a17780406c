"""Keys of a material."""

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from palpate.storage.errors import InputError
from palpate.workers.mechanics.materials.law_plugins import (
    DEFAULT_LAW,
    law_named,
    law_of_constant,
)
from palpate.workers.mechanics.parameters import Bounds, Vocabulary
from palpate.workers.spec import Door, Finite, LawName, Positive

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

    @property
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
