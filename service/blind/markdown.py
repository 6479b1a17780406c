"""Figures as a table in a text that is kept with the code."""

from service.blind.page import Scored
from service.blind.scores import Figure
from service.blind.words import interval, limit, shown
from storage.errors import InputError

BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"


def filled(text: str, scored: Scored) -> str:
    """`text` with the figures between its two marks, in place of what stood there.

    Raises
    ------
    InputError
        If the marks are missing or in the wrong order.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise InputError(
            f"Expected a line {BEGIN} and, below it, a line {END}: figures go between them."
        )
    return f"{before}{BEGIN}\n{table(scored)}\n{END}{after}"


def table(scored: Scored) -> str:
    """The figures in Markdown, those with a target first, and what they rest on."""
    seals = scored.seals
    lines = [
        f"{len(scored.records)} cases of the set {scored.name}. Manifest `{seals['manifest']}`, "
        f"answers `{seals['answers']}`, code `{seals['diagnosis']['code']}`.",
        "",
    ]
    if seals["declared"]:
        lines += [f"The diagnosis is not the one that was sealed: {seals['declared']}", ""]
    lines += ["| figure | value | 95 % interval | cases | target | |", "|---|---|---|---|---|---|"]
    lines += [_row(f) for f in sorted(scored.figures, key=lambda f: f.target is None)]
    if scored.floor_mm is not None:
        lines += ["", f"Floor: {scored.floor_mm:.3f} mm of true gap in the median control."]
    return "\n".join(lines)


def _row(figure: Figure) -> str:
    found = figure.estimate
    met = {None: "", True: "met", False: "not met"}[figure.met]
    value = shown(found.value, figure.unit)
    cells = [figure.title, value, interval(figure), str(found.count), limit(figure), met]
    return f"| {' | '.join(cells)} |"
