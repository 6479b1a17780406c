"""Verdicts on every number of chapters 3 to 5 of the thesis: printed and ours."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Literal

from palpate.service.number_formatting import number
from palpate.service.thesis import printed_results
from palpate.service.thesis.thesis_results import (
    FoundSearch,
    MeanCompression,
    MeshResult,
    ThesisResults,
    shear_modulus_error,
)
from palpate.workers.thesis.coefficient_choice import GROUPS
from palpate.workers.thesis.phantom_compression import TARGETS, Scale, View
from palpate.workers.thesis.thesis_eyes import AVERAGE_CORNEA_JC, TABLE_5_1, TABLE_5_2

Word = Literal["reproduced", "approached", "not reproduced", "cannot be", "not run"]
# A number is reproduced within 10 %, or if less is better and it is not larger; approached
# within a factor of two.
SAME, NEAR = 0.10, 2.0
ROUNDING = 1e-9


@dataclass(frozen=True)
class Verdict:
    """One number of the thesis.

    Parameters
    ----------
    place : str
        Where it is in the thesis.
    what : str
    printed, found : str
        Formatted values.
    word : str
    reason : str
        Why it differs from the printed one.
    """

    place: str
    what: str
    printed: str
    found: str
    word: Word
    reason: str = ""


def equal(
    place: str, what: str, wanted: float, found: float | None, unit: str = "", why: str = ""
) -> Verdict:
    """Return the verdict on a number that should be equal; None and nan mean not run."""
    ratio = math.inf
    if found is not None and found > 0:
        ratio = max(found / wanted, wanted / found)
    return _verdict_on(place, what, wanted, found, unit, why, ratio, 1 + SAME)


def at_most(
    place: str, what: str, wanted: float, found: float | None, unit: str = "", why: str = ""
) -> Verdict:
    """Return the verdict on a number for which less is better; None and nan mean not run."""
    ratio = math.inf if found is None else found / wanted
    return _verdict_on(place, what, wanted, found, unit, why, ratio, 1 + ROUNDING)


def holds(
    place: str, what: str, wanted: str, good: bool | None, found: str, why: str = ""
) -> Verdict:
    """Return the verdict on a statement; None means not run."""
    if good is None:
        return Verdict(place, what, wanted, "–", "not run")
    if good:
        return Verdict(place, what, wanted, found, "reproduced")
    return Verdict(place, what, wanted, found, "not reproduced", why)


def with_unit(value: float, unit: str) -> str:
    """Return a number of a table as text; a fraction as per cent."""
    if unit == "%":
        return f"{number(100 * value, 3)} %"
    return f"{number(value, 4)} {unit}".strip()


def _verdict_on(
    place: str,
    what: str,
    wanted: float,
    found: float | None,
    unit: str,
    why: str,
    ratio: float,
    same: float,
) -> Verdict:
    if found is None or math.isnan(found):
        return Verdict(place, what, with_unit(wanted, unit), "–", "not run")
    texts = with_unit(wanted, unit), with_unit(found, unit)
    if ratio <= same:
        return Verdict(place, what, *texts, "reproduced")
    word: Word = "approached" if ratio <= NEAR else "not reproduced"
    return Verdict(place, what, *texts, word, why)


NO_BOX = "the thesis prints neither size, material nor voxels"
ANOTHER_MESHER = "another mesher"
REDUCED_BODY = "a compartment is a larger part of the reduced body, and is displaced less"
HELD_NODES = "it depends on the nodes held at the fixed plate, which are not printed"
# Number of bodies in 250 ml.
VOLUMES: dict[Scale, float] = {"sketch": 8.0, "reduced": 8.0, "full": 1.0}


def verdicts(results: ThesisResults) -> list[Verdict]:
    """Return the verdict on every number of chapters 3 to 5, in the order of the thesis.

    Numbers that cannot be compared are included if their experiment was run.
    """
    whole = results.meshes is not None and results.search is not None
    parts = (
        (_coefficients, results.coefficients is not None),
        (_quality, results.meshes is not None),
        (_compression, results.meshes is not None),
        (_mammogram, results.mammograms is not None),
        (_search, results.search is not None),
        (_sensitivity, results.sensitivity is not None),
        (_beyond, whole),
        (_cornea, results.cornea is not None),
    )
    return [v for judge, ran in parts for v in judge(results) if ran or v.word == "not run"]


def _coefficients(results: ThesisResults) -> Iterator[Verdict]:
    coefficients = results.coefficients
    monotone = None if coefficients is None else coefficients.selection.monotone
    order = " < ".join(", ".join(map(str, group)) for group in GROUPS)
    for name in ("D22", "GSF", "JC", "DC"):
        good = None if monotone is None else monotone[name]
        what, word = f"{name} worsens in the order {order}", "in order" if good else "out of order"
        yield holds("3.3.2, Fig. 3.5", what, "in order", good, word, NO_BOX)
    for name, title in (("dV", "volume difference"), ("SM", "signed mean")):
        good = None if monotone is None else not monotone[name]
        what, word = f"{title} does not rank deformations", "rejected" if good else "in order too"
        yield holds("3.3.2", what, "rejected", good, word, NO_BOX)
    kept = None if coefficients is None else "D22" in coefficients.selection.kept
    what, word = "D22 ranks deformations 5 to 7 behind 1 to 4", "kept" if kept else "rejected"
    yield holds("3.3.2", what, "kept", kept, word, NO_BOX)
    least, decays, identity = None, None, None
    if coefficients is not None:
        turned = [row for row in coefficients.cylinder if 0 < row.angle_deg < 180]
        least = min(turned, key=lambda row: row.jc).angle_deg
        decays = all(row.dc > row.jc for row in turned)
        identity = coefficients.cylinder[0].gsf == -math.inf
    good = None if least is None else least == 90
    yield holds("Fig. 3.7", "angle of the least JC", "90°", good, f"{least or 0:g}°", NO_BOX)
    yield holds("Fig. 3.7", "DC decays less than JC", "everywhere", decays, "everywhere", NO_BOX)
    yield holds("Fig. 3.8", "GSF of identical volumes", "−∞", identity, "−∞")
    yield _figure("Figs. 3.5 to 3.8", "the values of the curves", "figures alone", NO_BOX)


def _quality(results: ThesisResults) -> Iterator[Verdict]:
    meshes = results.meshes
    aspects = {row.kind: row for row in meshes.aspects} if meshes else {}
    for kind, wanted in printed_results.ASPECTS.items():
        row = aspects.get(kind)
        mean, worst = (row.average, row.worst) if row else (None, None)
        place, what = "Table 4.2", f"aspect ratio, {kind}"
        yield at_most(place, f"average {what}", wanted.average, mean, why=ANOTHER_MESHER)
        yield at_most(place, f"worst {what}", wanted.worst, worst, why=ANOTHER_MESHER)
    for kind, count in printed_results.ELEMENTS.items():
        tets = _mean_tets(meshes, kind)
        per_body = None if tets is None else tets * VOLUMES[results.scale]
        why = "the adaptive mesh is as fine where tissues meet, and coarser elsewhere"
        yield equal("4.4.3", f"tetrahedra per 250 ml, {kind}", count, per_body, why=why)
    good = aspects["homogeneous"].average < aspects["adaptive"].average if aspects else None
    why = "another mesher; the averages are close to each other in the thesis, too"
    what = "homogeneous meshes are more regular"
    yield holds("4.4.3", what, "yes", good, "yes" if good else "no", why)
    not_printed = "its values are not printed"
    yield _figure("Fig. 4.15", "M1 to M5 of six meshes", "a figure alone", not_printed)


def _mean_tets(meshes: MeshResult | None, kind: str) -> float | None:
    if meshes is None:
        return None
    return fmean(row.tets for row in meshes.quality if row.kind == kind)


def _compression(results: ThesisResults) -> Iterator[Verdict]:
    meshes = results.meshes
    means = {(m.view, m.law): m for m in meshes.means} if meshes else {}
    why = HELD_NODES if results.scale == "full" else f"{REDUCED_BODY}; and {HELD_NODES}"
    for view, wanted in printed_results.TABLE_43.items():
        yield from _compared_meshes(
            view, "Table 4.3", wanted, means.get((view, "neo-Hookean")), why
        )
    law = f"its constants are not printed (the same shear moduli are used); {why}"
    for view, wanted in printed_results.MOONEY_RIVLIN.items():
        yield from _compared_meshes(
            f"Mooney-Rivlin, {view}", "4.4.4", wanted, means.get((view, "Mooney-Rivlin")), law
        )
    cc, mlo = (means.get((view, "neo-Hookean")) for view in ("CC", "MLO"))
    better = None if cc is None or mlo is None else mlo.jc > cc.jc
    yield holds("4.4.4", "MLO agrees better than CC", "yes", better, "yes" if better else "no", why)
    times = {t.mesh: t.mean_s for t in meshes.times if t.view == "CC"} if meshes else {}
    for kind, seconds in printed_results.SECONDS_PER_1000.items():
        what = f"seconds per 1000 elements, CC, {kind}"
        yield at_most("Fig. 4.16", what, seconds, times.get(kind), "s")
    contradiction = "inconsistent with the printed seconds: 23 s × 900 are 5.75 h, not 7"
    yield _figure("4.4.4", "hours of a compression (7, 2, 2, 1.45)", "2 to 7 h", contradiction)


def _compared_meshes(
    case: View | str,
    place: str,
    wanted: printed_results.Compared,
    mean: MeanCompression | None,
    why: str,
) -> Iterator[Verdict]:
    """Yield the verdicts on a row of Table 4.3; for a Jaccard coefficient on 1 - JC."""
    centroid, volume, jc, mhd = (None,) * 4
    if mean is not None:
        centroid, volume, jc, mhd = mean.centroid_mm, mean.volume_mm3, mean.jc, mean.mhd_mm
    yield at_most(place, f"centroid distance, {case}", wanted.centroid_mm, centroid, "mm", why)
    yield at_most(place, f"volume difference, {case}", wanted.volume_mm3, volume, "mm³", why)
    if wanted.jc is not None:
        what, lacking = f"Jaccard coefficient, {case}", None if jc is None else 1 - jc
        judged = at_most(place, what, 1 - wanted.jc, lacking, why=why)
        shown = judged.found if jc is None else with_unit(jc, "")
        yield replace(judged, printed=with_unit(wanted.jc, ""), found=shown)
    if wanted.mhd_mm is not None:
        what = f"modified Hausdorff distance, {case}"
        yield at_most(place, what, wanted.mhd_mm, mhd, "mm", why)


def _mammogram(results: ThesisResults) -> Iterator[Verdict]:
    pairs = results.mammograms
    beyond = None if pairs is None else all(p.attenuation_rms > p.quantum_rms for p in pairs)
    what = "the meshes differ around the compartments, noise elsewhere"
    word = "beyond noise in every pair" if beyond else "within noise"
    yield holds("Fig. 4.18", what, "a picture", beyond, word)
    assumed = "a tungsten tube at 28 kV behind rhodium and 60 mAs are assumed"
    what, found = "geometry, spectrum, dose, pixels", "given on the page"
    yield Verdict("4.4.3", what, "not printed", found, "cannot be", assumed)


def _search(results: ThesisResults) -> Iterator[Verdict]:
    search = results.search
    weak = (
        "the deformed shape hardly depends on it, as the thesis' Fig. 4.22 shows; the estimate "
        "in a flat valley is where the search happened to stop"
    )
    few = "the reduced search has fewer candidates, larger voxels and a coarser mesh"
    few = few if results.scale != "full" else ""
    for target, table in printed_results.SEARCHES.items():
        searches = [] if search is None else search.of(target)
        for column, name in enumerate(TARGETS[target]):
            why = weak if name.startswith("eta") else few
            note = f"; {table.note}" if target == "X3" and name == "E_glandular_kpa" else ""
            what, theirs = f"of {name.removesuffix('_kpa')}", table.error[column]
            alone, polished = _mean_errors(searches, column)
            if alone is not None:
                what_alone = f"mean relative error {what}, genetic alone"
                yield at_most(table.name, what_alone, theirs, alone, "%", why + note)
            what = f"mean relative error {what}{', polished' if alone is not None else ''}"
            yield at_most(table.name, what, theirs, polished, "%", why + note)
        overlap = min((s.jc for s in searches if s.jc is not None), default=None)
        worst = min(row.jc for row in table.rows)
        good, shown = (None, "–") if overlap is None else (overlap >= worst, number(overlap, 3))
        yield holds(table.name, "least JC of its phantoms", number(worst, 3), good, shown, few)
    yield _hours(results)


def _hours(results: ThesisResults) -> Verdict:
    """Return the verdict on the time of a search, if the problem has the thesis' size."""
    search, wanted = results.search, printed_results.HOURS * printed_results.CORES
    hours = fmean(s.cpu_s for s in search.searches) / 3600 if search and search.searches else None
    place, what = "4.5.6", "core hours of a search"
    if results.scale == "full" or hours is None:
        return at_most(place, what, wanted, hours, "h")
    why = "a smaller problem: a coarser mesh, larger voxels, fewer candidates; run with --full"
    texts = with_unit(wanted, "h"), with_unit(hours, "h")
    return Verdict(place, what, *texts, "cannot be", why)


