"""The page of a study, in one file: sentences, tables and pictures of its template."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from palpate.service.number_formatting import (
    beside,
    count,
    duration,
    joined,
    number,
    signed_error,
    small_percent,
    symbol,
)
from palpate.service.report.page.page_elements import STUDY_TERMS, Json, filled, picture, script
from palpate.service.report.study import study_tables
from palpate.service.report.study.page_provenance import study_provenance
from palpate.service.report.study.study_charts import posterior_picture
from palpate.service.report.study.study_consequence import about_intervals, next_step, quotable
from palpate.service.report.study.study_data import StudyData, read_study_data
from palpate.service.report.study.study_pictures import (
    best_tenth,
    body_data,
    convergence_picture,
    evaluated_points,
    evaluation_data,
    range_picture,
    scatter_pictures,
    searched_parameters,
    section_pictures,
    slice_data,
    stage_picture,
)
from palpate.service.report.study.study_sections import difference_legend, tissue_legend
from palpate.service.results.intervals import Direction
from palpate.service.results.result_records import ParameterEstimate, with_intervals
from palpate.service.results.results_as_json import study_json
from palpate.service.study.study_progress import generations_text
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.json_digests import to_plain
from palpate.workers.input_files import dump_yaml

# Reload interval of the page of a running search, in seconds.
REFRESH_S = 30


def study_context(data: StudyData) -> dict[str, Any]:
    """Return the values of the template."""
    values = {
        **_head(data),
        **_parameters(data),
        **_bodies(data),
        **_findings(data),
        **_search(data),
        **_simulation(data),
        **_time(data),
        **_details(data),
    }
    return values | {"contents": _contents(values)}


def _contents(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the titles of the page's sections by their anchors."""
    there = {
        "body": values["body_data"] is not None or values["quick"],
        "identifiability": bool(values["scatters"]),
    }
    sections = (
        ("parameters", "Estimates"),
        ("sections", "Target and best candidate"),
        ("body", "In three dimensions"),
        ("similarity", "Similarity by tissue"),
        ("convergence", "Progress of the search"),
        ("identifiability", "How well it is determined"),
        ("simulation", "The best simulation"),
        ("failures", "Failures"),
        ("time", "Time"),
        ("provenance", "How this was made"),
        ("glossary", "Glossary"),
        ("details", "Details"),
    )
    return [(name, title) for name, title in sections if there.get(name, True)]


def _head(data: StudyData) -> dict[str, Any]:
    results, score = data.results, data.results.best_score
    phrases = _verdict(results.estimates)
    tiles: list[tuple[str, str, str]] = []
    if score:
        tiles = [
            ("Jaccard coefficient", f"{score['jc']:.3f}", ""),
            ("Modified Hausdorff", number(score["mhd_mm"], 3), "mm"),
            ("GSF", number(score["gsf"]), ""),
        ]
        objective = results.spec.objective
        if objective.measure is not None:
            own = number(score[objective.name])
            tiles.insert(0, (objective.label, own, objective.unit))
    tiles.append(("Evaluations", count(len(data.endings)), ""))
    tiles.append(("Wall time", duration(results.wall_s), ""))
    return {
        "name": results.name,
        "caveats": results.caveats,
        "verdict": _sentence(phrases) if phrases else "No estimates yet.",
        "lead": _lead(data),
        "quote": quotable(results),
        "next_step": next_step(results, results.target_kind),
        "tiles": tiles,
        "warnings": _warnings(data),
        "refresh_s": REFRESH_S if results.state == "running" else 0,
    }


def _verdict(estimates: Mapping[str, ParameterEstimate]) -> list[Markup]:
    """Return a phrase for each estimated parameter."""
    phrases = []
    for name, parameter in estimates.items():
        if parameter.estimate is None:
            continue
        value = f"{beside(parameter.estimate, parameter.target)} {parameter.unit}".rstrip()
        value = parameter.text if parameter.one_sided else value
        phrase = symbol(name, parameter.unit) + Markup(" <b>{}</b>").format(value)
        error = signed_error(parameter.estimate, parameter.target)
        if error is not None:
            off = small_percent(error)
            phrase += Markup(', <span class="off">{} from the target</span>').format(off)
        phrases.append(phrase)
    return phrases


