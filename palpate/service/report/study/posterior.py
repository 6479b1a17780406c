"""The corner plot of the constants of a study."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from palpate.service.formatting import label, number
from palpate.service.report.drawing.pictures import Picture, picture
from palpate.service.results.record import StudyResults
from palpate.service.results.samples import constants_with_samples, draw_samples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRAWS = 20_000


def posterior_figure(results: StudyResults, constants: Sequence[str] | None = None) -> "Figure":
    """Draw the posterior of the constants as a corner plot.

    Parameters
    ----------
    results : StudyResults
    constants : sequence of str, optional
        Default: all searched ones.

    Raises
    ------
    InputError
        If a constant is unknown or has no interval, with the reason.
    """
    # Loads matplotlib, which most pages do not need.
    from palpate.service.report.drawing.corner import CornerVariable, corner_plot

    samples = draw_samples(results, DRAWS, constants=constants)
    shown = [e for e in results.estimates.values() if e.gene in samples]
    return corner_plot(
        [
            CornerVariable(label(e.gene, e.unit), samples[e.gene], e.interval, e.estimate, e.target)
            for e in shown
            if e.interval is not None and e.estimate is not None
        ]
    )


def posterior_picture(results: StudyResults) -> Picture | None:
    """Draw the constants with intervals; None if there are fewer than two."""
    known = constants_with_samples(results)
    if len(known) < 2:
        return None
    alt = "; ".join(
        f"{label(e.gene, e.unit)}: {number(e.estimate)}, {number(e.interval[0])} to "
        f"{number(e.interval[1])}"
        for e in (results.estimates[name] for name in known)
        if e.interval is not None
    )
    targets = any(results.estimates[name].target is not None for name in known)
    caption = (
        "Remaining uncertainty. Contours contain 50 % and 90 % of the probability; shaded "
        "ranges are the 90 % intervals. A slanted contour shows that errors of the two "
        "constants can compensate. Line and dot: estimate"
        + ("; dashed line and diamond: target." if targets else ".")
    )
    return picture(posterior_figure(results, known), f"Posterior. {alt}.", caption)
