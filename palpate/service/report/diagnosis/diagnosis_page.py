"""The page of a diagnosis, in one self-contained file, and its record for programs."""

import json
from collections.abc import Iterator
from pathlib import Path

from palpate.service.diagnosis.diagnosed_constants import summary_json
from palpate.service.diagnosis.diagnosis_run import FinishedDiagnosis
from palpate.service.diagnosis.diagnosis_words import answers, is_undecided, noise, power, together
from palpate.service.diagnosis.magnitude_words import length, millimetres
from palpate.service.diagnosis.plan_words import acquisition_worth
from palpate.service.diagnosis.reliability import reliability
from palpate.service.installed_packages import palpate_version, versions
from palpate.service.number_formatting import listed, number
from palpate.service.report.diagnosis import diagnosis_tables as experiment
from palpate.service.report.diagnosis import diagnosis_tables as tables
from palpate.service.report.diagnosis import gap_pictures as where
from palpate.service.report.diagnosis.diagnosis_charts import Evidence, evidence, gap_rows, gaps
from palpate.service.report.diagnosis.diagnosis_consequence import next_step, quotable
from palpate.service.report.diagnosis.diagnosis_viewers import body_data, slice_data
from palpate.service.report.diagnosis.gap_pictures import overlay_legend
from palpate.service.report.diagnosis.specimen_pictures import arrow_pictures, specimen_pictures
from palpate.service.report.page.page_elements import (
    DIAGNOSIS_TERMS,
    OVERLAP_TERMS,
    Picture,
    TableRow,
    chart,
    filled,
)
from palpate.service.report.study.page_provenance import Origin, diagnosis_provenance
from palpate.storage.backends.atomic_files import explained, write_file
from palpate.storage.json_digests import to_plain
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.organs.organ_plugins import DEFAULT, catalogue_of


def render_diagnosis(diagnosis: FinishedDiagnosis, origin: Origin | None = None) -> str:
    """Return the page as text; equal diagnoses give the same bytes.

    Parameters
    ----------
    diagnosis : FinishedDiagnosis
    origin : Origin, optional
        Provenance of the diagnosis, if known.
    """
    values = diagnosis_context(diagnosis, origin or Origin())
    return filled("diagnosis.html.j2", values | {"contents": _contents(values)})


def _contents(values: dict[str, object]) -> list[tuple[str, str]]:
    """Return the titles of the page's sections by their anchors."""
    marked = bool(values["markers"])
    there = {
        "markers": marked,
        "hidden": bool(values["hidden"]),
        "expected": marked and bool(values["expected"]),
        "maps": not marked,
        "cause-map": bool(values["cause_map"]),
    }
    sections = (
        ("gap", "Size of the gap"),
        ("causes", "Possible causes"),
        ("constants", "The constants"),
        ("markers", "Where they differ"),
        ("hidden", "What cannot be distinguished"),
        ("expected", "Other states"),
        ("maps", "Where they differ"),
        ("cause-map", "Where the cause may be"),
        ("effects", "All effects"),
        ("unlisted", "Outside the catalogue"),
        ("provenance", "How this was made"),
        ("glossary", "Glossary"),
        ("details", "Details"),
    )
    return [(name, title) for name, title in sections if there.get(name, True)]


