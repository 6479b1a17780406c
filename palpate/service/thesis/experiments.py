"""The parts of each experiment of the thesis, in the order of their dependencies.

::

    coefficients   nine bars > compared; the cylinder
    mesh-quality   meshes; compressions > compared
    mammogram      compressions > mammograms
    search         studies, see `service.thesis.search`
    sensitivity     variation of every constant
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, get_args

import numpy as np

from palpate.workers.body.mesh.adaptive.tetwild import has_tetwild
from palpate.workers.tasks.thesis.coefficients import (
    Bend,
    Compare,
    Turn,
    bend_bar,
    compare_bars,
    turn_cylinder,
)
from palpate.workers.tasks.thesis.mammograms import Expose, take_mammograms
from palpate.workers.tasks.thesis.meshes import (
    ComparePressed,
    Measure,
    Press,
    compare_pressed,
    measure_mesh,
    press_phantom,
)
from palpate.workers.tasks.thesis.parts import Request, Spent
from palpate.workers.tasks.thesis.sensitivity import Vary, vary_constant
from palpate.workers.thesis.bar import DEFORMATIONS
from palpate.workers.thesis.compression import AXES, LawName
from palpate.workers.thesis.identification import TARGETS, TargetName, bounds_of
from palpate.workers.thesis.mesh_quality import MeshKind, kinds_at
from palpate.workers.thesis.phantoms import NUMBERS
from palpate.workers.thesis.scale import Scale

Experiment = Literal["coefficients", "mesh-quality", "mammogram", "search", "sensitivity"]
EXPERIMENTS: tuple[Experiment, ...] = get_args(Experiment)
LAWS: tuple[LawName, ...] = get_args(LawName)
PRESSED_ON: tuple[MeshKind, ...] = ("adaptive", "homogeneous")
# Number of values of each constant, evenly spaced over its interval, with the target added.
VALUES: dict[Scale, int] = {"sketch": 3, "reduced": 9, "full": 16}
# The phantom of the sensitivity and of the mesh slices.
SHOWN_PHANTOM = 3

AnyRequest = Any  # a request for the phase's task


@dataclass(frozen=True)
class Phase:
    """Parts that are independent of each other.

    Parameters
    ----------
    title : str
        Description for the user.
    task : callable
        Takes a request, stores the part, returns its cost.
    requests : sequence of Request
    """

    title: str
    task: Callable[[AnyRequest], Spent]
    requests: Sequence[Request]

    @property
    def missing(self) -> list[Request]:
        """Return the parts missing in the store."""
        return [request for request in self.requests if not request.part.is_finished]


def phases_of(experiment: Experiment, store: str, scale: Scale) -> list[Phase]:
    """Return the phases of an experiment in order."""
    make = {
        "coefficients": _coefficients,
        "mesh-quality": _mesh_quality,
        "mammogram": _mammogram,
        "search": lambda *_: [],
        "sensitivity": _sensitivity,
    }[experiment]
    return make(store, scale)


def measured_meshes(store: str, scale: Scale) -> list[Measure]:
    """Return the meshes whose quality is measured; fTetWild only if it is installed."""
    kinds = kinds_at(scale, other_mesher=has_tetwild())
    return [Measure(store, scale, n, kind) for n, kind in product(NUMBERS[scale], kinds)]


def compressions(store: str, scale: Scale, laws: Sequence[LawName] = LAWS) -> list[Press]:
    """Return the compressions, grouped by mesh."""
    every = product(NUMBERS[scale], PRESSED_ON, laws, AXES)
    return [Press(store, scale, number, mesh, law, view) for number, mesh, law, view in every]


def comparisons(store: str, scale: Scale) -> list[ComparePressed]:
    """Return the comparisons between both meshes."""
    every = product(NUMBERS[scale], LAWS, AXES)
    return [ComparePressed(store, scale, number, law, view) for number, law, view in every]


def exposures(store: str, scale: Scale) -> list[Expose]:
    """Return the mammograms, two views for each phantom."""
    return [Expose(store, scale, n, view) for n, view in product(NUMBERS[scale], AXES)]


def variations(store: str, scale: Scale) -> list[Vary]:
    """Return all values of all constants: four on the model without skin, E_skin with skin."""
    shown: list[tuple[TargetName, str]] = [("X1", name) for name in TARGETS["X1"]]
    shown.append(("X3", "E_skin_kpa"))
    found = []
    for target, constant in shown:
        low, high = bounds_of(target)[constant]
        values = {*np.linspace(low, high, VALUES[scale]).tolist(), TARGETS[target][constant]}
        found += [Vary(store, scale, target, SHOWN_PHANTOM, constant, v) for v in sorted(values)]
    return found


def _coefficients(store: str, scale: Scale) -> list[Phase]:
    bars = [Bend(store, scale, number) for number in (0, *DEFORMATIONS)]
    return [
        Phase("bending the bar", bend_bar, bars),
        Phase("comparing the bars", compare_bars, [Compare(store, scale)]),
        Phase("turning the cylinder", turn_cylinder, [Turn(store, scale)]),
    ]


def _mesh_quality(store: str, scale: Scale) -> list[Phase]:
    return [
        Phase("measuring meshes", measure_mesh, measured_meshes(store, scale)),
        Phase("pressing phantoms", press_phantom, compressions(store, scale)),
        Phase("comparing both meshes", compare_pressed, comparisons(store, scale)),
    ]


def _mammogram(store: str, scale: Scale) -> list[Phase]:
    return [
        Phase("pressing phantoms", press_phantom, compressions(store, scale, ("neo-Hookean",))),
        Phase("taking mammograms", take_mammograms, exposures(store, scale)),
    ]


def _sensitivity(store: str, scale: Scale) -> list[Phase]:
    requests = variations(store, scale)
    return [Phase("varying the constants", vary_constant, requests)]
