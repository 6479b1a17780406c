"""A scored set as text: one self-contained page, and a Markdown table inserted into a document."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from palpate.service.blind import blind_charts
from palpate.service.blind.answer_statistics import NOTHING, Band, Estimate, confusion, reliability
from palpate.service.blind.blind_metrics import Metric, Unit, both_known
from palpate.service.blind.case_truth import GROUPS, CaseRecord
from palpate.service.blind.set_scoring import ScoredSet, Seals
from palpate.service.diagnosis.diagnosis_words import spoken, together
from palpate.service.diagnosis.magnitude_words import signed
from palpate.service.installed_packages import palpate_version
from palpate.service.number_formatting import NONE
from palpate.service.report.page.page_elements import Picture, filled, picture
from palpate.storage.errors import InputError


def shown(value: float | None, unit: Unit) -> str:
    """Return a value with its unit.

    Examples
    --------
    >>> shown(0.95, "share"), shown(0.0412, "mm"), shown(-0.5, "number"), shown(None, "mm")
    ('95 %', '0.041 mm', '−0.50', '–')
    """
    if value is None:
        return NONE
    if unit in ("share", "part"):
        return f"{100 * value:.0f} %"
    return f"{value:.3f} mm" if unit == "mm" else signed(value, 2)


def counted(estimate: Estimate) -> str:
    """Return a share of cases as their number.

    Examples
    --------
    >>> counted(Estimate(0.95, 0.76, 0.99, 20)), counted(Estimate(None, None, None, 0))
    ('19 of 20', 'no case')
    """
    if estimate.value is None:
        return "no case"
    return f"{round(estimate.value * estimate.count)} of {estimate.count}"


def cases(metric: Metric) -> str:
    """Return the number of cases behind a metric; of a share, also those that count."""
    if metric.unit == "share" and metric.estimate.count:
        return counted(metric.estimate)
    return str(metric.estimate.count)


RELIABILITY = ("gain of the first cause, nats", "right", "95 %", "cannot be told apart")


def reliability_cells(band: Band) -> tuple[str, ...]:
    """Return a row of the table of reliability.

    The last cell counts answers that cannot be told apart, with the right one among them.
    """
    gain = f"above {band.above:g}" if band.up_to is None else f"{band.above:g} to {band.up_to:g}"
    right = counted(band.named), interval(band.named, "share")
    return gain, *right, counted(band.unsure)


def comparison(metrics: Sequence[Metric]) -> str:
    """Return how often the diagnosis and the rule of the smallest residual are right, in words.

    Empty without a case to compare.
    """
    by_key = {metric.key: metric.estimate for metric in metrics}
    rule = by_key.get("baseline_refit_silent", NOTHING)
    if not rule.count:
        return ""
    return (
        f"One visible effect is named first by the diagnosis in {counted(by_key['first_visible'])} "
        f"cases, and by the smallest residual of one refit at a time, with as many false alarms, "
        f"in {counted(rule)}."
    )


def limit(metric: Metric) -> str:
    """Return a target as text.

    Examples
    --------
    >>> from palpate.service.blind.blind_metrics import Target
    >>> limit(Metric("k", "t", NOTHING, "share", Target(0.9, True), None))
    'at least 90 %'
    """
    if metric.target is None:
        return ""
    word = "at least" if metric.target.at_least else "at most"
    return f"{word} {shown(metric.target.value, metric.unit)}"


def interval(estimate: Estimate, unit: Unit) -> str:
    """Return an interval as text; empty if there is none."""
    if estimate.low is None or estimate.high is None or estimate.low >= estimate.high:
        return ""
    return f"{shown(estimate.low, unit)} to {shown(estimate.high, unit)}"


def asked_for(record: CaseRecord) -> str:
    """Return the truth of a case as text."""
    return together(record.effects) if record.effects else spoken(record.kind)


def answered(record: CaseRecord) -> str:
    """Return the answer to a case as text."""
    if not record.primary:
        return spoken(record.answer)
    others = [name for name in record.rivals if name not in record.primary]
    words = together(record.primary) + (f", or {together(others)}" if others else "")
    return f"{words} ({nats(record)} nats)" + (" and something else" * record.something_else)


def nats(record: CaseRecord) -> str:
    """Return the gain of the best single effect, without its unit."""
    return NONE if record.gain is None else f"{record.gain:.0f}"


def millimetres(value: float | None) -> str:
    """Return a gap without its interval."""
    return NONE if value is None else f"{value:.2f}"


BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"


def with_metrics(text: str, scored: ScoredSet) -> str:
    """Return `text` with the metrics between its two markers, replacing existing ones.

    Raises
    ------
    InputError
        If the markers are missing or in the wrong order.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise InputError(
            f"Expected a line {BEGIN} and, below it, a line {END}: figures go between them."
        )
    return f"{before}{BEGIN}\n{metrics_table(scored)}\n{END}{after}"


