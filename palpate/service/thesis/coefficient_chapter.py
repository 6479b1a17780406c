"""Chapter on the 28 similarity coefficients."""

from palpate.service.number_formatting import number
from palpate.service.report.page.page_elements import picture
from palpate.service.thesis import chapter_elements
from palpate.service.thesis.chapter_elements import Chapter, Table, cost_rows
from palpate.service.thesis.thesis_results import CoefficientsResult, Cost
from palpate.workers.comparison.similarity_coefficients import COEFFICIENT_NAMES
from palpate.workers.thesis.coefficient_choice import (
    BAR_LENGTH_MM,
    BAR_SIDE_MM,
    CYLINDER_RADIUS_MM,
    GOLD_FORCE_N,
    GROUPS,
)
from palpate.workers.thesis.coefficient_choice import CYLINDER_LENGTH_MM as CYLINDER_MM

ANGLES = (0, 1, 5, 10, 30, 45, 60, 90)


def chapter(found: CoefficientsResult, cost: Cost | None) -> Chapter:
    """Return the chapter of thesis sections 3.3.2 and 3.3.3."""
    selection, bar = found.selection, found.bar
    in_order = [n for n in (*COEFFICIENT_NAMES, "GSF") if selection.monotone[n]]
    chosen = all(selection.monotone[n] for n in ("D22", "GSF", "JC"))
    verdict = (
        f"{len(in_order)} of 29 measures worsen from each group of deformations to the next, the "
        f"chosen D22, JC and GSF {'among them' if chosen else 'not all among them'}. JC and DC of "
        "the cylinder are least at 90°, and DC falls less."
    )
    return Chapter(
        "coefficients",
        "Coefficients for comparing two bodies",
        "Thesis 3.3.2, 3.3.3",
        verdict,
        "A bar is bent by a force F0 and by eight wrong ones; 28 coefficients compare each result "
        "with the first. Hausdorff variants that do not rank deformations 5 to 7 worst are "
        "rejected; of the others D22 (the modified Hausdorff distance) is chosen. A rotated "
        "cylinder decides between Jaccard and Dice. No size, material or force is printed.",
        f"A bar of {BAR_LENGTH_MM:g} × {BAR_SIDE_MM:g} × {BAR_SIDE_MM:g} mm, nearly "
        "incompressible, "
        f"{bar.nodes} nodes, voxels of {bar.voxel_mm:g} mm. {1000 * GOLD_FORCE_N:g} mN bend its "
        f"end by {number(abs(bar.gold_tip_mm[0]), 3)} mm. The cylinder: {CYLINDER_MM:g} mm long, "
        f"{2 * CYLINDER_RADIUS_MM:g} mm thick, turned across its axis.",
        tables=(_bar(found), _groups(found), _cylinder(found)),
        pictures=(
            picture(
                chapter_elements.coefficient_curves(selection),
                "28 coefficients over the eight deformations of the bar, normalised.",
                "Each coefficient divided by its largest magnitude (thesis Fig. 3.5). Dashed: "
                "rejected by the criterion of the thesis.",
            ),
            picture(
                chapter_elements.cylinder_curves(found.cylinder),
                "JC, DC and GSF of the cylinder against the angle of rotation.",
                "The rotated cylinder (thesis Figs. 3.7 and 3.8).",
            ),
        ),
        differences=(
            *_none_rejected(found),
            "The directions of the forces were in a figure that is not available. They are "
            "chosen so that the deformations, in the order of the thesis, differ more and more "
            "from the gold one.",
            "Means and standard deviations are over boundary voxels, as the printed distances "
            "of later tables imply (the formulas use all voxels).",
        ),
        costs=cost_rows(cost, "not printed"),
    )


def _none_rejected(found: CoefficientsResult) -> tuple[str, ...]:
    if found.selection.rejected:
        return ()
    return (
        "The thesis rejects some Hausdorff variants without naming them; with this bar each of the "
        "20 ranks deformations 5 to 7 behind 1 to 4, so the criterion rejects none of them.",
    )


def _bar(found: CoefficientsResult) -> Table:
    rows = []
    for row in found.bar.rows:
        c = row.coefficients
        end = ", ".join(f"{v:.1f}" for v in row.tip_mm).replace("-", "−")
        values = ["–"] * 5
        if c is not None:
            distances = (c.by_name["D18"], c.mhd_mm, c.volume_difference_mm3)
            values = [number(v, 3) for v in (c.jc, *distances, c.gsf)]
        rows.append([str(row.number), row.forces, end, *values])
    headings = ("", "Forces", "End moves, mm", "JC", "D18, mm", "D22, mm", "ΔV, mm³", "GSF")
    return Table("The bar, deformations from best to worst", headings, rows, (1,))


def _groups(found: CoefficientsResult) -> Table:
    order = " < ".join(", ".join(map(str, group)) for group in GROUPS)
    monotone = found.selection.monotone
    rejected = set(found.selection.rejected)
    thesis = {
        "D22": "chosen",
        "JC": "chosen",
        "DC": "behind JC",
        "dV": "rejected",
        "SM": "rejected",
        "GSF": "built on both",
    }
    rows = []
    for name in ("JC", "DC", "D22", "GSF", "dV", "SM"):
        ours = f"{'in' if monotone[name] else 'not in'} the order {order}"
        rows.append([name, thesis[name], ours])
    kept = found.selection.kept
    rows.append(["D5 to D24", "some rejected", f"{len(kept)} kept: {', '.join(kept) or 'none'}"])
    rows.append(["", "", f"{len(rejected)} rejected: {', '.join(sorted(rejected)) or 'none'}"])
    return Table("The criterion", ("", "Thesis", "Palpate"), rows, (1, 2))


def _cylinder(found: CoefficientsResult) -> Table:
    by_angle = {row.angle_deg: row for row in found.cylinder}
    rows = [
        [f"{a}°", *(number(v, 3) for v in (r.jc, r.dc, r.mhd_mm, r.gsf))]
        for a in ANGLES
        if (r := by_angle[a])
    ]
    return Table("The cylinder", ("Angle", "JC", "DC", "MHD, mm", "GSF"), rows)
