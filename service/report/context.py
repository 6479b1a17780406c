"""What the template prints: sentences, tables and pictures."""

import json
from typing import Any

import yaml
from markupsafe import Markup

from service.report import tables
from service.report.evidence import Evidence
from service.report.panels import difference_legend, present
from service.report.pictures import (
    best_tenth,
    convergence_picture,
    found_parameters,
    points_of,
    range_picture,
    scatter_pictures,
    section_pictures,
    stage_picture,
)
from service.report.words import (
    at_edge,
    count,
    duration,
    joined,
    number,
    symbol,
    verdict,
)
from storage.plain import to_plain


def context(evidence: Evidence) -> dict[str, Any]:
    """All values of the template."""
    return {
        **_head(evidence),
        **_parameters(evidence),
        **_bodies(evidence),
        **_search(evidence),
        **_simulation(evidence),
        **_time(evidence),
        **_details(evidence),
    }


def _head(evidence: Evidence) -> dict[str, Any]:
    told, score = evidence.results, _score(evidence)
    phrases = verdict(told["estimates"])
    sentence = _sentence(phrases) if phrases else "Nothing found yet."
    tiles: list[tuple[str, str, str]] = []
    if score:
        tiles = [
            ("Jaccard coefficient", number(score["jc"]), ""),
            ("Modified Hausdorff", number(score["mhd_mm"], 3), "mm"),
            ("GSF", number(score["gsf"]), ""),
        ]
    tiles.append(("Evaluations", count(len(evidence.endings)), ""))
    tiles.append(("Wall time", duration(told["seconds"]), ""))
    return {
        "name": evidence.spec["name"],
        "verdict": sentence,
        "lead": _lead(evidence),
        "tiles": tiles,
        "warnings": _warnings(evidence),
    }


def _sentence(phrases: list[Markup]) -> Markup:
    """Phrases that hold commas themselves, none of them broken over two lines."""
    ends = [";"] * (len(phrases) - 1) + ["."]
    return Markup("\n").join(
        Markup('<span class="found">{}{}</span>').format(phrase, end)
        for phrase, end in zip(phrases, ends, strict=True)
    )


def _lead(evidence: Evidence) -> str:
    score, stopped = _score(evidence), evidence.results["stopped"]
    sentences = []
    if score:
        tissues = " and ".join(evidence.spec["score"]["labels"])
        what = "surfaces" if evidence.spec["score"]["surface"] == "boundary" else "voxels"
        sentences.append(
            f"With the best constants, {tissues} tissue of simulation and target share "
            f"{100 * score['jc']:.1f} % of the volume that they fill together, and their {what} "
            f"lie {number(score['mhd_mm'], 3)} mm ({number(score['mhd_voxels'], 2)} voxels) apart "
            "on average."
        )
    so_far = ": all numbers are those of the best so far" if score else ""
    if stopped:
        sentences.append(f"The search has ended: {stopped}.")
    elif evidence.results["state"] == "running":
        sentences.append(f"The search is still running{so_far}.")
    else:
        sentences.append(f"The search was interrupted{so_far}. Running it again continues it.")
    return " ".join(sentences)


def _score(evidence: Evidence) -> dict[str, float] | None:
    """The best candidate's score; None if there is no best candidate."""
    return dict(evidence.results["score"]) if evidence.best is not None else None


def _warnings(evidence: Evidence) -> list[Markup]:
    warnings = []
    edges = [
        symbol(name, found["unit"] or "")
        for name, found in evidence.results["estimates"].items()
        if found["estimate"] is not None and at_edge(found["estimate"], found["bounds"])
    ]
    if edges:
        warnings.append(
            Markup("{} {} at the edge of the searched interval: the true value may lie beyond it.")
            .format(joined(edges), "lies" if len(edges) == 1 else "lie")
        )  # fmt: skip
    if evidence.best is not None and (evidence.best.outcome or {}).get("squeezed"):
        warnings.append(Markup("The best simulation squeezes some element to less than a fifth of "
                               "its volume: its numbers are not to be trusted."))  # fmt: skip
    return warnings