def metrics_table(scored: ScoredSet) -> str:
    """Return the metrics in Markdown, those with a target first, with their details."""
    lines = [f"{len(scored.records)} cases of {scored.name}.", ""]
    lines += ["| set | manifest | answers | code |", "|---|---|---|---|"]
    lines += [_sealed_line(seal) for seal in scored.seals] + [""]
    for reason in scored.declared:
        lines += [f"The diagnosis differs from the sealed one: {reason}", ""]
    lines += ["| figure | value | 95 % interval | cases | target | |", "|---|---|---|---|---|---|"]
    lines += [_markdown_row(metric_cells(f)) for f in scored.targets_first]
    if scored.floor_mm is not None:
        lines += ["", f"Floor: {scored.floor_mm:.3f} mm of true gap in the median control."]
    lines += ["", "| truth | first answer, correct ones in bold |", "|---|---|"]
    lines += _confusion_lines(scored.records)
    lines += ["", _markdown_row(RELIABILITY), "|---|---|---|---|"]
    lines += [_markdown_row(reliability_cells(band)) for band in reliability(scored.records)]
    lines += ["", comparison(scored.metrics)]
    lines += ["", "| wrong answer to | answer | true gap, mm | best gain, nats |"]
    lines += ["|---|---|---|---|"]
    return "\n".join([*lines, *_failure_lines(scored.records)])


def _sealed_line(one: Seals) -> str:
    hashes = one["manifest"], one["answers"], one["diagnosis"]["code"]
    return f"| {one['set']} | {' | '.join(f'`{h}`' for h in hashes)} |"


def _confusion_lines(records: Sequence[CaseRecord]) -> Iterator[str]:
    table = confusion(records)
    for row, (name, counts) in enumerate(zip(table.rows, table.counts, strict=True)):
        answers = [
            f"**{words}**" if (row, column) in table.right else words
            for column, (what, count) in enumerate(zip(table.columns, counts, strict=True))
            if count
            for words in (f"{spoken(what)} {count}",)
        ]
        yield f"| {' + '.join(map(spoken, name.split(' + ')))} | {', '.join(answers)} |"


def _failure_lines(records: Sequence[CaseRecord]) -> list[str]:
    return [
        _markdown_row((asked_for(r), answered(r), millimetres(r.true_before_mm), nats(r)))
        for r in sorted(records, key=asked_for)
        if not r.right
    ]


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def metric_cells(metric: Metric) -> tuple[str, ...]:
    """Return a row of the table of metrics: title, value, interval, cases, target, met."""
    met = {None: "", True: "met", False: "not met"}[metric.met]
    estimate = metric.estimate
    value, reach = shown(estimate.value, metric.unit), interval(estimate, metric.unit)
    return metric.title, value, reach, cases(metric), limit(metric), met


def render(scored: ScoredSet) -> str:
    """Return the page as text; equal scores give identical bytes."""
    return filled("blind.html.j2", context(scored), Path(__file__).parent)


