"""Metrics as a Markdown table, inserted into a document."""

from collections.abc import Iterator, Sequence

from palpate.service.blind.report.words import (
    answered,
    asked_for,
    interval,
    limit,
    millimetres,
    shown,
)
from palpate.service.blind.scoring.calibration import calibration_curve
from palpate.service.blind.scoring.confusion import confusion
from palpate.service.blind.scoring.metrics import Metric
from palpate.service.blind.scoring.scored_set import ScoredSet, Seals
from palpate.service.blind.sealed.records import CaseRecord
from palpate.service.diagnosis.words import spoken
from palpate.service.formatting import NONE
from palpate.storage.errors import InputError

BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"


def filled(text: str, scored: ScoredSet) -> str:
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
    return f"{before}{BEGIN}\n{table(scored)}\n{END}{after}"


def table(scored: ScoredSet) -> str:
    """Return the metrics in Markdown, those with a target first, with their details."""
    lines = [f"{len(scored.records)} cases of {scored.name}.", ""]
    lines += ["| set | manifest | answers | code |", "|---|---|---|---|"]
    lines += [_sealed(one) for one in scored.seals] + [""]
    for reason in scored.declared:
        lines += [f"The diagnosis differs from the sealed one: {reason}", ""]
    lines += ["| figure | value | 95 % interval | cases | target | |", "|---|---|---|---|---|---|"]
    lines += [_row(f) for f in scored.targets_first]
    if scored.floor_mm is not None:
        lines += ["", f"Floor: {scored.floor_mm:.3f} mm of true gap in the median control."]
    lines += ["", "| truth | first answer, correct ones in bold |", "|---|---|"]
    lines += _confusions(scored.records)
    lines += ["", "| stated probability | statements | true |", "|---|---|---|"]
    lines += _calibration(scored.records)
    lines += ["", "| wrong answer to | answer | true gap, mm | evidence of a gap |"]
    lines += ["|---|---|---|---|"]
    return "\n".join([*lines, *_failures(scored.records)])


def _sealed(one: Seals) -> str:
    hashes = one["manifest"], one["answers"], one["diagnosis"]["code"]
    return f"| {one['set']} | {' | '.join(f'`{h}`' for h in hashes)} |"


def _confusions(records: Sequence[CaseRecord]) -> Iterator[str]:
    table = confusion(records)
    for row, (name, counts) in enumerate(zip(table.rows, table.counts, strict=True)):
        answers = [
            f"**{words}**" if (row, column) in table.right else words
            for column, (what, count) in enumerate(zip(table.columns, counts, strict=True))
            if count
            for words in (f"{spoken(what)} {count}",)
        ]
        yield f"| {' + '.join(map(spoken, name.split(' + ')))} | {', '.join(answers)} |"


def _calibration(records: Sequence[CaseRecord]) -> Iterator[str]:
    for b in calibration_curve(records):
        if b.came_true.count:
            true = shown(b.came_true.value, "share")
            yield f"| {b.low:.1f} to {b.high:.1f} | {b.came_true.count} | {true} |"


def _failures(records: Sequence[CaseRecord]) -> list[str]:
    return [
        f"| {asked_for(r)} | {answered(r)} | {millimetres(r.true_before_mm)} "
        f"| {NONE if r.alarm is None else f'{r.alarm:.1f}'} |"
        for r in sorted(records, key=asked_for)
        if not r.right
    ]


def _row(metric: Metric) -> str:
    estimate = metric.estimate
    met = {None: "", True: "met", False: "not met"}[metric.met]
    value = shown(estimate.value, metric.unit)
    cells = [metric.title, value, interval(metric), str(estimate.count), limit(metric), met]
    return f"| {' | '.join(cells)} |"
