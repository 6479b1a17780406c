"""Effects of the load: forces, weight, posture."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from palpate.storage.values import Triple
from palpate.workers.mechanics.effects.effect import (
    ANY,
    Effect,
    Values,
    from_zero,
    renamed,
    sum_of_vectors,
    two_sided,
)
from palpate.workers.mechanics.fem.boundary_value_problem import GRAVITY_MM_PER_S2, Frame, Problem
from palpate.workers.mechanics.fem.loads_and_regions import DeadForce, ForceControl, Region
from palpate.workers.mechanics.model_parameters import NUMBER, G, Parameter, Reading, Unit, ratio

# --- gravity change
# Let gravity differ between the two scans, as in another posture.


GRAVITY_CHANGE_NAMES = ("gravity_x", "gravity_y", "gravity_z")


def _gravity_change(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Add a body force to the problem's own."""
    x, y, z = (values[name] for name in GRAVITY_CHANGE_NAMES)
    return replace(problem, gravity_g=sum_of_vectors(problem.gravity_g, (x, y, z)))


# Turning upside down changes gravity by 2 g.
GRAVITY_CHANGE = Effect(
    name="gravity_change",
    family="loading",
    summary="The body's posture differs between the scans, so gravity acts in another direction.",
    parameters=tuple(
        two_sided(
            name,
            G,
            2.0,
            f"change of gravity along {name[-1]} between the scans",
            reading=Reading(unit=f"times gravity along {name[-1]}"),
        )
        for name in GRAVITY_CHANGE_NAMES
    ),
    prior_sd=(0.3, 0.3, 0.3),
    steps=(0.01, 0.01, 0.01),
    transform=_gravity_change,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.6",
        "V. Rajagopal et al., Acad. Radiol. 15 (2008) 1425",
        "A. Mira et al., Clin. Biomech. 60 (2018) 191",
    ),
    truth=renamed(gravity_x_g="x_g", gravity_y_g="y_g", gravity_z_g="z_g"),
)


# --- gravity prestress
# Let gravity act equally in both scans: the imaged body is not stress-free.


GRAVITY_PRESTRESS_NAME = "common_gravity"