def context(scored: ScoredSet) -> dict[str, Any]:
    """Return all values of the template."""
    records, metrics = scored.records, scored.metrics
    judged = [f for f in metrics if f.met is not None]
    met = sum(1 for f in judged if f.met)
    return {
        "name": scored.name,
        "verdict": f"{met} of {len(judged)} targets are met on {len(records)} cases.",
        "lead": _lead(scored),
        "tiles": _tiles(metrics),
        "declared": scored.declared,
        "judged": [(*metric_cells(f)[:5], f.met) for f in metrics if f.target is not None],
        "others": [metric_cells(f)[:4] for f in metrics if f.target is None],
        "confusion": _confusion_picture(records),
        "reliability": [RELIABILITY, *map(reliability_cells, reliability(records))],
        "comparison": comparison(metrics),
        "shrinkage": _shrinkage_picture(records),
        "gaps": _gap_picture(records, scored.floor_mm),
        "groups": [
            (title, sum(r.group == group for r in records)) for group, title in GROUPS.items()
        ],
        "failures": [_case(r) for r in records if not r.right],
        "cases": [_case(r) for r in records if r.right],
        "seals": scored.seals,
        "closing": f"Made by Palpate {palpate_version()}.",
    }


def _lead(scored: ScoredSet) -> str:
    floor = scored.floor_mm
    floor_text = (
        f"Without noise, the calibrated model of the median control still has a gap of {floor:.2f} "
        "mm, the floor. A gap counts as visible above 1.5 times the floor. "
        if floor is not None
        else ""
    )
    shown_scans = (
        "" if scored.seals[0]["directions"] == "all" else "Only scans pressed along y were shown. "
    )
    return (
        "Bodies were made by another solver and sealed before they were diagnosed; their causes "
        f"were known only to the maker. {shown_scans}{floor_text}Intervals are at 95 %."
    )


def _tiles(metrics: Sequence[Metric]) -> list[tuple[str, str, str]]:
    titles = {
        "false_alarms": "False alarms",
        "named_right": "Named effects that act",
        "first_visible": "Visible effects named first",
        "among_visible": "Named, or a rival",
    }
    by_key = {f.key: f.estimate for f in metrics}
    return [
        (title, shown(by_key[key].value, "share"), counted(by_key[key]))
        for key, title in titles.items()
    ]


def _case(record: CaseRecord) -> dict[str, Any]:
    return {
        "id": record.name,
        "truth": asked_for(record),
        "group": GROUPS[record.group],
        "answer": answered(record),
        "reason": record.reason.splitlines()[0] if record.reason else "",
        "true_gap": millimetres(record.true_before_mm),
        "claimed_gap": millimetres(record.claimed_before_mm),
        "true_after": millimetres(record.true_after_mm),
    }


def _confusion_picture(records: Sequence[CaseRecord]) -> Picture:
    table = confusion(records)
    right = sum(r.right for r in records)
    return picture(
        blind_charts.heat_map(table),
        f"Answers to {len(records)} cases of {len(table.rows)} kinds; {right} are correct.",
        "Rows: truth. Columns: first answer. Correct answers have a frame.",
    )


def _shrinkage_picture(records: Sequence[CaseRecord]) -> Picture:
    held_out = both_known(records, lambda r: r.held_out_share, lambda r: r.true_share)
    inside = both_known(records, lambda r: r.claimed_share, lambda r: r.true_share)
    return picture(
        blind_charts.shrinkage(held_out, inside),
        f"Claimed against true shrinkage of {len(inside)} cases.",
        "Reduction of the squared gap by the named effects.",
    )


def _gap_picture(records: Sequence[CaseRecord], floor: float | None) -> Picture:
    before = both_known(records, lambda r: r.claimed_before_mm, lambda r: r.true_before_mm)
    after = both_known(records, lambda r: r.claimed_after_mm, lambda r: r.true_after_mm)
    return picture(
        blind_charts.gaps(before, after, floor),
        f"Claimed against true gap of {len(before)} cases.",
        "Root mean square distance beyond noise: claimed against noise-free.",
    )
