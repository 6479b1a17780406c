"""Pictures of a study's page: charts, sections and viewer data."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from palpate.service.number_formatting import bare, label, number
from palpate.service.report.drawing.colours import (
    DIFFERENCE_PALETTE,
    INTERFACE_PALETTE,
    TISSUE_PALETTE,
    Difference,
)
from palpate.service.report.drawing.volume_sections import AXES, VIEWS, Plates, plates_touching
from palpate.service.report.page.page_elements import Json, Picture, chart, script, small_chart
from palpate.service.report.page.page_viewers import (
    BodyScan,
    BodySurface,
    SlicePanel,
    SliceSet,
    body_viewer,
    slice_viewer,
)
from palpate.service.report.study import study_charts, study_sections
from palpate.service.report.study.study_charts import EvaluationPoint, SearchedParameter
from palpate.service.report.study.study_data import Bodies
from palpate.service.results.identification import Identification
from palpate.service.results.result_records import GenerationScores, ParameterEstimate
from palpate.storage.best_candidate import minimised, score_of
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.values import Tissue
from palpate.workers.common_keys import CaseSpec
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from palpate.workers.organs.organ_plugins import organ_named

# The script looks for charts of this kind by name.
EVALUATIONS = "evaluations"
BEST = "best"


@dataclass(frozen=True)
class SectionRow:
    """Sections of all bodies in one view, each with its title, and the caption below."""

    panels: tuple[tuple[str, Markup], ...]
    wide: bool
    caption: Markup


def evaluated_points(endings: Iterable[EvaluationRecord]) -> list[EvaluationPoint]:
    """Return every evaluation as a point, with +inf for missing scores."""
    return [
        EvaluationPoint(r.generation, r.genes, score_of(r))
        for r in sorted(endings, key=lambda r: r.candidate)
    ]


def evaluation_data(
    endings: Iterable[EvaluationRecord], units: Mapping[str, str], axis: str = "GSF"
) -> Markup:
    """Return the tooltip data of evaluations as a page element."""
    ordered = sorted(endings, key=lambda r: r.candidate)
    genes = list(ordered[0].genes) if ordered else []
    names = [f"{bare(g, units.get(g, ''))}, {units[g]}" if units.get(g) else g for g in genes]
    rows = [
        [
            r.candidate,
            r.generation + 1,
            number(minimised(r.score)) if r.score else r.status.value,
            *(number(r.genes[g]) for g in genes),
        ]
        for r in ordered
    ]
    return script(EVALUATIONS, {"names": names, "score": axis, "rows": rows})


def best_tenth(points: Sequence[EvaluationPoint]) -> dict[str, list[float]]:
    """Return the parameters of the best tenth of the distinct candidates, at least two."""
    different = {tuple(p.genes.values()): p for p in points if p.score < math.inf}
    ranked = sorted(different.values(), key=lambda p: p.score)
    good = ranked[: max(2, math.ceil(len(ranked) / 10))]
    return {name: [p.genes[name] for p in good] for name in (good[0].genes if good else ())}


def searched_parameters(
    estimates: Mapping[str, ParameterEstimate], known: Identification | None = None
) -> list[SearchedParameter]:
    """Return the estimates of a study for the charts."""
    constants = {} if known is None else known.constants
    intervals = {
        name: (c.interval.lower, c.interval.upper) for name, c in constants.items() if c.interval
    }
    return [
        SearchedParameter(
            e.gene, label(name, e.unit), e.lower, e.upper, e.estimate, e.target, intervals.get(name)
        )
        for name, e in estimates.items()
    ]


def convergence_picture(
    points: Sequence[EvaluationPoint], generations: Sequence[GenerationScores], axis: str = "GSF"
) -> Picture | None:
    """Draw the scores against evaluations; None if there are none."""
    if not any(p.score < math.inf for p in points):
        return None
    best = [g.best for g in generations]
    mean = [math.nan if g.mean is None else g.mean for g in generations]
    last = f", the last of which reached {number(best[-1])}" if best else ""
    return chart(
        lambda width: study_charts.convergence_chart(points, best, mean, width, axis),
        f"Scores of {len(points)} evaluations in {len(best)} complete generations{last}.",
        "Point at a dot to see its candidate in all charts. On the keyboard, use the arrow keys.",
        chart=EVALUATIONS,
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
    return chart(
        lambda width: study_charts.range_chart(parameters, cloud, width),
        alt,
        "The strokes show the values that the search has tried, not confidence intervals.",
        [
            ("parameter", "estimate", "interval_low", "interval_high", "target", "lower", "upper"),
            *(
                (p.label, p.estimate, *(p.interval or (None, None)), p.target, p.lower, p.upper)
                for p in parameters
            ),
        ],
    )


def scatter_pictures(
    parameters: Sequence[SearchedParameter], points: Sequence[EvaluationPoint], axis: str = "GSF"
) -> list[Picture]:
    """Draw the scores against each parameter; nothing if no evaluation has a score."""
    if not any(math.isfinite(p.score) for p in points):
        return []
    generations = 1 + max(p.generation for p in points)
    return [
        small_chart(
            study_charts.scatter_chart(p, points, generations, axis=axis),
            f"{axis} of all evaluations against {p.label}.",
            chart=EVALUATIONS,
        )
        for p in parameters
    ]


def section_pictures(bodies: Bodies, labels: Iterable[str], case: CaseSpec) -> list[SectionRow]:
    """Draw three views of the available bodies."""
    plates = plates_of(bodies, case)
    tissues = _compared(bodies, labels)
    middle = study_sections.section_middles(bodies, tissues)
    rows = []
    for view in VIEWS[:1] if _is_flat(bodies) else VIEWS:
        drawn = study_sections.sections_side_by_side(bodies, view, tissues, middle, plates)
        if drawn is None:
            continue
        axis = AXES[view.normal]
        places = [
            f"{what} at {axis} = {number(point[view.normal], 3)} mm"
            for what, point in zip(("undeformed", "deformed"), middle, strict=True)
            if point is not None
        ]
        name = "Section" if _is_flat(bodies) else view.name.capitalize()
        caption = Markup("<b>{}</b>, {}").format(name, ", ".join(places))
        rows.append(SectionRow(drawn.panels, drawn.wide, caption))
    return rows


def plates_of(bodies: Bodies, case: CaseSpec) -> dict[str, Plates]:
    """Return the plates at the deformed bodies, by name in the slice viewer."""
    pressed = organ_named(case.organ).pressed(case)
    if pressed is None:
        return {}
    deformed = {"target": bodies.target, BEST: bodies.best}
    return {
        name: plates_touching(volume, pressed.axis)
        for name, volume in deformed.items()
        if volume is not None
    }


def slice_data(bodies: Bodies, labels: Iterable[str], case: CaseSpec) -> Json | None:
    """Return the data of the slice viewer; None if there is no body."""
    volumes = {
        name: volume
        for name, volume in (
            ("reference", bodies.reference),
            ("target", bodies.target),
            (BEST, bodies.best),
        )
        if volume is not None
    }
    tissues = _compared(bodies, labels)
    undeformed, deformed = study_sections.section_middles(bodies, tissues)
    point = deformed or undeformed
    if point is None:
        return None
    fields = {} if bodies.displacement is None else {"displacement": bodies.displacement}
    names = " + ".join(bodies.labels[t] for t in tissues)
    meaning = dict(zip(Difference, _MEANING, strict=True))
    return slice_viewer(
        [SliceSet("", volumes, point, plates_of(bodies, case), fields)],
        [
            SlicePanel("Undeformed", "labels", ("reference",)),
            SlicePanel("Target", "labels", ("target",)),
            SlicePanel(
                "Best candidate", "labels", (BEST,), tuple(tissues), "target", tuple(fields)
            ),
            SlicePanel(f"Difference, {names}", "difference", ("target", BEST), tuple(tissues)),
        ],
        VIEWS[:1] if _is_flat(bodies) else VIEWS,
        {int(t): (name, TISSUE_PALETTE[Tissue(t)]) for t, name in bodies.labels.items()},
        [(meaning[kind], DIFFERENCE_PALETTE[kind]) for kind in Difference],
        meanings={"displacement": "displacement of the tissue"},
    )


def body_data(bodies: Bodies, case: CaseSpec) -> Json | None:
    """Return the data of the 3-D viewer; None if the body has no surfaces."""
    if not bodies.surfaces:
        return None
    surfaces = [
        BodySurface(
            s.name,
            INTERFACE_PALETTE.get(s.name, TISSUE_PALETTE[Tissue.FAT]),
            s.vertices,
            s.triangles,
        )
        for s in bodies.surfaces
    ]
    scan = BodyScan(
        "",
        organ_named(case.organ).pressed(case) or Pressed(),
        [{} if s.moved is None else {BEST: s.moved} for s in bodies.surfaces],
        [{} if s.gap_mm is None else {BEST: s.gap_mm} for s in bodies.surfaces],
    )
    return body_viewer(
        surfaces,
        [scan],
        [(BEST, "best candidate")],
        "best candidate outside (+) or inside (−) the target",
    )


def stage_picture(seconds: Mapping[str, float]) -> Picture | None:
    """Draw the shares of the stages; None if no time was recorded."""
    total = sum(seconds.values())
    if total <= 0:
        return None
    shares = ", ".join(f"{name} {100 * spent / total:.1f} %" for name, spent in seconds.items())
    return chart(
        lambda width: study_charts.stage_chart(seconds, width),
        f"Shares of the time: {shares}.",
        rows=[("stage", "seconds"), *seconds.items()],
    )


_MEANING = (
    "outside both bodies",
    "rest of the body",
    "in both",
    "only in the target",
    "only in the best candidate",
)


def _compared(bodies: Bodies, labels: Iterable[str]) -> list[int]:
    wanted = set(labels)
    return [number for number, name in bodies.labels.items() if name in wanted]


def _is_flat(bodies: Bodies) -> bool:
    return bodies.reference is not None and bodies.reference.values.shape[0] == 1