def diagnosis_context(diagnosis: FinishedDiagnosis, origin: Origin) -> dict[str, object]:
    """Return the values of the template except the contents."""
    summary, maps, scans = diagnosis.summary, diagnosis.maps, diagnosis.scans
    named = together(summary.primary) if summary.primary else ""
    return {
        "name": summary.case,
        "caveats": summary.caveats or (),
        "answers": _answers(summary),
        "lead": _lead(summary),
        "loaded": _loaded(summary),
        "quote": quotable(summary),
        "next_step": next_step(summary, origin.made.command),
        "provenance": diagnosis_provenance(origin.made, versions()),
        "glossary": DIAGNOSIS_TERMS + (OVERLAP_TERMS if summary.overlap else ()),
        "body_data": None if summary.markers else body_data(maps, scans, named, origin.loads),
        "slice_data": slice_data(maps, scans, named, origin.loads),
        "tiles": _tiles(summary),
        "warnings": list(_warnings(summary)),
        "named": named,
        "gap_picture": _gap_picture(summary, named),
        "evidence_picture": _evidence_picture(summary),
        "about_evidence": _about_evidence(summary),
        "constants": tables.constant_table(summary),
        "effects": tables.effect_table(summary),
        "power": power(summary) if summary.verdict == "no-gap" else "",
        "advice": _advice(summary),
        "further": [(o.name, acquisition_worth(o)) for o in summary.next_acquisitions or ()],
        "markers": experiment.marker_table(summary),
        "arrows": list(arrow_pictures(maps, scans, named, summary.gap_mm.noise_floor))
        if summary.markers is not None
        else [],
        "specimen": list(specimen_pictures(maps, summary, named)),
        "states": experiment.state_table(summary),
        "forces": experiment.force_table(summary),
        "hidden": experiment.hidden_table(summary),
        "expected": experiment.expected_table(summary),
        "agreements": experiment.agreements(summary),
        "expected_forces": experiment.expected_force_table(summary),
        "maps": []
        if summary.markers is not None
        else list(where.gap_map_pictures(maps, scans, named, summary.surfaces)),
        "averaged": where.has_surface_gaps(maps),
        "sections": list(where.overlay_pictures(maps, scans, named)),
        "section_legend": overlay_legend(),
        "cause_map": where.cause_map_picture(maps, summary.cause_map, named),
        "overlap": tables.overlap_table(summary.overlap or ()),
        "percentiles": any(region.p95_mm is not None for region in summary.where),
        "regions": tables.region_table(summary.where),
        "not_simulated": _not_simulated(summary),
        "json": json.dumps(to_plain(summary_json(summary)), indent=2, ensure_ascii=False),
        "closing": f"Made by Palpate {palpate_version()}.",
    }


def _answers(summary: Summary) -> list[tuple[str, str]]:
    """Return the verdict as pairs of a question and its answer."""
    said = answers(summary)
    where = " ".join([*summary.doubts, said.where])
    pairs = zip(("Where", "Which", "How far"), (where, said.which, said.how_far), strict=True)
    return [(asked, text.replace(" mm", "\u00a0mm")) for asked, text in pairs if text]


def _not_simulated(summary: Summary) -> tuple[tuple[str, str], ...]:
    """Return the possible causes without an effect; for other organs they are in the summary."""
    if summary.not_simulated is None:
        return catalogue_of(DEFAULT).not_simulated
    return summary.not_simulated


def _loaded(summary: Summary) -> str:
    return "scans" if summary.markers is None else "states"


def _lead(summary: Summary) -> str:
    noise = length(summary.gap_mm.noise_floor)
    if summary.markers is not None:
        points = len(summary.markers[0].points)
        return (
            f"Model and measurement were compared at {points} points in every loaded "
            "state, after the constants had been fitted. The measurement error of one component is "
            f"{noise} mm; a gap is a difference beyond that. Intervals are 90\u00a0% intervals."
        )
    return (
        f"Model and scans were compared at {summary.points} points on {summary.compared}, "
        f"in every loaded scan, after the constants had been fitted. {_left_out(summary)}The "
        f"segmentation error of a point is {noise} mm; a gap is a difference beyond that. "
        "Intervals are 90\u00a0% intervals."
    )


def _left_out(summary: Summary) -> str:
    if not summary.left_out:
        return ""
    return (
        f"Of {summary.points + summary.left_out} points, {summary.left_out} were left out, "
        f"because at least one scan does not show them clearly: tissue missing from one "
        f"segmentation, or strands that are too thin. "
    )


def _advice(summary: Summary) -> str:
    """Return advice if the data do not decide between causes."""
    if not is_undecided(summary) or summary.markers is not None or summary.next_acquisitions:
        return ""
    return (
        "These scans cannot decide between the causes. Run “palpate plan” on the same folder to "
        "find the further measurement that would distinguish them best: another load, another "
        "direction, or a second segmentation of the same scans."
    )


def _tiles(summary: Summary) -> list[tuple[str, str, str]]:
    gap = summary.gap_mm
    tiles = [("Gap, nominal model", length(gap.before.gap_mm, gap.before.high_mm), "mm")]
    if gap.after is not None:
        tiles.append(("Gap with the effect", length(gap.after.gap_mm, gap.after.high_mm), "mm"))
    if gap.held_out_after is not None and gap.held_out_before is not None:
        held = gap.held_out_before, gap.held_out_after
        change = " → ".join(length(estimate.gap_mm, estimate.high_mm) for estimate in held)
        tiles.append(("On unseen scans", change, "mm"))
    tiles.append(("Noise of a point", length(gap.noise_floor), "mm"))
    return tiles


