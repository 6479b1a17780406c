"""Every number of the thesis' chapters 3 and 4: reproduced, approached, or why not."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Literal

from service.formatting import number
from service.thesis import printed
from service.thesis.results import (
    FoundSearch,
    MeanCompression,
    MeshResult,
    SolverTime,
    ThesisResults,
)
from workers.thesis.bar import GROUPS
from workers.thesis.identification import TARGETS
from workers.thesis.scale import Scale

Word = Literal["reproduced", "approached", "not reproduced", "cannot be", "not run"]
# A number is reproduced within a tenth, or where less is better and it is not more; approached
# within a factor of two.
SAME, NEAR = 0.10, 2.0
NO_BOX = "the thesis prints no size, material or voxels of it"
# Bodies in 250 ml.
VOLUMES: dict[Scale, float] = {"sketch": 8.0, "reduced": 8.0, "full": 1.0}
REDUCED_BODY = "a compartment is a larger part of the reduced body, and is moved less far"


@dataclass(frozen=True)
class Verdict:
    """One number of the thesis.

    Parameters
    ----------
    place : str
        Where it is printed.
    what : str
    printed, found : str
        As a reader wants them.
    word : str
    reason : str
        Why it is not, or not quite, the printed one.
    """

    place: str
    what: str
    printed: str
    found: str
    word: Word
    reason: str = ""


def verdicts(results: ThesisResults) -> list[Verdict]:
    """Judge every number of chapters 3 and 4 in the order of the thesis.

    What cannot be compared is said where its experiment was run.
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
    )
    return [v for judge, ran in parts for v in judge(results) if ran or v.word == "not run"]


def equal(
    place: str, what: str, wanted: float, found: float | None, unit: str, why: str
) -> Verdict:
    """Judge a number that should be the same."""
    if found is None or math.isnan(found):
        return Verdict(place, what, _text(wanted, unit), "–", "not run")
    ratio = max(found / wanted, wanted / found) if found > 0 else math.inf
    word: Word = "not reproduced"
    if ratio <= 1 + SAME:
        word, why = "reproduced", ""
    elif ratio <= NEAR:
        word = "approached"
    return Verdict(place, what, _text(wanted, unit), _text(found, unit), word, why)


def at_most(
    place: str, what: str, wanted: float, found: float | None, unit: str, why: str
) -> Verdict:
    """Judge a number of which less is better."""
    if found is None or math.isnan(found):
        return Verdict(place, what, _text(wanted, unit), "–", "not run")
    word: Word = "not reproduced"
    if found <= wanted * (1 + 1e-9):
        word, why = "reproduced", ""
    elif found <= NEAR * wanted:
        word = "approached"
    return Verdict(place, what, _text(wanted, unit), _text(found, unit), word, why)


def holds(place: str, what: str, wanted: str, good: bool | None, found: str, why: str) -> Verdict:
    """Judge a statement."""
    if good is None:
        return Verdict(place, what, wanted, "–", "not run")
    return Verdict(
        place, what, wanted, found, "reproduced" if good else "not reproduced", "" if good else why
    )


def _text(value: float, unit: str) -> str:
    if unit == "%":
        return f"{number(100 * value, 3)} %"
    return f"{number(value, 4)} {unit}".strip()


def _coefficients(results: ThesisResults) -> Iterator[Verdict]:
    found = results.coefficients
    monotone = None if found is None else found.selection.monotone
    order = " < ".join(", ".join(map(str, group)) for group in GROUPS)
    for name in ("D22", "GSF", "JC", "DC"):
        good = None if monotone is None else monotone[name]
        word = "in order" if good else "out of order"
        yield holds(
            "3.3.2, Fig. 3.5",
            f"{name} worsens in the order {order}",
            "in order",
            good,
            word,
            NO_BOX,
        )
    for name, title in (("dV", "volume difference"), ("SM", "signed mean")):
        good = None if monotone is None else not monotone[name]
        yield holds(
            "3.3.2",
            f"{title} does not tell good from bad",
            "rejected",
            good,
            "rejected" if good else "in order too",
            NO_BOX,
        )
    kept = None if found is None else "D22" in found.selection.kept
    yield holds(
        "3.3.2",
        "D22 ranks deformations 5 to 7 behind 1 to 4",
        "kept",
        kept,
        "kept" if kept else "rejected",
        NO_BOX,
    )
    rows = None if found is None else [row for row in found.cylinder if 0 < row.angle_deg < 180]
    least = None if rows is None else min(rows, key=lambda row: row.jc).angle_deg
    yield holds(
        "Fig. 3.7",
        "angle of the least JC",
        "90°",
        None if least is None else least == 90,
        f"{least:g}°" if least is not None else "",
        NO_BOX,
    )
    decays = None if rows is None else all(row.dc > row.jc for row in rows)
    yield holds("Fig. 3.7", "DC decays less than JC", "everywhere", decays, "everywhere", NO_BOX)
    identity = None if found is None else found.cylinder[0].gsf == -math.inf
    yield holds("Fig. 3.8", "GSF of identical volumes", "−∞", identity, "−∞", "")
    yield Verdict(
        "Figs. 3.5 to 3.8",
        "the values of the curves",
        "figures alone",
        "see the page",
        "cannot be",
        NO_BOX,
    )


