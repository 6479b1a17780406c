"""What is known of an acquisition before any loaded scan is made.

The reference scan, the loads that are meant, the noise of the segmentation and the model
with its plausible constants. A loaded scan that lies there already is not opened.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from storage.values import Volume
from workers.cases.build import body_of
from workers.cases.case import ImagedCase
from workers.diagnosis.subject import Free, Values
from workers.effects.base import Effect
from workers.effects.catalogue import BREAST_EFFECTS
from workers.fem.fields import Frame
from workers.fem.problem import Problem
from workers.mesh.hierarchy import Hierarchy, build_hierarchy
from workers.observation.noise import SegmentationNoise

Builder = Callable[[Values], Problem]
"""From values of the free constants to the problem of one load."""


@dataclass(frozen=True, eq=False)
class Prospect:
    """An acquisition that is meant.

    Parameters
    ----------
    name : str
        In the words of its owner.
    reference : Volume
        `Tissue` labels of the body at rest, on whose interfaces points are put.
    mesh : callable
        From a number of nodes to the mesh of the body.
    noise : SegmentationNoise
    free : sequence of Free
        Constants of the model that the scans must determine.
    loads : sequence of str
        Names of the loaded scans.
    problem : callable
        From the number of a load and the frame of the body to its problem.
    effects : sequence of Effect
        What may be missing from the model.
    files : sequence of Path
        All that this depends on.
    """

    name: str
    reference: Volume
    mesh: Callable[[int], Hierarchy]
    noise: SegmentationNoise
    free: Sequence[Free]
    loads: Sequence[str]
    problem: Callable[[int, Frame], Builder]
    effects: Sequence[Effect]
    files: Sequence[Path]


def prospect_of_case(folder: Path) -> Prospect:
    """The acquisition that a case.json describes; of the scans only the reference is read.

    Raises
    ------
    InputError
        If the folder is no case, or its reference scan is missing.
    """
    case = _MeantCase(folder)
    return Prospect(
        name=case.file.id,
        reference=case.reference,
        mesh=partial(_meshed, body_of(case)),
        noise=case.noise,
        free=case.free,
        loads=case.names,
        problem=case.problem,
        effects=BREAST_EFFECTS,
        files=[folder / "case.json", folder / case.file.scans.reference],
    )


def _meshed(body: Volume, nodes: int) -> Hierarchy:
    return build_hierarchy(body, nodes=nodes)


class _MeantCase(ImagedCase):
    """A case whose loaded scans may not be made yet.

    The body at rest stands for them: plates at a distance then close around its middle.
    """

    def _scan(self, name: str) -> Volume:
        return super()._scan(self.file.scans.reference)
