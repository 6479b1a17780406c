"""A folder of segmented scans as the source of a diagnosis."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from workers.cases.build import body_of, build_subject
from workers.cases.case import ImagedCase, above_wall
from workers.cases.checks import check_case
from workers.diagnosis.diagnosis import Diagnosis
from workers.diagnosis.subject import Subject
from workers.effects.base import Effect
from workers.effects.catalogue import BREAST_EFFECTS
from workers.fem.model import Model, prepare
from workers.mesh.hierarchy import build_hierarchy
from workers.pictures.of_scans import Moved, pictures_of_scans


class ImagedSource:
    """See `workers.cases.source.Source`.

    Parameters
    ----------
    folder : Path
        With case.json and its scans.

    Raises
    ------
    InputError
        If the folder is no case.
    """

    def __init__(self, folder: Path) -> None:
        self.case = ImagedCase(folder)

    @property
    def name(self) -> str:
        """The case's."""
        return self.case.file.id

    @property
    def scans(self) -> Sequence[str]:
        """Of the loaded scans."""
        return self.case.names

    @property
    def files(self) -> Sequence[Path]:
        """Those that case.json names, and itself."""
        scans = self.case.file.scans
        repeat = [scans.reference_repeat] if scans.reference_repeat else []
        named = ["case.json", scans.reference, *repeat, *(d.file for d in scans.deformed)]
        return [self.case.folder / name for name in named]

    @property
    def effects(self) -> Sequence[Effect]:
        """What may be missing from the model of a breast."""
        return BREAST_EFFECTS

    def check(self) -> None:
        """Refuse scans that cannot be one body under these loads."""
        check_case(self.case)

    def subject(self, nodes: int, spacing_mm: float) -> Subject:
        """Mesh, points on the interfaces and distance maps."""
        return build_subject(self.case, nodes, spacing_mm)

    def finer(self, nodes: int) -> Model:
        """Of the same outline."""
        return prepare(build_hierarchy(body_of(self.case), nodes=nodes))

    def pictures(self, found: Diagnosis, moved: Moved) -> tuple[dict[str, NDArray[Any]], Any]:
        """Bodies, maps and overlaps."""
        case = self.case
        return pictures_of_scans(
            found, moved, case.reference, case.deformed, lambda v: above_wall(v, case.wall_mm)
        )
