"""Chapter on the sensitivity to each constant."""

from collections.abc import Sequence

from palpate.service.formatting import number, symbol
from palpate.service.report.drawing.pictures import picture
from palpate.service.thesis import charts, printed
from palpate.service.thesis.chapters.costs import cost_rows
from palpate.service.thesis.experiments import SHOWN_PHANTOM
from palpate.service.thesis.page import Chapter, Table
from palpate.service.thesis.results import Cost, Varied


def chapter(found: Sequence[Varied], cost: Cost | None) -> Chapter:
    """Return the chapter of thesis Fig. 4.22."""
    one = next(v for v in found if v.constant == "eta_glandular_kpa")
    ranked = sorted(found, key=lambda v: v.lowest_jc)
    strongest = ranked[0].constant.removesuffix("_kpa").replace("_", " ")
    return Chapter(
        "sensitivity",
        "Sensitivity of the scores to each constant",
        "Thesis 4.5.7, Fig. 4.22",
        f"Over the whole interval of η glandular JC is at least {number(one.lowest_jc, 3)} and "
        f"MHD at most {number(one.most_mhd_voxels, 3)} voxels (thesis: above 0.93 and below 1 "
        f"voxel). {strongest} has the largest influence.",
        "All constants but η glandular are held at the target; η glandular varies from 50 to "
        "200 kPa, and JC and MHD of the deformed phantom are plotted against it.",
        f"The same for every constant, each over its interval: phantom {SHOWN_PHANTOM}, target X1 "
        "without skin, and the skin's modulus on the model with skin.",
        tables=(_table(found),),
        pictures=(
            picture(
                charts.sensitivity_curves(found),
                "JC and MHD against each constant.",
                "Dotted: the target. A constant with a flat curve cannot be identified.",
            ),
        ),
        differences=(
            "The printed distances are in voxels of 0.2 mm; ours are in voxels of this scale, so "
            "they are also given in millimetres.",
        ),
        costs=cost_rows(cost, "not printed"),
    )


def _table(found: Sequence[Varied]) -> Table:
    rows = []
    for v in found:
        theirs = ("–", "–")
        if v.constant == "eta_glandular_kpa":
            theirs = (f"> {printed.LOWEST_JC}", f"< {printed.MOST_MHD_VOXELS:g}")
        most_mm = max((d for d in v.mhd_mm if d is not None), default=float("nan"))
        interval = f"{number(v.values_kpa[0])} … {number(v.values_kpa[-1])}"
        rows.append(
            [
                symbol(v.constant, "kPa"),
                interval,
                number(v.at_target),
                theirs[0],
                number(v.lowest_jc, 3),
                theirs[1],
                number(v.most_mhd_voxels, 3),
                number(most_mm, 3),
            ]
        )
    headings = (
        "",
        "Interval, kPa",
        "Target",
        "Least JC, thesis",
        "Palpate",
        "MHD, voxels, thesis",
        "Palpate",
        "Palpate, mm",
    )
    return Table("Worst scores over each interval", headings, rows)