def _warnings(summary: Summary) -> Iterator[str]:
    yield from summary.data_notes
    if wrong := noise(summary):
        yield wrong
    loose = [r.effects for r in summary.refits if not r.converged]
    if loose:
        names = "; ".join(together(e) for e in loose)
        yield f"The refit of {names} did not converge: its evidence is a lower bound."
    others = f"other {_loaded(summary)}"
    if summary.gap_mm.checked_on == "same scan":
        yield (
            f"How much {together(summary.primary)} reduces the gap was not checked on {others}. A "
            "fit reduces the gap to the data that it is made to, whatever the cause: treat this "
            "cause as a lead, not a finding."
        )
    elif summary.gap_mm.not_judged:
        yield (
            f"The gap of {listed(summary.gap_mm.not_judged)} with the effect is not checked by a "
            "fit to the others, because they do not determine its magnitude."
        )
    share = summary.gap_mm.held_out_share
    if share is not None and share.low < 0:
        yield (
            "On scans left out of the fit, the gap with the effect may be as large as with the "
            "nominal model: treat this cause as a lead, not a finding."
        )


def _gap_picture(summary: Summary, named: str) -> Picture:
    gap, rows = summary.gap_mm, gap_rows(summary)
    said = "; ".join(
        f"{r.title}: {millimetres(r.before)} with the nominal model"
        + (f", {millimetres(r.after)} with {named}" if r.after is not None else "")
        for r in rows
    )
    numbers: list[TableRow] = [("judged on", "model", "gap_mm", "low_mm", "high_mm")]
    for row in rows:
        for model, estimate in (("nominal", row.before), (f"with {named}", row.after)):
            if estimate is not None:
                numbers.append(
                    (row.title, model, estimate.gap_mm, estimate.low_mm, estimate.high_mm)
                )
    return chart(lambda w: gaps(rows, gap.noise_floor, named, w), f"Gap. {said}.", rows=numbers)


def _evidence_picture(summary: Summary) -> Picture | None:
    ranked = sorted(summary.refits, key=lambda r: -r.log_evidence_gain)
    rows = [Evidence(together(r.effects), r.log_evidence_gain, r.field_gain) for r in ranked]
    if not rows:
        return None
    said = "; ".join(f"{r.title}: {r.gain:.1f}" for r in rows)
    _, first = _thresholds(summary)
    return chart(
        lambda w: evidence(rows, first, w),
        f"Log evidence gained. {said}.",
        rows=[("effect", "log_evidence_gain"), *((r.title, r.gain) for r in rows)],
    )


def _thresholds(summary: Summary) -> tuple[float, float]:
    """Return the gains that name a further cause and the first one, in nats."""
    settings = SETTINGS.selection
    if summary.noise is None:  # it was known, not learnt
        return settings.further_measured, settings.first_measured
    return settings.further, settings.first


def _about_evidence(summary: Summary) -> str:
    """Return how causes are named, and what the fits left."""
    further, first = _thresholds(summary)
    said = (
        "Each promising effect was fitted together with the constants, in new simulations. The "
        "bars show its gain: how much better the data are then predicted (log evidence, in nats), "
        "less a price for each parameter. An effect is named as the cause if it gains more than "
        f"{first:g} nats over the nominal model, a further one if it adds more than "
        f"{further:g}. Effects within {SETTINGS.selection.tie:g} nats of the best cannot be told "
        "apart."
    )
    if not summary.refits:
        said = "According to the linear model, no effect would gain enough to be fitted."
    if summary.primary and summary.noise is not None:
        said += f" {reliability(summary.gain)}".rstrip()
    if summary.something_else:
        beside = " beside the named effects" if summary.primary else ""
        said += (
            f" A smooth displacement that no effect explains would gain "
            f"{number(summary.left_gain, 3)} nats{beside}: something else acts."
        )
    return said


def write_diagnosis(
    diagnosis: FinishedDiagnosis, folder: Path, origin: Origin | None = None
) -> Path:
    """Write ``diagnosis.json`` and ``diagnosis.html``; return the path of the page.

    Parameters
    ----------
    diagnosis : FinishedDiagnosis
    folder : Path
        Created if missing.
    origin : Origin, optional
        Provenance of the diagnosis, if known.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    plain = to_plain(summary_json(diagnosis.summary))
    text = json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)
    write_file(folder / "diagnosis.json", text.encode() + b"\n")
    page = folder / "diagnosis.html"
    write_file(page, render_diagnosis(diagnosis, origin).encode())
    return page