def _mean_errors(found: list[FoundSearch], column: int) -> tuple[float | None, float | None]:
    """Return the mean errors of the genetic stage (None without refinement) and at the end."""
    if not found:
        return None, None
    constants = [s.constants[column] for s in found]
    before = [c.genetic_error for c in constants if c.genetic_error is not None]
    return fmean(before) if before else None, fmean(c.error for c in constants)


def _sensitivity(results: ThesisResults) -> Iterator[Verdict]:
    varied = results.sensitivity or ()
    eta = next((v for v in varied if v.constant == "eta_glandular_kpa"), None)
    lowest, most = (eta.lowest_jc, eta.most_mhd_voxels) if eta else (None, None)
    why = "it depends on the body, its density and its voxels" if results.scale != "full" else ""
    place, what = "Fig. 4.22", "over all of eta_glandular"
    good = None if lowest is None else lowest > printed_results.LOWEST_JC
    shown = f"≥ {number(lowest, 3)}"
    yield holds(place, f"JC {what}", f"> {printed_results.LOWEST_JC}", good, shown, why)
    good = None if most is None else most < printed_results.MOST_MHD_VOXELS
    wanted, shown = f"< {printed_results.MOST_MHD_VOXELS:g}", f"≤ {number(most, 3)}"
    yield holds(place, f"MHD {what}, voxels", wanted, good, shown, why)


