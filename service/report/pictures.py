"""The figures of a report as images, with the words that go with them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from service.report import figures, panels
from service.report.bodies import Bodies
from service.report.canvas import data_uri
from service.report.figures import Found, Point
from service.report.slices import AXES, VIEWS
from service.report.words import label, number
from storage.records import EvaluationRecord
from storage.status import Status
from workers.images.labels import tissue_named


@dataclass(frozen=True)
class Picture:
    """An image in the page: its data, what it shows, its width, and what stands below it."""

    uri: str
    alt: str
    width_px: int
    caption: str | Markup = ""


def picture(drawn: Figure, alt: str, caption: str | Markup = "") -> Picture:
    """A figure, drawn for good."""
    return Picture(data_uri(drawn), alt, round(96 * drawn.get_figwidth()), caption)


def points_of(endings: Iterable[EvaluationRecord]) -> list[Point]:
    """Every evaluation as a point; those without a score at +inf."""
    return [
        Point(
            r.generation,
            r.genes,
            float(r.score["gsf"]) if r.status is Status.DONE and r.score else math.inf,
        )
        for r in sorted(endings, key=lambda r: r.candidate)
    ]


def best_tenth(points: Sequence[Point]) -> dict[str, list[float]]:
    """Parameters of the best tenth of the different candidates, at least two, by name."""
    different = {tuple(p.genes.values()): p for p in points if p.gsf < math.inf}
    ranked = sorted(different.values(), key=lambda p: p.gsf)
    good = ranked[: max(2, math.ceil(len(ranked) / 10))]
    return {name: [p.genes[name] for p in good] for name in (good[0].genes if good else ())}


def found_parameters(estimates: Mapping[str, Mapping[str, Any]]) -> list[Found]:
    """The estimates of `service.results` for the charts."""
    return [
        Found(
            f["gene"],
            label(name, f["unit"] or ""),
            f["bounds"][0],
            f["bounds"][1],
            f["estimate"],
            f["target"],
        )
        for name, f in estimates.items()
    ]


def convergence_picture(
    points: Sequence[Point], generations: Sequence[Mapping[str, Any]]
) -> Picture | None:
    """How the scores fell; None if there are none."""
    if not any(p.gsf < math.inf for p in points):
        return None
    best = [float(g["best"]) for g in generations]
    mean = [math.nan if g["mean"] is None else float(g["mean"]) for g in generations]
    last = f", the last of which reached {number(best[-1])}" if best else ""
    return picture(
        figures.convergence(points, best, mean),
        f"Scores of {len(points)} evaluations in {len(best)} complete generations{last}.",
    )


def range_picture(found: Sequence[Found], cloud: Mapping[str, Sequence[float]]) -> Picture:
    """Estimates and targets between the bounds."""
    said = "; ".join(
        f"{f.label}: estimate {number(f.estimate)}, target {number(f.target)}, searched from "
        f"{number(f.lower)} to {number(f.upper)}"
        for f in found
    )
    return picture(
        figures.ranges(found, cloud),
        said,
        "The strokes show where the search has gone, which is no interval of confidence.",
    )


def scatter_pictures(found: Sequence[Found], points: Sequence[Point]) -> list[Picture]:
    """Scores over each parameter; none if nothing has a score."""
    if not any(math.isfinite(p.gsf) for p in points):
        return []
    generations = 1 + max(p.generation for p in points)
    return [
        picture(
            figures.scatter(f, points, generations),
            f"GSF of all evaluations over {f.label}.",
        )
        for f in found
    ]


def section_pictures(bodies: Bodies, labels: Iterable[str]) -> list[Picture]:
    """Three views of the bodies that are there."""
    tissues = [tissue_named(name) for name in labels]
    undeformed, deformed = panels.middles(bodies, tissues)
    shown = []
    for view in VIEWS:
        drawn = panels.panels(bodies, view, tissues)
        if drawn is None:
            continue
        axis = AXES[view.normal]
        places = [
            f"{what} at {axis} = {number(at[view.normal], 3)} mm"
            for what, at in (("undeformed", undeformed), ("deformed", deformed))
            if at is not None
        ]
        caption = Markup("<b>{}</b>, {}").format(view.name.capitalize(), ", ".join(places))
        alt = f"{view.name.capitalize()} sections of {', '.join(_names(bodies))}."
        shown.append(picture(drawn, alt, caption))
    return shown


def stage_picture(seconds: Mapping[str, float]) -> Picture | None:
    """Shares of the stages; None if no time was taken."""
    total = sum(seconds.values())
    if total <= 0:
        return None
    said = ", ".join(f"{name} {100 * spent / total:.1f} %" for name, spent in seconds.items())
    return picture(figures.stages(seconds), f"Shares of the time: {said}.")


def _names(bodies: Bodies) -> list[str]:
    named = {
        "undeformed body": bodies.reference,
        "target": bodies.target,
        "best candidate": bodies.best,
    }
    return [name for name, volume in named.items() if volume is not None]