def _parameters(evidence: Evidence) -> dict[str, Any]:
    estimates = evidence.results["estimates"]
    found = found_parameters(estimates)
    known = any(f["target"] is not None for f in estimates.values())
    points = points_of(evidence.endings)
    about = (
        "The target was simulated, so its constants are known and the search did not see them."
        if known
        else "The constants of the target are not known: it comes from an image."
    )
    return {
        "about_parameters": about,
        "ranges": range_picture(found, best_tenth(points)) if evidence.best else None,
        "parameters": tables.parameters(estimates),
        "scatters": scatter_pictures(found, points),
        "targets_known": known,
    }


def _bodies(evidence: Evidence) -> dict[str, Any]:
    bodies, score = evidence.bodies, evidence.spec["score"]
    surface, results = score["surface"], evidence.results
    after = results["per_label"] or bodies.scores(bodies.best, surface)
    before = results["per_label_before"] or bodies.scores(bodies.reference, surface)
    compared = " and ".join(score["labels"])
    return {
        "sections": section_pictures(bodies, score["labels"]),
        "about_sections": f"Sections through the middle of the {compared} tissue. The plates press "
        "along y. Target and best candidate are cut in the same planes.",
        "tissues": present(bodies),
        "differences": difference_legend(),
        "missing": bodies.missing,
        "similarities": tables.similarities(before, after, score["labels"]),
        "about_similarity": "From the undeformed body, where the fit begins, to the best "
        f"candidate. The search compared the shaded row{'s' if len(score['labels']) > 1 else ''}.",
    }


def _search(evidence: Evidence) -> dict[str, Any]:
    generations = [g for g in evidence.results["generations"] if g["complete"]]
    search = evidence.spec["search"]
    rows = [
        (index + 1, number(g["best"], 5), number(g["mean"], 5))
        for index, g in enumerate(generations)
    ]
    units = {f["gene"]: f["unit"] or "" for f in evidence.results["estimates"].values()}
    failed = tables.failures(evidence.endings, units)
    share = f"{len(failed)} of {count(len(evidence.endings))} evaluations have no score"
    about_failures = (
        f"{share}; the search ranks them last."
        if failed
        else f"None: every one of {count(len(evidence.endings))} evaluations has a score."
        if evidence.endings
        else "None: nothing was evaluated yet."
    )
    return {
        "convergence": convergence_picture(points_of(evidence.endings), generations),
        "about_search": f"{_plural(len(generations), 'complete generation')} of "
        f"{search['population']} candidates; "
        f"the best {search['elite']} of each live on unchanged and are not evaluated again.",
        "generations": rows,
        "failures": failed,
        "about_failures": about_failures,
    }


def _simulation(evidence: Evidence) -> dict[str, Any]:
    best = evidence.best
    if best is None:
        return {"outcome": [], "about_outcome": ""}
    return {
        "outcome": tables.outcome(best.outcome or {}),
        "about_outcome": f"Candidate {best.candidate} of generation {best.generation + 1}.",
    }


def _time(evidence: Evidence) -> dict[str, Any]:
    told = evidence.results
    computed = sum(not r.reused for r in evidence.endings)
    spent, wall = {name: s["total"] for name, s in told["stages"].items()}, told["seconds"]
    tally = dict(told["evaluations"])
    reused = tally.pop("reused")
    work = [(f"Evaluations {status}", count(n)) for status, n in tally.items()]
    work.append(("Of these taken from the store", count(reused)))
    if computed and wall:
        work.append(("Throughput", f"{number(60 * computed / wall, 3)} evaluations per min"))
    if evidence.session is not None:
        work.append(("Evaluations at once", count(evidence.session.workers)))
    return {
        "about_time": f"{duration(wall)} of wall time, preparation included; the evaluations took "
        f"{duration(sum(spent.values()))}, added up over all workers."
        if wall
        else "No run has noted its time yet.",
        "stages": tables.stages(told["stages"]),
        "stage_bar": stage_picture(spent),
        "work": work,
    }


def _details(evidence: Evidence) -> dict[str, Any]:
    versions = dict(evidence.results["versions"])
    return {
        "case": tables.case(evidence.results["facts"]),
        "configuration": yaml.safe_dump(
            to_plain(evidence.spec), sort_keys=False, allow_unicode=True
        ),
        "versions": sorted(versions.items()),
        "json": json.dumps(to_plain(evidence.results), indent=2, ensure_ascii=False),
        "closing": f"Made by Palpate {versions.get('palpate', '')}.".replace(" .", "."),
    }


def _plural(n: int, noun: str) -> str:
    return f"{count(n)} {noun}" if n == 1 else f"{count(n)} {noun}s"