def _gravity_prestress(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Let gravity along z act on the imaged body and under the load."""
    pull = (0.0, 0.0, values[GRAVITY_PRESTRESS_NAME])
    return replace(
        problem,
        gravity_g=sum_of_vectors(problem.gravity_g, pull),
        imaged_gravity_g=sum_of_vectors(problem.imaged_gravity_g, pull),
    )


PRESTRESS = Effect(
    name="gravity_prestress",
    family="loading",
    summary="Gravity acted in the same direction in both scans and had stretched the imaged body.",
    parameters=(
        two_sided(
            GRAVITY_PRESTRESS_NAME,
            G,
            1.0,
            "gravity along z in both scans: 1 prone, -1 supine, 0 upright",
            reading=Reading(unit="times gravity along z"),
        ),
    ),
    prior_sd=(0.5,),
    steps=(0.05,),
    transform=_gravity_prestress,
    references=(
        "V. Rajagopal et al., Int. J. Numer. Methods Eng. 72 (2007) 1434",
        "S. Govindjee, P. A. Mihalic, Comput. Methods Appl. Mech. Eng. 136 (1996) 47",
    ),
)


# --- plate force
# Scale the share of the plate's force that goes through the breast.


PLATE_FORCE_NAME = "ln_plate_force"


def _plate_force(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the plate force; plates at a given distance do not move."""
    load = problem.load
    if not isinstance(load, ForceControl):
        return problem
    return replace(
        problem, load=replace(load, force_n=load.force_n * math.exp(values[PLATE_FORCE_NAME]))
    )


def _true_plate_force(given: Mapping[str, Any]) -> dict[str, float]:
    """Return ln of the ratio of the force on the body to the stated force."""
    return {PLATE_FORCE_NAME: math.log(given["factor"])}


# From the least share measured with rigid plates to a sensor that reads 15 % low.
PLATE_FORCE = Effect(
    name="plate_force",
    family="loading",
    summary="The chest wall carries part of the plate's force, or the force sensor is inaccurate.",
    parameters=(
        Parameter(
            PLATE_FORCE_NAME,
            NUMBER,
            math.log(0.14),
            math.log(1.15),
            0.0,
            "ln of the share of the plate's force that the breast carries",
            admissible=ANY,
            reading=ratio("times the stated force"),
        ),
    ),
    prior_sd=(0.5,),
    steps=(1e-4,),
    transform=_plate_force,
    references=(
        "M. Dustler et al., Acta Radiol. 62 (2021) 1583: rigid plates put 22 % (CC) and "
        "14 % (MLO) of their force on the breast",
    ),
    truth=_true_plate_force,
)


# --- load scale
# Make forces larger or smaller than stated.


LOAD_SCALE_NAME = "ln_load"


def _load_scale(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply all forces except gravity, which is known better."""
    factor = math.exp(values[LOAD_SCALE_NAME])
    forces = []
    for dead in problem.forces:
        x, y, z = dead.force_n
        forces.append(replace(dead, force_n=(factor * x, factor * y, factor * z)))
    return replace(problem, forces=tuple(forces))


# Without gravity or a prescribed displacement the stiffness absorbs it completely.
LOAD_SCALE = Effect(
    name="load_scale",
    family="loading",
    summary="The forces differ from the stated ones: scales, friction, a lever arm.",
    parameters=(
        two_sided(
            LOAD_SCALE_NAME,
            NUMBER,
            0.3,
            "ln of the ratio of true to stated forces",
            reading=ratio("times the stated forces"),
        ),
    ),
    prior_sd=(0.05,),
    steps=(1e-4,),
    transform=_load_scale,
    references=("JCGM 100:2008, Guide to the expression of uncertainty in measurement",),
)


# --- self weight
# Add the weight of a body that was simulated without it.


SELF_WEIGHT_NAME = "self_weight"
# Relative uncertainty of the density of a cast or printed material.
DENSITY_SD = 0.02


@dataclass(frozen=True, slots=True)
class AddGravity:
    """Transform that adds a fraction of gravity along a unit vector."""

    down: Triple

    def __call__(self, problem: Problem, values: Values, frame: Frame) -> Problem:
        """Return the problem with the weight, see `Effect.transform`."""
        x, y, z = (values[SELF_WEIGHT_NAME] * part for part in self.down)
        return replace(problem, gravity_g=sum_of_vectors(problem.gravity_g, (x, y, z)))


def self_weight(down: Triple) -> Effect:
    """Return the effect of gravity along a known unit vector.

    Unlike in a change of posture, direction and size are known: the weight acts or it does not,
    and it is as certain as the density of the material.
    """
    return Effect(
        name="self_weight",
        family="loading",
        summary="The body sags under its own weight, which the model lacks.",
        parameters=(
            from_zero(
                SELF_WEIGHT_NAME,
                G,
                1.5,
                "fraction of the body's weight that acts",
                reading=Reading(unit="times its weight"),
            ),
        ),
        prior_sd=(1.0,),
        steps=(1e-2,),
        transform=AddGravity(down),
        if_present=((1.0, DENSITY_SD),),
        references=(
            "M. Dubied et al., IEEE Robot. Autom. Lett. 7 (2022) 5015: a beam of silicone",
        ),
    )


# --- added mass
# Hang a mass on the body that the model lacks: markers, hooks, glue.


ADDED_MASS_NAME = "added_mass"
# Internally a mass is in t, so that t mm/s^2 is N.
GRAM = Unit("gram", "t", 1e6)


@dataclass(frozen=True, slots=True)
class AddMass:
    """Transform that hangs a mass on a region."""

    down: Triple
    region: Region

    def __call__(self, problem: Problem, values: Values, frame: Frame) -> Problem:
        """Return the problem with the mass, see `Effect.transform`."""
        x, y, z = (values[ADDED_MASS_NAME] * GRAVITY_MM_PER_S2 * part for part in self.down)
        return replace(problem, forces=(*problem.forces, DeadForce((x, y, z), self.region)))


def added_mass(down: Triple, region: Region) -> Effect:
    """Return the effect of a mass on `region`, pulled along unit vector `down` in all states."""
    return Effect(
        name="added_mass",
        family="loading",
        summary="Markers, hooks or glue add weight at the loaded place.",
        parameters=(
            from_zero(
                ADDED_MASS_NAME,
                GRAM,
                GRAM.to_inside(50.0),
                "mass attached at the loaded place in every state",
            ),
        ),
        prior_sd=(GRAM.to_inside(5.0),),
        steps=(GRAM.to_inside(0.1),),
        transform=AddMass(down, region),
        references=("JCGM 100:2008, Guide to the expression of uncertainty in measurement",),
    )
