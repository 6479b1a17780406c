"""Effects of stiffness varying inside a body."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from palpate.storage.values import Tissue
from palpate.workers.mechanics.effects.effect import (
    Effect,
    Place,
    Values,
    renamed,
    sum_of_vectors,
    two_sided,
)
from palpate.workers.mechanics.fem.boundary_value_problem import (
    Constants,
    Frame,
    Gradient,
    Inclusion,
    Problem,
)
from palpate.workers.mechanics.model_parameters import MM, NUMBER, Parameter, ratio

# --- stiffness gradient
# Stiffen each tissue towards one side of the breast.


STIFFNESS_GRADIENT_NAMES = ("ln_gradient_x", "ln_gradient_y", "ln_gradient_z")


def _stiffness_gradient(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Let the stiffness of all tissues grow exponentially along the axes."""
    x, y, z = (values[name] for name in STIFFNESS_GRADIENT_NAMES)
    return replace(problem, variations=(Gradient((x, y, z), frame), *problem.variations))


STIFFNESS_GRADIENT = Effect(
    name="stiffness_gradient",
    family="global material",
    summary="Each tissue is stiffer on one side of the breast than on the other.",
    parameters=tuple(
        two_sided(
            name,
            NUMBER,
            1.0,
            f"ln of the ratio of the stiffness at the end of {name[-1]} to that in the middle",
            reading=ratio(f"times as stiff at the end of {name[-1]} as in the middle"),
        )
        for name in STIFFNESS_GRADIENT_NAMES
    ),
    prior_sd=(0.5, 0.5, 0.5),
    steps=(1e-4, 1e-4, 1e-4),
    transform=_stiffness_gradient,
    references=(
        "M. A. Lago, PhD thesis, 2014, section 4.5.7",
        "N. G. Ramião et al., Biomech. Model. Mechanobiol. 15 (2016) 1307",
    ),
    # A blind case gives ln of the stiffness at the faces of the body, of a tanh, not of a line.
    truth=renamed(ln_gradient_x="ln_x", ln_gradient_y="ln_y", ln_gradient_z="ln_z"),
)


# --- inclusion
# Add a hard or soft lump that the images do not show.


RATIO, RADIUS = "inclusion_ln_ratio", "inclusion_radius"
PLACE = ("inclusion_x", "inclusion_y", "inclusion_z")


def _inclusion(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the stiffness of all tissues in a ball."""
    x, y, z = (values[name] for name in PLACE)
    centre = sum_of_vectors(frame.centre_mm, (x, y, z))
    ball = Inclusion(values[RATIO], centre, values[RADIUS])
    return replace(problem, variations=(*problem.variations, ball)) if values[RATIO] else problem


def _true_inclusion(given: Mapping[str, Any]) -> dict[str, float]:
    """Return ln of the ratio, and the radius of the ball of equal volume."""
    return {
        "inclusion_ln_ratio": math.log(given["ratio"]),
        "inclusion_radius_mm": given["radius_mm"],
    }


INCLUSION = Effect(
    name="inclusion",
    family="local stiffness",
    summary="There is a lump that is harder or softer than the tissue around it.",
    parameters=(
        two_sided(
            RATIO,
            NUMBER,
            2.7,
            "ln of the stiffness of the lump relative to its surroundings",
            reading=ratio("times as stiff as its surroundings"),
        ),
        *(
            two_sided(name, MM, 60.0, f"position of the lump along {name[-1]} from the body centre")
            for name in PLACE
        ),
        Parameter(RADIUS, MM, 3.0, 15.0, 6.0, "radius of the lump", admissible=(0.0, math.inf)),
    ),
    prior_sd=(1.5, 30.0, 30.0, 30.0, 4.0),
    steps=(1e-4, 1e-3, 1e-3, 1e-3, 1e-3),
    transform=_inclusion,
    references=(
        "A. Samani, J. Zubovits, D. Plewes, Phys. Med. Biol. 52 (2007) 1565",
        "T. A. Krouskop et al., Ultrason. Imaging 20 (1998) 260",
    ),
    place=Place(PLACE, "inside"),
    is_slow=True,
    is_mapped=True,
    truth=_true_inclusion,
)


# --- growth
# Let tissue swell or shrink between the scans.


GROWTH_NAMES = {Tissue.FAT: "ln_growth_fat", Tissue.GLANDULAR: "ln_growth_glandular"}


def _growth(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the stress-free volume of fat and glandular tissue."""

    def grown(tissue: Tissue, c: Constants) -> Constants:
        name = GROWTH_NAMES.get(tissue)
        return replace(c, growth=c.growth * math.exp(values[name])) if name else c

    return replace(problem, constants={t: grown(t, c) for t, c in problem.constants.items()})


def _true_growth(given: Mapping[str, Any]) -> dict[str, float]:
    """Return ln of the volume ratio of the gland; fat has not grown."""
    return {"ln_growth_fat": 0.0, "ln_growth_glandular": math.log1p(given["volume_fraction"])}


# The volume of a breast changes by about 10 % over a menstrual cycle, but the scans compared are
# taken days apart at most, so swelling is rarer than effects of the plates. Uniform growth looks
# much like labels that are drawn too large.
GROWTH = Effect(
    name="growth",
    family="growth",
    summary="Tissue has swollen or shrunk between the scans.",
    parameters=tuple(
        two_sided(
            name,
            NUMBER,
            0.3,
            f"ln of the volume of {tissue.name.lower()} in the loaded scans over that at rest",
            reading=ratio(f"times the volume of {tissue.name.lower()} at rest"),
        )
        for tissue, name in GROWTH_NAMES.items()
    ),
    prior_sd=(0.03,) * len(GROWTH_NAMES),
    steps=(1e-6,) * len(GROWTH_NAMES),  # barely taut fibres may fall slack within a longer step
    transform=_growth,
    references=(
        "P. A. Fowler et al., Br. J. Obstet. Gynaecol. 97 (1990) 595",
        "E. K. Rodriguez, A. Hoger, A. D. McCulloch, J. Biomech. 27 (1994) 455",
    ),
    truth=_true_growth,
)
