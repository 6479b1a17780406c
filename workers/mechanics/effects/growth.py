"""Let tissue swell or shrink between the scans."""

import math
from dataclasses import replace

from palpate.storage.values import Tissue
from palpate.workers.mechanics.effects.base import Effect, Values, two_sided
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.fields import Frame
from palpate.workers.mechanics.readings import ratio
from palpate.workers.units import NUMBER

NAMES = {Tissue.FAT: "ln_growth_fat", Tissue.GLANDULAR: "ln_growth_glandular"}


def transform(problem: Problem, values: Values, frame: Frame) -> Problem:
    """Multiply the volume at which fat and glandular tissue are free of stress."""

    def grown(tissue: Tissue, c: Constants) -> Constants:
        name = NAMES.get(tissue)
        return replace(c, growth=c.growth * math.exp(values[name])) if name else c

    return replace(problem, constants={t: grown(t, c) for t, c in problem.constants.items()})


# The volume of a breast changes by some 10 % over a menstrual cycle, but scans to be compared are
# taken days apart at most, so that swelling is rarer than what the plates do. Even growth looks
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
        for tissue, name in NAMES.items()
    ),
    prior_sd=(0.03,) * len(NAMES),
    steps=(1e-6,) * len(NAMES),  # fibres that hardly act fall slack on the way, or not
    transform=transform,
    references=(
        "P. A. Fowler et al., Br. J. Obstet. Gynaecol. 97 (1990) 595",
        "E. K. Rodriguez, A. Hoger, A. D. McCulloch, J. Biomech. 27 (1994) 455",
    ),
    odds=0.2,
)
