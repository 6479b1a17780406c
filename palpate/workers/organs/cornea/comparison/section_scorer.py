"""The score of a study: similarity of two sections inside a window, as named numbers."""

import math
from dataclasses import dataclass

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.comparison.section_score import SectionScore, SectionTarget
from palpate.workers.organs.cornea.section.cropped import cropped_section
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.spec import CorneaScore

# Score of a candidate so folded that no part of it is in the window.
NOTHING_SHARED = SectionScore(jc=0.0, mhd_um=math.inf, gsf=math.inf)


@dataclass(frozen=True)
class NamedScore:
    """A score with the pixel size of its GSF.

    Parameters
    ----------
    score : SectionScore
    pixel_um : float
    """

    score: SectionScore
    pixel_um: float

    def as_dict(self) -> dict[str, float]:
        """See `workers.organs.organ.Score`."""
        jc, mhd_um = self.score.jc, self.score.mhd_um
        return {
            "jc": jc,
            "dice": 2 * jc / (1 + jc),
            "mhd_mm": mhd_um / 1000,
            "mhd_voxels": mhd_um / self.pixel_um,
            "gsf": self.score.gsf,
        }


class SectionScorer:
    """Comparison of sections with one target.

    Parameters
    ----------
    target : Section
    spec : CorneaScore

    Raises
    ------
    InputError
        If the target has no area, or none inside the window.
    """

    def __init__(self, target: Section, spec: CorneaScore) -> None:
        self._spec = spec
        self._target = SectionTarget(self._in_window(target), pixel_um=spec.pixel_um)

    def score(self, body: Section, /) -> NamedScore:
        """Compare a section with the target."""
        try:
            score = self._target.score(self._in_window(body))
        except InputError:
            score = NOTHING_SHARED
        return NamedScore(score, self._spec.pixel_um)

    def _in_window(self, section: Section) -> Section:
        window = self._spec.window_mm
        return section if window is None else cropped_section(section, *window)
