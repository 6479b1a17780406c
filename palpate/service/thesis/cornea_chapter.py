"""Chapter on the constants of two synthetic corneas."""

from collections.abc import Sequence

from palpate.service.number_formatting import count, number, symbol
from palpate.service.thesis.chapter_elements import Chapter, Table, Text, cost_rows
from palpate.service.thesis.thesis_results import Cost, FoundSearch, shear_modulus_error
from palpate.workers.thesis.phantom_compression import Scale
from palpate.workers.thesis.thesis_eyes import EYE_ELEMENTS, FINER_TARGET, TABLE_5_1, SyntheticEye

G0 = "G0 = ½ Σ μα"


def chapter(found: Sequence[FoundSearch], cost: Cost | None, scale: Scale) -> Chapter:
    """Return the chapter of thesis section 5.5."""
    errors = ", ".join(f"{_percent(abs(shear_modulus_error(f)))} for {f.target}" for f in found)
    elements = EYE_ELEMENTS[scale]
    return Chapter(
        "cornea",
        "The constants of two corneas",
        "Thesis 5.5, Table 5.1",
        f"The stiffness at rest, {G0}, is found within {errors}. One deformed section does not "
        "determine the four constants behind it.",
        "The genetic algorithm of the breast finds the four constants of a second-order Ogden law "
        "from a section of a cornea under an air jet, for two targets at the same pressure and "
        "thickness. Kind of plane, mesh, bounds and convention of the law are not printed.",
        f"Plane stress, μ/α, a jet of 15 kPa, {count(elements)} 6-node triangles and a target of "
        f"{count(FINER_TARGET * elements)}, searched up to 40 kPa and 100 by the studies of "
        "`palpate run`.",
        tables=[_table(eye, f) for f in found for eye in TABLE_5_1 if eye.name == f.target],
        differences=(
            "With the printed jet of 15 mmHg no cornea turns concave; 15 kPa gives the "
            "displacement of the thesis' images.",
            "The 24 eyes of Table 5.2 cannot be searched again: their images are not published. "
            "`examples/cornea-cohort/run.py` rebuilds them from the printed constants.",
        ),
        costs=cost_rows(cost, "not printed"),
    )


def _table(eye: SyntheticEye, found: FoundSearch) -> Table:
    rows: list[Sequence[Text]] = []
    printed = zip(eye.target, eye.estimate, eye.printed_errors_percent, strict=True)
    for c, (target, estimate, error) in zip(found.constants, printed, strict=True):
        theirs = number(estimate), f"{number(error, 3)} %"
        ours = number(c.estimate), _percent(c.error)
        rows.append([symbol(c.name), number(target), *theirs, *ours])
    G, theirs_error = eye.target.shear_modulus_mpa, eye.shear_modulus_error
    ours_error = shear_modulus_error(found)
    shear = [(number(G * (1 + e)), _percent(abs(e))) for e in (theirs_error, ours_error)]
    rows.append([f"{G0}, MPa", number(G), *shear[0], *shear[1]])
    ours_mhd_um = None if found.mhd_mm is None else 1000 * found.mhd_mm
    for name, theirs_score, ours_score in (
        ("JC", eye.jc, found.jc),
        ("MHD, µm", eye.mhd_um, ours_mhd_um),
    ):
        rows.append([name, "", number(theirs_score), "", number(ours_score), ""])
    headings = ("", "Target", "Thesis", "Error", "Palpate", "Error")
    note = f"μ in Pa. {count(found.evaluations)} evaluations; {found.stopped}."
    return Table(f"{eye.name} (Table 5.1)", headings, rows, note=note)


def _percent(share: float) -> str:
    return f"{number(100 * share, 3)} %"
