"""Let tissue relax under the plates by the time it is imaged."""

from dataclasses import dataclass, replace

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.effects.base import Effect, Values, from_zero
from palpate.workers.mechanics.effects.problem_changes import with_constants
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.materials.base import Isochoric
from palpate.workers.mechanics.readings import percent
from palpate.workers.units import NUMBER

NAME = "creep"


@dataclass(frozen=True, slots=True)
class ScaledLaw:
    """Keep a part of a law.

    Parameters
    ----------
    law : Isochoric
    left : float
        Part of its energy, > 0.
    """

    law: Isochoric
    left: float

    @property
    def shear_modulus_mpa(self) -> float:
        """Return the shear modulus, see `Isochoric.shear_modulus_mpa`."""
        return self.left * self.law.shear_modulus_mpa

    def energy(self, F: FloatArray) -> FloatArray:
        """Return the energy, see `workers.mechanics.materials.base.Law.energy`."""
        return self.left * self.law.energy(F)

    def stress(self, F: FloatArray) -> FloatArray:
        """Return the stress, see `workers.mechanics.materials.base.Law.stress`."""
        return self.left * self.law.stress(F)

    def tangent(self, F: FloatArray) -> FloatArray:
        """Return the tangent, see `workers.mechanics.materials.base.Law.tangent`."""
        return self.left * self.law.tangent(F)


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Let every tissue, its fibres and the skin lose the same part of their moduli."""
    left = 1 - values[NAME]

    def changed(c: Constants) -> Constants:
        return replace(
            c,
            young_mpa=left * c.young_mpa,
            fibre_mpa=left * c.fibre_mpa,
            second_fibre_mpa=left * c.second_fibre_mpa,
            law=ScaledLaw(c.law, left) if c.law else None,
        )

    skin = problem.membrane
    return replace(
        with_constants(problem, changed),
        membrane=replace(skin, young_mpa=left * skin.young_mpa) if skin else None,
    )


CREEP = Effect(
    name="creep",
    family="global material",
    summary="The tissue has relaxed under the plates since its stiffness was assumed.",
    parameters=(
        from_zero(
            NAME,
            NUMBER,
            0.5,
            "part of all moduli that the tissue has lost",
            limit=1.0,
            reading=percent("% of the stiffness lost"),
        ),
    ),
    prior_sd=(0.2,),
    steps=(1e-3,),
    transform=transform,
    references=(
        "Y. C. Fung, Biomechanics: Mechanical Properties of Living Tissues, Springer 1993, "
        "section 7.6",
        "J. L. Calvo-Gallego et al., J. Mech. Behav. Biomed. Mater. 80 (2018) 293",
    ),
)
