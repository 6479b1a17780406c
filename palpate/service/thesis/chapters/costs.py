"""The cost of an experiment, next to the cost printed in the thesis."""

from palpate.service.formatting import count, duration
from palpate.service.thesis.results import Cost


def cost_rows(cost: Cost | None, thesis: str) -> list[tuple[str, str]]:
    """Return the lines on a chapter's cost."""
    rows = [("the thesis", thesis)]
    if cost is not None:
        rows.append(("Palpate, processor time", duration(cost.cpu_s)))
        rows.append(("parts", f"{count(cost.parts)}, the longest {duration(cost.longest_s)}"))
        rows.append(("on", cost.machine))
    return rows
