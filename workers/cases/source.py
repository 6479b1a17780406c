"""Where a subject comes from: what a diagnosis asks of a case, a study or an experiment."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from workers.diagnosis.diagnosis import Diagnosis
from workers.diagnosis.subject import Subject
from workers.effects.base import Effect
from workers.fem.model import Model
from workers.pictures.of_scans import Moved


class Source(Protocol):
    """Something that was imaged or measured, with a model of it."""

    @property
    def name(self) -> str:
        """In the words of its owner."""

    @property
    def scans(self) -> Sequence[str]:
        """Names of the loaded states, in order."""

    @property
    def files(self) -> Sequence[Path]:
        """All files that the result depends on."""

    @property
    def effects(self) -> Sequence[Effect]:
        """The catalogue of what may be missing from the model."""

    def check(self) -> None:
        """See whether the data can be one body in several states, before anything is fitted.

        Raises
        ------
        InputError
            Saying what was found, what was expected and what to change.
        """

    def subject(self, nodes: int, spacing_mm: float) -> Subject:
        """What every fit shares, on a mesh of `nodes`, with points `spacing_mm` apart.

        Raises
        ------
        InputError
            If there is nothing to mesh or nothing to compare.
        """

    def finer(self, nodes: int) -> Model | None:
        """Another mesh of the same body, to see what the mesh adds; None if that is known."""

    def pictures(self, found: Diagnosis, moved: Moved) -> tuple[dict[str, NDArray[Any]], Any]:
        """What the report draws of the bodies, and rows for the summary; may both be empty."""