def _sentence(phrases: list[Markup]) -> Markup:
    """Join phrases that contain commas, without line breaks inside any."""
    ends = [";"] * (len(phrases) - 1) + ["."]
    return Markup("\n").join(
        Markup('<span class="found">{}{}</span>').format(phrase, end)
        for phrase, end in zip(phrases, ends, strict=True)
    )


def _lead(data: StudyData) -> str:
    results, score = data.results, data.results.best_score
    sentences = []
    if score:
        compared = results.spec.score
        space, what = compared.extent
        sentences.append(
            f"With the best constants, {compared.compared} of simulation and target share "
            f"{100 * score['jc']:.1f} % of the {space} that they fill together, and their {what} "
            f"are {number(score['mhd_mm'], 3)} mm ({number(score['mhd_voxels'], 2)} voxels) apart "
            "on average."
        )
    so_far = ": all numbers refer to the best candidate so far" if score else ""
    if results.stop_reason:
        sentences.append(f"The search has ended: {results.stop_reason}.")
    elif results.state == "running":
        sentences.append(f"The search is still running{so_far}.")
    else:
        sentences.append(f"The search was interrupted{so_far}. Running it again continues it.")
    if results.best_note:
        sentences.append(results.best_note)
    return " ".join(sentences)


def _warnings(data: StudyData) -> list[Markup]:
    warnings = []
    edges = [symbol(name, e.unit) for name, e in data.results.estimates.items() if e.at_bound]
    if edges:
        text = "{} {} at the edge of the searched interval: the true value may be outside."
        verb = "is" if len(edges) == 1 else "are"
        warnings.append(Markup(text).format(joined(edges), verb))
    if data.results.squeezed_note:
        warnings.append(Markup(data.results.squeezed_note))
    return warnings


def _parameters(data: StudyData) -> dict[str, Any]:
    estimates = data.results.estimates
    parameters = searched_parameters(estimates, data.results.identification)
    known = any(e.target is not None for e in estimates.values())
    points = evaluated_points(data.endings)
    axis = data.results.spec.objective.axis
    about = (
        "The target was simulated, so its constants are known; the search did not use them."
        if known
        else "The constants of the target are unknown, because it comes from an image."
    )
    return {
        "about_parameters": about,
        "about_intervals": about_intervals(data.results.identification),
        "posterior": None if data.quick else posterior_picture(data.results),
        "directions": [d.words for d in _directions(data)],
        "ranges": range_picture(parameters, best_tenth(points)) if data.results.best else None,
        "parameters": study_tables.parameter_table(estimates, data.results.identification),
        "scatters": scatter_pictures(parameters, points, axis),
        "targets_known": known,
    }


def _directions(data: StudyData) -> tuple[Direction, ...]:
    known = data.results.identification
    return () if known is None else known.directions


def _bodies(data: StudyData) -> dict[str, Any]:
    bodies, labels = data.bodies, data.results.spec.score.parts
    after = data.results.best_scores or bodies.scores_after
    before = data.results.undeformed_scores or bodies.scores_before
    compared = data.results.spec.score.compared
    case = data.results.spec.case
    return {
        "sections": section_pictures(bodies, labels, case),
        "slice_data": _viewer("slices", None if data.quick else slice_data(bodies, labels, case)),
        "body_data": _viewer("body", None if data.quick else body_data(bodies, case)),
        "quick": data.quick,
        "about_sections": f"Sections through the middle of {compared}. "
        f"{bodies.load_direction} Target and best candidate are cut in the same planes. Lines show "
        "the plates; over the best candidate, a black line is the outline of the target.",
        "tissues": tissue_legend(bodies),
        "differences": difference_legend(),
        "missing": bodies.missing,
        "similarities": study_tables.similarity_table(before, after, labels),
        "about_similarity": "Undeformed body, where the fit starts, and best candidate. "
        f" The search compared the shaded row{'s' if len(labels) > 1 else ''}.",
    }


def _viewer(name: str, shown: Json | None) -> Markup | None:
    return None if shown is None else script(name, shown)


def _findings(data: StudyData) -> dict[str, Any]:
    findings = with_intervals(data.results)
    drawn = data.bodies.figures(findings)
    return {
        "findings": findings.get("notes", ()),
        "findings_pictures": [picture(shown, said, said) for shown, said in drawn],
    }