def _cornea(results: ThesisResults) -> Iterator[Verdict]:
    valley = (
        "one deformed section determines one combination of the four constants; others deform it "
        "alike"
    )
    found = {search.target: search for search in results.cornea or ()}
    for eye in TABLE_5_1:
        ours = found.get(eye.name)
        for column, name in enumerate(eye.target._fields):
            what = f"error of {name.removesuffix('_pa')}, {eye.name}"
            theirs = eye.printed_errors_percent[column] / 100
            error = None if ours is None else ours.constants[column].error
            yield at_most("Table 5.1", what, theirs, error, "%", valley)
        theirs, error = eye.shear_modulus_error, None if ours is None else shear_modulus_error(ours)
        what, size = f"error of G0, {eye.name}", None if error is None else abs(error)
        yield at_most("Table 5.1", what, abs(theirs), size, "%", "the target has a finer mesh")
        mhd_um = None if ours is None or ours.mhd_mm is None else 1000 * ours.mhd_mm
        yield at_most("Table 5.1", f"MHD, {eye.name}", eye.mhd_um, mhd_um, "µm")
        jc = None if ours is None else ours.jc
        good, shown = (None, "–") if jc is None else (jc >= eye.jc, number(jc, 4))
        yield holds("Table 5.1", f"JC, {eye.name}", f"≥ {eye.jc}", good, shown)
    unpublished = "the images of the eyes are not published"
    what = f"constants, JC and MHD of {len(TABLE_5_2)} eyes"
    ours_text = "eyes rebuilt from them: examples/cornea-cohort/run.py"
    rows = (
        ("Table 5.2", what, "24 rows", ours_text, unpublished),
        ("5.5", "JC of the average cornea", f"{AVERAGE_CORNEA_JC[0]}", ours_text, unpublished),
        ("5.3", "jet", "15 mmHg", "15 kPa", "with 15 mmHg no cornea turns concave"),
    )
    for place, what, printed_there, shown, why in rows:
        yield Verdict(place, what, printed_there, shown, "cannot be", why)


