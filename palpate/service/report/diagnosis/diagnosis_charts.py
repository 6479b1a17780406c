"""Charts of a diagnosis: gap and evidence."""

from collections.abc import Sequence
from dataclasses import dataclass

from palpate.service.diagnosis.magnitude_words import length
from palpate.service.number_formatting import MINUS
from palpate.service.report.drawing.svg import Mark, Scale, Svg, horizontal_axis, legend, text_width
from palpate.workers.diagnosis.outcome.diagnosis_summary import GapEstimate, Summary

NARROW = 600.0
# Width of the number at the end of a bar.
BESIDE_PX = 84.0
BAR_PX = 15.0


@dataclass(frozen=True)
class Judged:
    """A gap without and with the effect.

    Parameters
    ----------
    title : str
        Name of the compared scans.
    before : GapEstimate
    after : GapEstimate or None
        None if no effect is named.
    """

    title: str
    before: GapEstimate
    after: GapEstimate | None


@dataclass(frozen=True)
class Evidence:
    """Log evidence gained by a refit, in nats; `field` is None if it was not fitted."""

    title: str
    gain: float
    field: float | None


def gap_rows(summary: Summary) -> list[Judged]:
    """Return the gap of all scans, and of each scan held out of the fit."""
    gap, loaded = summary.gap_mm, "scans" if summary.markers is None else "states"
    rows = [Judged(f"all {loaded}", gap.before, gap.after)]
    for name, held in (gap.held_out_each or {}).items():
        rows.append(Judged(f"{name}, held out of the fit", held.before, held.after))
    return rows


def gaps(rows: Sequence[Judged], noise_mm: float, effect: str, width: float) -> Svg:
    """Return bars of the gap with their intervals, and a line for the noise.

    Parameters
    ----------
    rows : sequence of Judged
    noise_mm : float
        Root mean square noise of one point, drawn as a line.
    effect : str
        Name of the effect in the legend; empty if there is none.
    width : float
    """
    marks: list[tuple[Mark, str, str]] = [("box", "bar-before", "nominal model")]
    if effect:
        marks.append(("box", "bar-after", f"with {effect}"))
    marks.append(("dashed", "limit", "noise of one point"))
    most = 1.05 * max(noise_mm, *(row.before.high_mm for row in rows))
    bars = _Bars([row.title for row in rows], marks, width, (0.0, most), 56.0)
    for number, row in enumerate(rows):
        pair = [(row.before, "bar-before"), (row.after, "bar-after")]
        both = [(gap, class_) for gap, class_ in pair if gap is not None]
        for place, (gap, class_) in enumerate(both):
            y = bars.middle(number) + (place - (len(both) - 1) / 2) * (BAR_PX + 3)
            bars.bar(y, 0.0, gap.gap_mm, class_)
            bars.interval(y, gap.low_mm, gap.high_mm)
            bars.beside(y, gap.high_mm, length(gap.gap_mm, gap.high_mm))
    bars.limit(noise_mm)
    return bars.finished("gap beyond the noise, mm")


def evidence(rows: Sequence[Evidence], threshold: float, width: float) -> Svg:
    """Return bars of the gain of each fit, and of a smooth field beside it."""
    marks: list[tuple[Mark, str, str]] = [("box", "bar-after", "effect")]
    if any((row.field or 0.0) > 0 for row in rows):
        marks.append(("box", "bar-field", "left for something else"))
    marks.append(("dashed", "limit", "named from here on"))
    ends = [row.gain + max(0.0, row.field or 0.0) for row in rows]
    least = min(0.0, *(row.gain for row in rows))
    bars = _Bars([r.title for r in rows], marks, width, (least, max(threshold, *ends, 0.1)), 28.0)
    for number, row in enumerate(rows):
        y, more = bars.middle(number), max(0.0, row.field or 0.0)
        bars.bar(y, 0.0, row.gain, "bar-after")
        if more:
            bars.bar(y, max(row.gain, 0.0), max(row.gain, 0.0) + more, "bar-field")
        text = f"{row.gain:.1f}" + (f" + {more:.1f}" if more else "")
        bars.beside(y, max(row.gain, 0.0) + more, text.replace("-", MINUS))
    bars.limit(threshold)
    return bars.finished("gain over the nominal model, nats")


class _Bars:
    """A chart of horizontal bars with titles to the left, or above on narrow pages."""

    def __init__(
        self,
        titles: Sequence[str],
        marks: Sequence[tuple[Mark, str, str]],
        width: float,
        limits: tuple[float, float],
        row_px: float,
    ) -> None:
        self.narrow = width < NARROW
        left = 6.0 if self.narrow else 24 + max(text_width(title, 13) for title in titles)
        self.svg = Svg(width, 0)
        self.above = 20.0 if self.narrow else 0.0
        self.row_px, self.rows = row_px + self.above, len(titles)
        self.top = 14 + legend(self.svg, marks, left, 12, width)
        self.scale = Scale(*limits, left, width - BESIDE_PX)
        self.bottom = self.top + self.row_px * len(titles)
        self.drawn: list[tuple[str, dict[str, object]]] = []
        for number, title in enumerate(titles):
            if self.narrow:
                self.svg.text(left, self.top + number * self.row_px + 15, title)
            else:
                self.svg.text(left - 12, self.middle(number) + 4, title, text_anchor="end")
        horizontal_axis(
            self.svg, self.scale, self.bottom, "", 5 if self.narrow else 9, self.top - 4
        )

    def middle(self, number: int) -> float:
        """Return the vertical position of a row."""
        return self.top + number * self.row_px + self.above + (self.row_px - self.above) / 2

    def bar(self, y: float, start: float, end: float, class_: str) -> None:
        a, b = sorted((self.scale.at(start), self.scale.at(end)))
        place = {"x": a, "y": y - BAR_PX / 2, "width": max(b - a, 0.5), "height": BAR_PX}
        self.svg.add("rect", class_=class_, **place)

    def interval(self, y: float, low: float, high: float) -> None:
        a, b = self.scale.at(low), self.scale.at(high)
        shape = f"M{a:.1f} {y - 4:.1f}v8M{a:.1f} {y:.1f}H{b:.1f}M{b:.1f} {y - 4:.1f}v8"
        self.svg.add("path", class_="whisker", d=shape)

    def beside(self, y: float, value: float, text: str) -> None:
        self.svg.text(self.scale.at(value) + 8, y + 4, text, class_="tick")

    def limit(self, value: float) -> None:
        """Draw a line across all rows; on narrow pages beside the bars, not across the titles."""
        x, reach = self.scale.at(value), (self.row_px - self.above) / 2
        ends = [(self.top - 4, self.bottom)]
        if self.narrow:
            middles = map(self.middle, range(self.rows))
            ends = [(middle - reach, middle + reach) for middle in middles]
        line = "".join(f"M{x:.1f} {start:.1f}V{end:.1f}" for start, end in ends)
        self.svg.add("path", class_="limit", d=line)

    def finished(self, label: str) -> Svg:
        middle = (self.scale.start + self.scale.end) / 2
        self.svg.text(middle, self.bottom + 34, label, text_anchor="middle")
        self.svg.height = self.bottom + 42
        return self.svg
