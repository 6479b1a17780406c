"""Draws the pictures of a study's page: its charts and sections, with captions."""

import math
from collections.abc import Iterable, Mapping, Sequence

from markupsafe import Markup

from service.formatting import label, number
from service.report import study_figures, study_sections
from service.report.pictures import Picture, picture
from service.report.slices import AXES, VIEWS
from service.report.study_bodies import Bodies
from service.report.study_figures import EvaluationPoint, SearchedParameter
from service.results import GenerationScores, ParameterEstimate
from storage.records import EvaluationRecord
from storage.status import Status


def evaluated_points(endings: Iterable[EvaluationRecord]) -> list[EvaluationPoint]:
    """Return every evaluation as a point; those without a score at +inf."""
    return [
        EvaluationPoint(
            r.generation,
            r.genes,
            float(r.score["gsf"]) if r.status is Status.DONE and r.score else math.inf,
        )
        for r in sorted(endings, key=lambda r: r.candidate)
    ]


def best_tenth(points: Sequence[EvaluationPoint]) -> dict[str, list[float]]:
    """Return the parameters of the best tenth of the different candidates, at least two."""
    different = {tuple(p.genes.values()): p for p in points if p.gsf < math.inf}
    ranked = sorted(different.values(), key=lambda p: p.gsf)
    good = ranked[: max(2, math.ceil(len(ranked) / 10))]
    return {name: [p.genes[name] for p in good] for name in (good[0].genes if good else ())}


def searched_parameters(
    estimates: Mapping[str, ParameterEstimate],
) -> list[SearchedParameter]:
    """Return the estimates of a study as the charts need them."""
    return [
        SearchedParameter(e.gene, label(name, e.unit), e.lower, e.upper, e.estimate, e.target)
        for name, e in estimates.items()
    ]


def convergence_picture(
    points: Sequence[EvaluationPoint], generations: Sequence[GenerationScores]
) -> Picture | None:
    """Draw how the scores fell; None if there are none."""
    if not any(p.gsf < math.inf for p in points):
        return None
    best = [g.best for g in generations]
    mean = [math.nan if g.mean is None else g.mean for g in generations]
    last = f", the last of which reached {number(best[-1])}" if best else ""
    return picture(
        study_figures.convergence(points, best, mean),
        f"Scores of {len(points)} evaluations in {len(best)} complete generations{last}.",
    )


def range_picture(
    parameters: Sequence[SearchedParameter], cloud: Mapping[str, Sequence[float]]
) -> Picture:
    """Draw estimates and targets between the bounds."""
    alt = "; ".join(
        f"{p.label}: estimate {number(p.estimate)}, target {number(p.target)}, searched from "
        f"{number(p.lower)} to {number(p.upper)}"
        for p in parameters
    )
    return picture(
        study_figures.ranges(parameters, cloud),
        alt,
        "The strokes show where the search has gone, which is no interval of confidence.",
    )


def scatter_pictures(
    parameters: Sequence[SearchedParameter], points: Sequence[EvaluationPoint]
) -> list[Picture]:
    """Draw the scores over each parameter; nothing if nothing has a score."""
    if not any(math.isfinite(p.gsf) for p in points):
        return []
    generations = 1 + max(p.generation for p in points)
    return [
        picture(
            study_figures.scatter(p, points, generations),
            f"GSF of all evaluations over {p.label}.",
        )
        for p in parameters
    ]


def section_pictures(bodies: Bodies, labels: Iterable[str]) -> list[Picture]:
    """Draw three views of the bodies that are there."""
    tissues = [number for number, name in bodies.labels.items() if name in set(labels)]
    flat = bodies.reference is not None and bodies.reference.values.shape[0] == 1
    undeformed, deformed = study_sections.middles(bodies, tissues)
    pictures = []
    for view in VIEWS[:1] if flat else VIEWS:
        drawn = study_sections.side_by_side(bodies, view, tissues)
        if drawn is None:
            continue
        axis = AXES[view.normal]
        places = [
            f"{what} at {axis} = {number(at[view.normal], 3)} mm"
            for what, at in (("undeformed", undeformed), ("deformed", deformed))
            if at is not None
        ]
        name = "Section" if flat else view.name.capitalize()
        caption = Markup("<b>{}</b>, {}").format(name, ", ".join(places))
        alt = f"{name}{'' if flat else ' section'}s of {', '.join(_names(bodies))}."
        pictures.append(picture(drawn, alt, caption))
    return pictures


def stage_picture(seconds: Mapping[str, float]) -> Picture | None:
    """Draw the shares of the stages; None if no time was taken."""
    total = sum(seconds.values())
    if total <= 0:
        return None
    shares = ", ".join(f"{name} {100 * spent / total:.1f} %" for name, spent in seconds.items())
    return picture(study_figures.stages(seconds), f"Shares of the time: {shares}.")


def _names(bodies: Bodies) -> list[str]:
    named = {
        "undeformed body": bodies.reference,
        "target": bodies.target,
        "best candidate": bodies.best,
    }
    return [name for name, volume in named.items() if volume is not None]
