"""The page of a diagnosis: one file, which needs no other."""

import json
from collections.abc import Iterator
from typing import Any

from service.diagnosis.advice import undecided, worth
from service.diagnosis.run import Found
from service.diagnosis.words import (
    NOT_EFFECTS,
    likely,
    millimetres,
    sentence,
    spoken,
    together,
)
from service.report import diagnosis_experiment as experiment
from service.report import diagnosis_tables as tables
from service.report import diagnosis_where as where
from service.report.diagnosis_figures import Cause, Evidence, Judged, evidence, gaps, probabilities
from service.report.diagnosis_slices import overlay_legend
from service.report.pictures import Picture, picture
from service.report.template import filled
from service.versions import palpate_version
from storage.plain import to_plain
from workers.effects.catalogue import NOT_SIMULATED

Json = dict[str, Any]
# Causes in the chart besides those of the 90 % set.
CAUSES = 8
# A family is worth a sentence if it is more probable than not.
LIKELY = 0.5


def render(found: Found) -> str:
    """The page as text; an equal diagnosis gives the same bytes."""
    return filled("diagnosis.html.j2", context(found))


def context(found: Found) -> Json:
    """All values of the template."""
    told = found.summary
    accused = together(told["primary"]) if told["primary"] else ""
    return {
        "name": told["case"],
        "verdict": sentence(told),
        "lead": _lead(told),
        "tiles": _tiles(told),
        "warnings": list(_warnings(told)),
        "accused": accused,
        "gap_picture": _gap_picture(told, accused),
        "evidence_picture": _evidence_picture(told),
        "about_evidence": _about_evidence(told),
        "cause_picture": _cause_picture(told),
        "about_causes": _about_causes(told),
        "constants": tables.constants(told["constants"]),
        "effects": tables.effects(told["effects"], told["absorbed"]),
        "advice": _advice(told),
        "further": [(o["name"], worth(o)) for o in told.get("next_acquisitions", [])],
        "markers": experiment.markers(told),
        "states": experiment.states(told),
        "hidden": experiment.hidden(told),
        "expected": experiment.expected(told),
        "maps": [] if "markers" in told else list(where.maps(found.maps, found.scans, accused)),
        "averaged": where.on_surfaces(found.maps),
        "sections": list(where.sections(found.maps, found.scans, accused)),
        "section_legend": overlay_legend(),
        "cause_map": where.cause_picture(found.maps, told.get("cause_map"), accused),
        "overlap": tables.overlap(told.get("overlap", [])),
        "percentiles": any("p95_mm" in region for region in told["where"]),
        "regions": tables.regions(told["where"]),
        "not_simulated": NOT_SIMULATED,
        "json": json.dumps(to_plain(told), indent=2, ensure_ascii=False),
        "closing": f"Made by Palpate {palpate_version()}.",
    }


def _lead(told: Json) -> str:
    noise = told["gap_mm"]["noise_floor"]
    if "markers" in told:
        return (
            f"Model and measurement were compared at {told['points'] // 3} points in every loaded "
            "state, after the constants had been fitted. The measurement alone makes one component "
            f"err by {noise:.2f} mm; a gap is what differs beyond that. Intervals hold with 90 %."
        )
    return (
        f"Model and scans were compared at {told['points']} points on the outline and on the "
        "boundary of the glandular tissue, in every loaded scan, after the constants had been "
        f"fitted. The segmentation alone makes a point err by {noise:.2f} mm; a gap is what "
        "differs beyond that. Intervals hold with 90 %."
    )


def _advice(told: Json) -> str:
    """What to do where the data do not decide."""
    if not undecided(told) or "markers" in told or told.get("next_acquisitions"):
        return ""
    return (
        "These scans do not decide. “palpate plan”, given the same folder, says which further "
        "measurement would tell the causes apart best: another load, another direction, or the "
        "same scans segmented once more."
    )