def _search(data: StudyData) -> dict[str, Any]:
    generations = [scores for _, scores in data.results.complete_generations]
    rows = [
        (index + 1, number(scores.best, 5), number(scores.mean, 5))
        for index, scores in enumerate(generations)
    ]
    axis = data.results.spec.objective.axis
    units = {e.gene: e.unit for e in data.results.estimates.values()}
    failed = study_tables.failure_table(data.endings, units)
    share = f"{len(failed)} of {count(len(data.endings))} evaluations have no score"
    about_failures = (
        f"{share}; the search ranks them last."
        if failed
        else f"None: every one of {count(len(data.endings))} evaluations has a score."
        if data.endings
        else "None: nothing has been evaluated yet."
    )
    return {
        "convergence": convergence_picture(evaluated_points(data.endings), generations, axis),
        "score_axis": axis,
        "evaluation_data": evaluation_data(data.endings, units, axis),
        "about_search": _about_search(data, len(generations)),
        "generations": rows,
        "failures": failed,
        "about_failures": about_failures,
    }


def _about_search(data: StudyData, complete: int) -> str:
    spec = data.results.spec
    if spec.search.strategy != "genetic":
        return f"Generations: {generations_text(complete, spec.most_generations)}."
    return (
        f"{_plural(complete, 'complete generation')} of {spec.search.population} candidates; "
        f"the best {spec.search.elite} of each are kept unchanged and not evaluated again."
    )


def _simulation(data: StudyData) -> dict[str, Any]:
    best = data.results.best
    if best is None:
        return {"outcome": [], "about_outcome": ""}
    return {
        "outcome": study_tables.solver_table(best.outcome or {}),
        "about_outcome": f"Candidate {best.candidate} of generation {best.generation + 1}.",
    }


def _time(data: StudyData) -> dict[str, Any]:
    results, wall_s = data.results, data.results.wall_s
    computed = sum(not r.reused for r in data.endings)
    spent = {name: stage.total_s for name, stage in results.stages.items()}
    counts = results.counts
    work = [
        ("Evaluations done", count(counts.done)),
        ("Evaluations diverged", count(counts.diverged)),
        ("Evaluations crashed", count(counts.crashed)),
        ("Evaluations lost", count(counts.lost)),
        ("Reused from the store", count(counts.reused)),
    ]
    if computed and wall_s:
        work.append(("Throughput", f"{number(60 * computed / wall_s, 3)} evaluations per min"))
    if data.session is not None:
        work.append(("Parallel evaluations", count(data.session.workers)))
    return {
        "about_time": f"{duration(wall_s)} of wall time, preparation included; the evaluations "
        f"took {duration(sum(spent.values()))}, summed over all workers."
        if wall_s
        else "No run has recorded its time yet.",
        "stages": study_tables.stage_table(results.stages),
        "stage_bar": stage_picture(spent),
        "work": work,
    }


def _details(data: StudyData) -> dict[str, Any]:
    versions = data.results.versions
    configuration = to_plain(data.results.spec.as_dict())
    return {
        "case": study_tables.case_table(data.results.spec.case.organ, data.results.body_facts),
        "configuration": dump_yaml(configuration),
        "provenance": study_provenance(data),
        "glossary": STUDY_TERMS,
        "json": json.dumps(study_json(data.results), indent=2, ensure_ascii=False),
        "closing": f"Made by Palpate {versions.get('palpate', '')}.".replace(" .", "."),
    }


def _plural(n: int, noun: str) -> str:
    return f"{count(n)} {noun}" if n == 1 else f"{count(n)} {noun}s"


def write_report(study_dir: Path, *, quick: bool = False) -> Path:
    """Write ``report.html`` into the folder of a study, finished or not.

    Parameters
    ----------
    study_dir : Path
        Folder of the study. Its store is only read; missing data are named on the page.
    quick : bool
        Skip slow parts; see `service.report.study.study_data.read_study_data`.

    Returns
    -------
    Path
        The file; an older one is replaced atomically.

    Raises
    ------
    InputError
        If there is no study in the folder.
    StoreError
        If its journal is damaged, or the report cannot be written.
    """
    page = render_study(read_study_data(study_dir, quick=quick))
    path = StudyLayout(study_dir).report
    write_file(path, page.encode())
    return path


def render_study(data: StudyData) -> str:
    """Return the page as text; equal data give the same bytes."""
    return filled("study.html.j2", study_context(data))
