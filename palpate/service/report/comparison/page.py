"""The page of a comparison of studies, in one self-contained file."""

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import Markup

from palpate.service.formatting import count, duration, number, symbol
from palpate.service.report.comparison import charts
from palpate.service.report.drawing.pictures import Picture, chart
from palpate.service.report.page.template import filled
from palpate.service.results.comparison import ComparedStudy, StudyComparison
from palpate.service.results.record import ParameterEstimate
from palpate.service.versions import palpate_version
from palpate.storage.backends.atomic import write_file


def write_comparison(comparison: StudyComparison, path: Path) -> Path:
    """Write the page and return its path."""
    write_file(path, render(comparison).encode())
    return path


def render(comparison: StudyComparison) -> str:
    """Return the page as text; equal comparisons give the same bytes."""
    values = {
        "title": f"{len(comparison.studies)} studies",
        "lead": ", ".join(study.label for study in comparison.studies),
        "caveats": [
            f"{study.label}: {text}"
            for study in comparison.studies
            for text in study.results.caveats
        ],
        "labels": [study.label for study in comparison.studies],
        "constants": constant_rows(comparison),
        "pictures": [_constant(comparison, gene) for gene in comparison.genes],
        "convergence": _convergence(comparison),
        "outcomes": outcome_rows(comparison.studies),
        "settings": setting_rows(comparison),
        "reasons": reason_rows(comparison),
        "json": json.dumps(comparison.as_dict(), indent=2, ensure_ascii=False),
        "closing": f"Made by Palpate {palpate_version()}.",
    }
    return filled("comparison.html.j2", values)


def constant_rows(comparison: StudyComparison) -> list[tuple[Markup, list[str]]]:
    """Return each constant, and its estimate with interval in every study."""
    return [
        (
            symbol(gene, charts.found_unit(comparison, gene)),
            [estimate_text(comparison.estimate(study, gene)) for study in comparison.studies],
        )
        for gene in comparison.genes
    ]


def estimate_text(e: ParameterEstimate | None) -> str:
    """Return an estimate as ``10.1 (9.8 to 10.4) kPa``, with a star if it may not be quoted."""
    if e is None:
        return "not searched"
    if e.estimate is None:
        return "not estimated"
    between = "" if e.interval is None else f" ({' to '.join(map(number, e.interval))})"
    star = "" if e.quotable else " *"
    return f"{number(e.estimate)}{between} {e.unit}".rstrip() + star


def outcome_rows(studies: Sequence[ComparedStudy]) -> list[tuple[str, list[str]]]:
    """Return scores, evaluations, time and state, one text for each study."""

    def score(study: ComparedStudy, name: str) -> str:
        scores = study.results.best_score
        return number(None if scores is None else scores.get(name), 4)

    rows = [
        (title, [score(study, name) for study in studies])
        for title, name in (("Jaccard", "jc"), ("MHD, mm", "mhd_mm"), ("GSF", "gsf"))
    ]
    ended = [count(len(study.lowest_scores)) for study in studies]
    return [
        *rows,
        ("Evaluations", ended),
        ("Strategy", [study.results.spec.search.strategy for study in studies]),
        ("Wall time", [duration(study.results.wall_s) for study in studies]),
        ("State", [study.results.state for study in studies]),
    ]


def setting_rows(comparison: StudyComparison) -> list[tuple[str, list[str]]]:
    """Return the settings that differ, one text for each study."""
    return [(key, [_text(v) for v in values]) for key, values in comparison.settings.items()]


def reason_rows(comparison: StudyComparison) -> list[str]:
    """Return a sentence for each estimate that may not be quoted."""
    return [
        f"{study.label}, {e.gene}: {'; '.join(e.reasons)}."
        for study in comparison.studies
        for e in study.results.estimates.values()
        if e.reasons
    ]


def _constant(comparison: StudyComparison, gene: str) -> Picture:
    return chart(
        partial(charts.constants, comparison, gene), charts.constants_words(comparison, gene)
    )


def _convergence(comparison: StudyComparison) -> Picture | None:
    ends = [s.lowest_scores[-1] for s in comparison.studies if s.lowest_scores]
    if not any(map(math.isfinite, ends)):
        return None
    alt = "; ".join(
        f"{s.label}: {number(s.lowest_scores[-1])} after {len(s.lowest_scores)} evaluations"
        for s in comparison.studies
        if s.lowest_scores
    )
    return chart(partial(charts.convergence, comparison), f"Lowest {comparison.axis}. {alt}.")


def _text(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(v)}" for key, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_text(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