def _quality(results: ThesisResults) -> Iterator[Verdict]:
    meshes = results.meshes
    for kind, wanted in printed.ASPECTS.items():
        row = next((r for r in meshes.aspects if r.kind == kind), None) if meshes else None
        average, worst = (row.average, row.worst) if row else (None, None)
        yield at_most(
            "Table 4.2",
            f"average aspect ratio, {kind}",
            wanted.average,
            average,
            "",
            "another mesher",
        )
        yield at_most(
            "Table 4.2", f"worst aspect ratio, {kind}", wanted.worst, worst, "", "another mesher"
        )
    for kind, count in printed.ELEMENTS.items():
        tets = _mean_tets(meshes, kind)
        per_body = None if tets is None else tets * VOLUMES[results.scale]
        why = "the adaptive mesh is as fine where tissues meet, and coarser elsewhere"
        yield equal("4.4.3", f"tetrahedra per 250 ml, {kind}", count, per_body, "", why)
    order = None
    if meshes is not None:
        by_kind = {row.kind: row.average for row in meshes.aspects}
        order = by_kind["homogeneous"] < by_kind["adaptive"]
    why = "another mesher; the averages are close to each other in the thesis, too"
    found = "yes" if order else "no"
    yield holds("4.4.3", "homogeneous meshes are more regular", "yes", order, found, why)
    yield Verdict(
        "Fig. 4.15",
        "M1 to M5 of six meshes",
        "a figure alone",
        "see the page",
        "cannot be",
        "its values are not printed",
    )


def _mean_tets(meshes: MeshResult | None, kind: str) -> float | None:
    if meshes is None:
        return None
    return fmean(row.tets for row in meshes.quality if row.kind == kind)


def _compression(results: ThesisResults) -> Iterator[Verdict]:
    meshes = results.meshes
    means: dict[tuple[str, str], MeanCompression] = {}
    if meshes is not None:
        means = {(m.view, m.law): m for m in meshes.means}
    held = "which nodes are held at the fixed plate decides it, and is not printed"
    why = held if results.scale == "full" else f"{REDUCED_BODY}; and {held}"
    for view, wanted in printed.TABLE_43.items():
        mean = means.get((view, "neo-Hookean"))
        place = "Table 4.3"
        yield at_most(
            place,
            f"centroid distance, {view}",
            wanted.centroid_mm,
            None if mean is None else mean.centroid_mm,
            "mm",
            why,
        )
        yield at_most(
            place,
            f"volume difference, {view}",
            wanted.volume_mm3,
            None if mean is None else mean.volume_mm3,
            "mm³",
            why,
        )
        if wanted.jc is not None and wanted.mhd_mm is not None:
            judged = at_most(
                place,
                f"Jaccard coefficient, {view}",
                1 - wanted.jc,
                None if mean is None else 1 - mean.jc,
                "",
                why,
            )
            shown = judged.found if mean is None else _text(mean.jc, "")
            yield replace(judged, printed=_text(wanted.jc, ""), found=shown)
            yield at_most(
                place,
                f"modified Hausdorff distance, {view}",
                wanted.mhd_mm,
                None if mean is None else mean.mhd_mm,
                "mm",
                why,
            )
    for view, wanted in printed.MOONEY_RIVLIN.items():
        mean = means.get((view, "Mooney-Rivlin"))
        why_law = f"its constants are not printed (the same shear moduli are taken); {why}"
        yield at_most(
            "4.4.4",
            f"centroid distance, Mooney-Rivlin, {view}",
            wanted.centroid_mm,
            None if mean is None else mean.centroid_mm,
            "mm",
            why_law,
        )
        yield at_most(
            "4.4.4",
            f"volume difference, Mooney-Rivlin, {view}",
            wanted.volume_mm3,
            None if mean is None else mean.volume_mm3,
            "mm³",
            why_law,
        )
    better = None
    if ("CC", "neo-Hookean") in means and ("MLO", "neo-Hookean") in means:
        better = means["MLO", "neo-Hookean"].jc > means["CC", "neo-Hookean"].jc
    yield holds("4.4.4", "MLO agrees better than CC", "yes", better, "yes" if better else "no", why)
    times: dict[str, SolverTime] = {}
    if meshes is not None:
        times = {t.mesh: t for t in meshes.times if t.view == "CC"}
    for kind, seconds in printed.SECONDS_PER_1000.items():
        time = times.get(kind)
        yield at_most(
            "Fig. 4.16",
            f"seconds per 1000 elements, CC, {kind}",
            seconds,
            None if time is None else time.mean_s,
            "s",
            "",
        )
    yield Verdict(
        "4.4.4",
        "hours of a compression (7, 2, 2, 1.45)",
        "2 to 7 h",
        "see the page",
        "cannot be",
        "they do not fit the printed seconds: 23 s × 900 are 5.75 h, not 7",
    )


