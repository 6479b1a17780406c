"""Comparison of studies."""

from pathlib import Path
from typing import TYPE_CHECKING, Self

from palpate.service.extras import frame_type
from palpate.service.report.comparison.page import write_comparison
from palpate.service.report.notebook import comparison_html
from palpate.service.results.comparison import StudyComparison, compare_studies
from palpate.study import Study

if TYPE_CHECKING:
    from pandas import DataFrame


class Comparison(StudyComparison):
    """A comparison of studies; see `compare`.

    - ``studies``: for each study, its ``label``, ``results`` (see `StudyResults`) and
      ``lowest_scores``, the lowest score after 1, 2, 3 ... evaluations,
    - ``settings``: the keys of the study file that differ, with their values in every study,
    - ``as_dict()`` and ``as_csv()``: the record and the table of ``palpate compare``.
    """

    @classmethod
    def of(cls, found: StudyComparison) -> Self:
        """Convert a comparison to this class, which notebooks can display."""
        return cls(found.studies, found.settings, found.axis)

    def to_frame(self) -> "DataFrame":
        """Return a pandas table: one row for each constant and score of each study.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        made: DataFrame = frame_type()(list(self.rows()))
        return made

    def write_page(self, path: str | Path) -> Path:
        """Write an HTML page with charts and return its path."""
        return write_comparison(self, Path(path))

    def __repr__(self) -> str:
        labels = ", ".join(study.label for study in self.studies)
        return f"<Comparison of {len(self.studies)} studies: {labels}"[:498] + ">"

    def _repr_html_(self) -> str:
        return str(comparison_html(self))


def compare(*studies: Study | str | Path) -> Comparison:
    """Compare the results and settings of several studies.

    Parameters
    ----------
    *studies : Study, str or Path
        At least two studies or their folders; some may still be running.

    Raises
    ------
    InputError
        If there are fewer than two studies, one is given twice, or a folder is not a study.
    JournalError
        If a journal is damaged.
    """
    folders = [Path(s.folder) if isinstance(s, Study) else Path(s) for s in studies]
    return Comparison.of(compare_studies(folders))