def _tiles(told: Json) -> list[tuple[str, str, str]]:
    gap = told["gap_mm"]
    tiles = [("Gap, nominal model", f"{gap['before']['gap_mm']:.2f}", "mm")]
    if gap["after"] is not None:
        tiles.append(("Gap with the effect", f"{gap['after']['gap_mm']:.2f}", "mm"))
    if gap.get("held_out_after") is not None:
        tiles.append(("On unseen scans", f"{gap['held_out_after']['gap_mm']:.2f}", "mm"))
    tiles.append(("Noise of a point", f"{gap['noise_floor']:.2f}", "mm"))
    tiles.append(
        ("Evidence for a gap", f"{told['alarm']:.1f}", f"alarm at {told['threshold']:.1f}")
    )
    return tiles


def _warnings(told: Json) -> Iterator[str]:
    loose = [r["effects"] for r in told["refits"] if not r["converged"]]
    if loose:
        names = "; ".join(together(e) for e in loose)
        yield f"The refit of {names} did not converge: its evidence is a lower bound."
    share = told["gap_mm"].get("held_out_share")
    if share is not None and share["low"] < 0:
        yield (
            "On scans that it was not fitted to, the effect may leave as large a gap as the "
            "nominal model: take the cause for a lead, not for a finding."
        )


def _gap_picture(told: Json, accused: str) -> Picture:
    gap = told["gap_mm"]
    rows = [Judged("all scans, fitted to them", gap["before"], gap["after"])]
    for name, held in gap.get("held_out_each", {}).items():
        rows.append(Judged(f"{name}, not fitted to it", held["before"], held["after"]))
    said = "; ".join(
        f"{r.title}: {millimetres(r.before)} with the nominal model"
        + (f", {millimetres(r.after)} with {accused}" if r.after is not None else "")
        for r in rows
    )
    return picture(gaps(rows, gap["noise_floor"], accused), f"Gap. {said}.")


def _evidence_picture(told: Json) -> Picture | None:
    ranked = sorted(told["refits"], key=lambda r: -r["log_evidence_gain"])
    rows = [Evidence(together(r["effects"]), r["log_evidence_gain"], r["field_gain"])
            for r in ranked]  # fmt: skip
    if not rows:
        return None
    said = "; ".join(f"{r.title}: {r.gain:.1f}" for r in rows)
    return picture(evidence(rows, told["threshold"]), f"Log evidence gained. {said}.")


def _about_evidence(told: Json) -> str:
    alone = "Each refit frees the constants and the effect together and simulates anew."
    share = told["explained_share"]
    if share is None or not told["primary"]:
        return alone
    return (
        f"{alone} Of what the best effect and a smooth misfit on top of it gain, the effect "
        f"itself makes {100 * share:.0f} %."
    )


def _cause_picture(told: Json) -> Picture:
    credible = set(told["set90"])
    chance = {
        "no-gap": told["no_gap_probability"],
        "none-of-these": told["none_of_these_probability"],
    } | {e["name"]: e["probability"] for e in told["effects"] if e["name"] not in told["absorbed"]}
    ranked = sorted(chance, key=lambda name: (-chance[name], name))
    shown = [n for n in ranked if n in credible] + [n for n in ranked if n not in credible]
    rows = [Cause(spoken(n), chance[n], n in credible) for n in shown[: max(CAUSES, len(credible))]]
    said = "; ".join(f"{row.title} {likely(row.probability)}" for row in rows)
    return picture(probabilities(rows), f"Probabilities. {said}.")


def _about_causes(told: Json) -> str:
    named = [name for name in told["set90"] if name not in NOT_EFFECTS]
    if len(told["primary"]) > 1 and told["verdict"] == "effect":
        held = f"{together(told['primary'])} together explain what no single effect does"
    elif len(told["set90"]) == 1:
        held = f"{spoken(told['set90'][0])} alone holds 90 % of the probability"
    else:
        held = f"90 % of the probability is held by {together(told['set90'])}"
    sentences = [f"{held[0].upper()}{held[1:]}."]
    if len(named) > 1 and max(told["families"].values()) > LIKELY:
        families = sorted(told["families"].items(), key=lambda item: -item[1])
        sentences.append(
            f"The most probable family is {families[0][0]} ({likely(families[0][1])})."
        )
    return " ".join(sentences)