def _mammogram(results: ThesisResults) -> Iterator[Verdict]:
    pairs = results.mammograms
    beyond = None if pairs is None else all(p.attenuation_rms > p.quantum_rms for p in pairs)
    yield holds(
        "Fig. 4.18",
        "the meshes differ around the compartments, noise elsewhere",
        "a picture",
        beyond,
        "beyond noise in every pair" if beyond else "within noise",
        "",
    )
    yield Verdict(
        "4.4.3",
        "geometry, spectrum, dose, pixels",
        "not printed",
        "stated on the page",
        "cannot be",
        "a tungsten tube at 28 kV behind rhodium and 60 mAs are assumed",
    )


def _search(results: ThesisResults) -> Iterator[Verdict]:
    search = results.search
    weak = (
        "the deformed shape hardly depends on it, as the thesis' own Fig. 4.22 says; an estimate "
        "of a flat valley is where the search happened to stop"
    )
    few = (
        "the reduced search has fewer candidates, larger voxels and a coarser mesh"
        if results.scale != "full"
        else ""
    )
    for target, table in printed.SEARCHES.items():
        found = [] if search is None else search.of(target)
        for column, name in enumerate(TARGETS[target]):
            mean = _mean_error(found, column)
            why = weak if name.startswith("eta") else few
            note = f"; {table.note}" if target == "X3" and name == "E_glandular_kpa" else ""
            yield at_most(
                table.name,
                f"mean relative error of {name.removesuffix('_kpa')}",
                table.error[column],
                mean,
                "%",
                why + note,
            )
        overlap = [s.jc for s in found if s.jc is not None]
        worst = min(row.jc for row in table.rows)
        good = min(overlap) >= worst if overlap else None
        yield holds(
            table.name,
            "least JC of its phantoms",
            number(worst, 3),
            good,
            number(min(overlap), 3) if overlap else "–",
            few,
        )
    hours = None
    if search is not None and search.searches:
        hours = fmean(s.cpu_s for s in search.searches) / 3600
    wanted = printed.HOURS * printed.CORES
    place, what = "4.5.6", "core hours of a search"
    if results.scale == "full" or hours is None:
        yield at_most(place, what, wanted, hours, "h", "")
    else:
        why = "a smaller problem: a coarser mesh, larger voxels, fewer candidates; run with --full"
        yield Verdict(place, what, _text(wanted, "h"), _text(hours, "h"), "cannot be", why)


def _mean_error(found: list[FoundSearch], column: int) -> float | None:
    return fmean(s.constants[column].error for s in found) if found else None


def _sensitivity(results: ThesisResults) -> Iterator[Verdict]:
    varied = results.sensitivity
    one = next((v for v in varied if v.constant == "eta_glandular_kpa"), None) if varied else None
    lowest, most = (one.lowest_jc, one.most_mhd_voxels) if one else (None, None)
    why = "the body, its density and its voxels decide it" if results.scale != "full" else ""
    yield holds(
        "Fig. 4.22",
        "JC over all of eta_glandular",
        f"> {printed.LOWEST_JC}",
        None if lowest is None else lowest > printed.LOWEST_JC,
        f"≥ {number(lowest, 3)}",
        why,
    )
    yield holds(
        "Fig. 4.22",
        "MHD over all of eta_glandular, voxels",
        f"< {printed.MOST_MHD_VOXELS:g}",
        None if most is None else most < printed.MOST_MHD_VOXELS,
        f"≤ {number(most, 3)}",
        why,
    )


def _beyond(results: ThesisResults) -> Iterator[Verdict]:
    """What no run can settle."""
    yield Verdict(
        "4.4.3",
        "phantoms of 250 ml and 170 × 100 × 50 mm",
        "both",
        "250 ml",
        "cannot be",
        "a body of these dimensions has 445 ml; 250 ml are 170 × 75 × 37.5 mm",
    )
    yield Verdict(
        "4.4.3",
        "edges of 1 mm and 425 000 tetrahedra",
        "both",
        "425 000",
        "cannot be",
        "edges of 1 mm would need 2.1 million in 250 ml; the number is kept",
    )
    yield Verdict(
        "Table 4.6",
        "row of phantom 2 and its statistics",
        "both",
        "the statistics",
        "cannot be",
        printed.SEARCHES["X3"].note,
    )
    yield Verdict(
        "4.5.6",
        "seeds and operators of the genetic algorithm",
        "not printed",
        "those of MATLAB's ga",
        "cannot be",
        "so no estimate of a single phantom can come out the same",
    )