def _figure(place: str, what: str, printed_there: str, why: str) -> Verdict:
    """Return a verdict for numbers that are shown on the page but cannot be compared."""
    return Verdict(place, what, printed_there, "see the page", "cannot be", why)


def _beyond(results: ThesisResults) -> Iterator[Verdict]:
    """Yield verdicts on numbers that no run can decide."""
    rows = (
        (
            "4.4.3",
            "phantoms of 250 ml and 170 × 100 × 50 mm",
            "both",
            "250 ml",
            "a body of these dimensions has 445 ml; 250 ml are 170 × 75 × 37.5 mm",
        ),
        (
            "4.4.3",
            "edges of 1 mm and 425 000 tetrahedra",
            "both",
            "425 000",
            "edges of 1 mm would need 2.1 million in 250 ml; the number is kept",
        ),
        (
            "Table 4.6",
            "row of phantom 2 and its statistics",
            "both",
            "the statistics",
            printed_results.SEARCHES["X3"].note,
        ),
        (
            "4.5.6",
            "seeds and operators of the genetic algorithm",
            "not printed",
            "those of MATLAB's ga",
            "so estimates of a single phantom cannot be reproduced exactly",
        ),
    )
    for place, what, printed_there, ours, why in rows:
        yield Verdict(place, what, printed_there, ours, "cannot be", why)
