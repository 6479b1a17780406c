"""Output of the experiments: a self-contained page with a chapter for each, and files beside it.

The record and the mammograms are written as files.
"""

import json
from collections import Counter
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.image import imsave

from palpate.service.installed_packages import palpate_version
from palpate.service.number_formatting import count, duration
from palpate.service.report.page.page_elements import filled
from palpate.service.thesis import (
    coefficient_chapter,
    cornea_chapter,
    mammogram_chapter,
    mesh_chapter,
    printed_results,
    search_chapter,
)
from palpate.service.thesis.chapter_elements import Chapter
from palpate.service.thesis.thesis_experiments import ThesisRequest, exposures
from palpate.service.thesis.thesis_results import ThesisResults
from palpate.service.thesis.thesis_verdicts import Verdict, verdicts
from palpate.storage.backends.atomic_files import explained, write_file
from palpate.storage.json_digests import to_json, to_plain
from palpate.workers.tasks.thesis_tasks import ExposedPhantom

SCALE_WORDS = {
    "sketch": "A sketch: coarse voxels, few candidates, two phantoms. Its numbers mean little.",
    "reduced": "Reduced scale: bodies of one eighth of the volume, 5,000 nodes in the searches.",
    "full": "The thesis' own scale.",
}
VERDICT_WORDS = {
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
        made.append(coefficient_chapter.chapter(results.coefficients, costs.get("coefficients")))
    if results.meshes is not None:
        cost = costs.get("mesh-quality")
        made.append(mesh_chapter.chapter(results.meshes, cost, store, scale))
    if results.mammograms:
        cost = costs.get("mammogram")
        made.append(mammogram_chapter.chapter(results.mammograms, cost, store, scale))
    if results.search is not None and results.search.searches:
        made.append(search_chapter.search_chapter(results.search, costs.get("search"), scale))
    if results.sensitivity is not None:
        made.append(
            search_chapter.sensitivity_chapter(results.sensitivity, costs.get("sensitivity"))
        )
    if results.cornea is not None:
        made.append(cornea_chapter.chapter(results.cornea, costs.get("cornea"), scale))
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
            "behavior of the breast and the cornea, UPV 2014, chapters 3 to 5. "
            + SCALE_WORDS[results.scale]
        ),
        "tiles": _tiles(results, ran),
        "chapters": chapters,
        "verdicts": ran,
        "words": VERDICT_WORDS,
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
        searches = results.search.searches
        mean = sum(s.cpu_s for s in searches) / len(searches)
        core_hours = printed_results.HOURS * printed_results.CORES
        tiles.append(("One search", duration(mean), "of one worker"))
        tiles.append(("In the thesis", count(round(core_hours)), "core hours"))
    return tiles


def write_all(results: ThesisResults, request: ThesisRequest, name: str) -> Path:
    """Write page, record and mammograms below the folder of the request.

    Parameters
    ----------
    results : ThesisResults
    request : ThesisRequest
    name : str
        Name of page and record, without suffix; a scale other than reduced is appended.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StoreError
        If the folder cannot be written.
    """
    folder = request.folder
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    stem = name if request.scale == "reduced" else f"{name}-{request.scale}"
    plain = to_plain(to_json(results))
    text = json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)
    write_file(folder / f"{stem}.json", text.encode() + b"\n")
    if results.mammograms is not None:
        _write_mammograms(request, folder / "mammograms" / request.scale)
    page = folder / f"{stem}.html"
    write_file(page, render(results, str(request.store)).encode())
    return page


def _write_mammograms(request: ThesisRequest, folder: Path) -> None:
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for exposure in exposures(str(request.store), request.scale):
        record, arrays = exposure.part.load(ExposedPhantom)
        if not record.converged:
            continue
        stem = f"phantom-{exposure.phantom}-{exposure.view}"
        for kind in ("adaptive", "homogeneous", "difference"):
            write_file(folder / f"{stem}-{kind}.png", png_bytes(arrays[kind]))
        for kind in ("adaptive", "homogeneous"):
            write_file(folder / f"{stem}-{kind}.dcm", arrays[f"{kind}_dicom"].tobytes())


def png_bytes(grey: object) -> bytes:
    """Return the content of a PNG file of 8-bit grey values, shape (rows, columns)."""
    file = BytesIO()
    imsave(file, grey, cmap="gray", vmin=0, vmax=255, format="png")  # type: ignore[arg-type]
    return file.getvalue()
