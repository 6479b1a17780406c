"""HTML of studies, results, diagnoses and volumes for notebooks."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from palpate.service.diagnosis.diagnosed_constants import judged_constants
from palpate.service.diagnosis.diagnosis_run import FinishedDiagnosis
from palpate.service.diagnosis.diagnosis_words import fitted_causes, sentence, spoken, strength
from palpate.service.diagnosis.magnitude_words import magnitude
from palpate.service.number_formatting import number, symbol
from palpate.service.report.drawing import colours
from palpate.service.report.drawing.raster import png_uri
from palpate.service.report.drawing.volume_sections import AXES, VIEWS, Section, View, section
from palpate.service.report.study.comparison_page import constant_rows, outcome_rows, setting_rows
from palpate.service.results.result_records import StudyResults
from palpate.service.results.study_comparison import StudyComparison
from palpate.service.study.study_keys import StudySpec
from palpate.storage.values import Tissue, Volume

# Size of a thumbnail, in pixels and in voxels.
SIDE_PX, MOST_VOXELS = 150, 300
MOST_CAUSES = 6
_TISSUES = colours.colour_table({int(t): c for t, c in colours.TISSUE_PALETTE.items()})
_GREYS = np.column_stack([*[np.arange(256)] * 3, np.full(256, 255)]).astype(np.uint8)


def spec_html(spec: StudySpec, about: str) -> Markup:
    """Return the searched parameters of a study, below a line that summarises it."""
    rows = []
    for name, (lower, upper) in spec.search.parameters.items():
        unit = spec.case.parameters.at_door(name).unit.symbol
        rows.append((symbol(name, unit), number(lower), number(upper), unit))
    title = Markup("<b>{}</b>: {}").format(spec.name, about)
    return _table(title, ("searched", "from", "to", "unit"), rows)


def results_html(results: StudyResults) -> Markup:
    """Return the estimates of a study with intervals, and reasons against quoting some."""
    rows = [
        (
            symbol(name, e.unit),
            number(e.estimate),
            e.interval_text or "–",
            e.unit,
            "yes" if e.quotable else f"no: {'; '.join(e.reasons)}",
        )
        for name, e in results.estimates.items()
    ]
    state = results.state + (f", {results.stop_reason}" if results.stop_reason else "")
    title = Markup("<b>{}</b>: {}").format(results.name, state)
    notes = Markup("").join(Markup("<p>{}</p>").format(text) for text in results.caveats)
    return notes + _table(
        title, ("constant", "estimate", "90 % interval", "unit", "quotable"), rows
    )


def comparison_html(comparison: StudyComparison) -> Markup:
    """Return the constants, scores and differing settings of several studies."""
    labels = [study.label for study in comparison.studies]
    return Markup("").join(
        _table("", (first, *labels), [(name, *cells) for name, cells in rows])
        for first, rows in (
            ("constant", constant_rows(comparison)),
            ("measure", outcome_rows(comparison.studies)),
            ("setting", setting_rows(comparison)),
        )
        if rows
    )


def diagnosis_html(diagnosis: FinishedDiagnosis) -> Markup:
    """Return the verdict of a diagnosis, the fitted causes and the constants."""
    summary = diagnosis.summary
    title = Markup("<p><b>{}</b>: {}</p>").format(summary.case, sentence(summary))
    ranked = fitted_causes(summary)[:MOST_CAUSES]
    causes = [(spoken(row.name), strength(gain), magnitude(row)) for row, gain in ranked]
    constants = [
        (symbol(name, row.unit), row.text, "yes" if row.answer.quotable else "no")
        for name, row in judged_constants(summary).items()
    ]
    return (
        title
        + _table("", ("cause", "evidence", "magnitude"), causes)
        + _table("", ("constant", "value", "quotable"), constants)
    )


def volume_html(volume: Volume, about: str) -> Markup:
    """Return three sections through the middle of a volume as pictures, below a line of text."""
    views = VIEWS[:1] if volume.values.shape[0] == 1 else VIEWS
    shown, colours = _drawable(volume)
    pictures = Markup("").join(_thumbnail(shown, colours, view) for view in views)
    return Markup('<p>{}</p><div style="display:flex;flex-wrap:wrap;gap:12px">{}</div>').format(
        about, pictures
    )


def _drawable(volume: Volume) -> tuple[Volume, NDArray[np.uint8]]:
    """Return a volume of bytes and their colours, of tissues or greys."""
    values = volume.values
    if values.dtype == np.uint8 and int(values.max(initial=0)) <= max(Tissue):
        return volume, _TISSUES
    finite = np.nan_to_num(np.asarray(values, np.float64))
    low, span = float(finite.min(initial=0)), float(np.ptp(finite)) if finite.size else 0.0
    scaled = np.rint(255 * (finite - low) / (span or 1.0)).astype(np.uint8)
    return Volume(scaled, volume.spacing_mm, volume.origin_mm), _GREYS


def _thumbnail(volume: Volume, colours: NDArray[np.uint8], view: View) -> Markup:
    count = volume.shape_xyz[view.normal]
    middle = volume.origin_mm[view.normal] + (count // 2) * volume.spacing_mm[view.normal]
    cut: Section = section(volume, view, middle)
    rows, columns = cut.values.shape
    wide, high = columns * cut.spacing_mm[0], rows * cut.spacing_mm[1]
    scale = SIDE_PX / max(wide, high)
    step = 1 + max(rows, columns) // MOST_VOXELS
    picture = png_uri(np.ascontiguousarray(cut.values[::step, ::step]), colours)
    name = f"{AXES[view.across]}{AXES[view.up]} at {AXES[view.normal]} = {number(middle, 3)} mm"
    return Markup(
        '<figure style="margin:0"><img src="{}" alt="{}" width="{}" height="{}" '
        'style="image-rendering:pixelated"><figcaption><small>{}</small></figcaption></figure>'
    ).format(picture, name, max(1, round(scale * wide)), max(1, round(scale * high)), name)


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    def line(cells: Sequence[str], tag: str) -> Markup:
        ends = Markup("").join(
            Markup('<{0} style="text-align:left">{1}</{0}>').format(Markup(tag), escape(cell))
            for cell in cells
        )
        return Markup("<tr>{}</tr>").format(ends)

    head = Markup("<p>{}</p>").format(title) if title else Markup("")
    body = Markup("").join(line(row, "td") for row in rows)
    return head + Markup("<table><thead>{}</thead><tbody>{}</tbody></table>").format(
        line(headings, "th"), body
    )
