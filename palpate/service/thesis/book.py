"""The experiments as one self-contained page, with a chapter for each."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palpate.service.formatting import count, duration
from palpate.service.report.page.template import filled
from palpate.service.thesis import printed
from palpate.service.thesis.chapters import coefficients, mammograms, meshes, search, sensitivity
from palpate.service.thesis.page import Chapter
from palpate.service.thesis.results import ThesisResults
from palpate.service.thesis.verdict import Verdict
from palpate.service.thesis.verdicts import verdicts
from palpate.service.versions import palpate_version

SCALES = {
    "sketch": "A sketch: coarse voxels, few candidates, two phantoms. Its numbers mean little.",
    "reduced": "Reduced scale: bodies of one eighth of the volume, 5,000 nodes in the searches.",
    "full": "The thesis' own scale.",
}
WORDS = {
    "reproduced": "reproduced",
    "approached": "approached",
    "not reproduced": "not reproduced",
    "cannot be": "cannot be compared",
    "not run": "not run",
}


def render(results: ThesisResults, store: str) -> str:
    """Return the page as text; the pictures of bodies are read from the store."""
    return filled("book.html.j2", context(results, store), Path(__file__).parent)


def chapters_of(results: ThesisResults, store: str) -> list[Chapter]:
    """Return a chapter for each experiment that has results."""
    costs, scale = results.costs, results.scale
    made = []
    if results.coefficients is not None:
        made.append(coefficients.chapter(results.coefficients, costs.get("coefficients")))
    if results.meshes is not None:
        cost = costs.get("mesh-quality")
        made.append(meshes.chapter(results.meshes, cost, store, scale))
    if results.mammograms:
        cost = costs.get("mammogram")
        made.append(mammograms.chapter(results.mammograms, cost, store, scale))
    if results.search is not None and results.search.searches:
        made.append(search.chapter(results.search, costs.get("search"), scale))
    if results.sensitivity is not None:
        made.append(sensitivity.chapter(results.sensitivity, costs.get("sensitivity")))
    return made


def context(results: ThesisResults, store: str) -> dict[str, Any]:
    """Return all values of the template."""
    chapters = chapters_of(results, store)
    judged = verdicts(results)
    ran = [v for v in judged if v.word != "not run"]
    return {
        "title": chapters[0].title if len(chapters) == 1 else "The thesis, reproduced",
        "verdict": _headline(ran),
        "lead": (
            "M. A. Lago, A new approach for the in-vivo characterization of the biomechanical "
            "behavior of the breast and the cornea, UPV 2014, chapters 3 and 4. "
            + SCALES[results.scale]
        ),
        "tiles": _tiles(results, ran),
        "chapters": chapters,
        "verdicts": ran,
        "words": WORDS,
        "closing": f"Made by Palpate {palpate_version()} on {results.machine}.",
    }


def _headline(judged: Sequence[Verdict]) -> str:
    counts = Counter(v.word for v in judged)
    comparable = sum(n for word, n in counts.items() if word != "cannot be")
    return (
        f"{counts['reproduced']} reproduced or bettered, {counts['approached']} approached, "
        f"{counts['not reproduced']} not reproduced, of {comparable} comparable numbers and "
        f"statements; {counts['cannot be']} cannot be compared."
    )


def _tiles(results: ThesisResults, judged: Sequence[Verdict]) -> list[tuple[str, str, str]]:
    cpu_s = sum(cost.cpu_s for cost in results.costs.values())
    good = sum(v.word == "reproduced" for v in judged)
    tiles = [
        ("Reproduced or bettered", str(good), f"of {len(judged)}"),
        ("Total time", duration(cpu_s), "of one core"),
    ]
    if results.search is not None and results.search.searches:
        found = results.search.searches
        mean = sum(s.cpu_s for s in found) / len(found)
        core_hours = printed.HOURS * printed.CORES
        tiles.append(("One search", duration(mean), "of one worker"))
        tiles.append(("In the thesis", count(round(core_hours)), "core hours"))
    return tiles
