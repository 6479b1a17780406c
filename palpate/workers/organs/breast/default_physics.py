"""Default physics of a breast, for every study, diagnosis and plan that specifies no other.

A blind set gives its law in its files and has no defaults.

The fibres depend on their full stretch, ``I4``, as in the published law and in every study so far;
the isochoric part, ``I4bar``, must be specified.
"""

from typing import Literal

from palpate.storage.values import Triple
from palpate.workers.mechanics.fem.problem.fields import WALL_TO_NIPPLE
from palpate.workers.mechanics.parameters import BREAST

Law = Literal["neo-hookean", "fibre-neo-hookean"]
Fibres = Literal["tension-only", "literal"]
FibreInvariant = Literal["I4", "isochoric"]
Skin = Literal["none", "membrane", "layer"]

LAW: Law = "fibre-neo-hookean"
FIBRES: Fibres = "tension-only"
FIBRE_INVARIANT: FibreInvariant = "I4"
FIBRE_DIRECTION: Triple = WALL_TO_NIPPLE.axis
SKIN: Skin = "none"
SKIN_THICKNESS_MM = 1.5
NU: float = BREAST.complete()["nu"]
# The body slides along the chest wall and cannot move away from it.
WALL_HELD = False
WALL_SPRING_KPA_PER_MM = 0.0
