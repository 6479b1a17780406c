"""Output of the results: the page, the record, the mammograms as files."""

import json
from io import BytesIO
from pathlib import Path

from matplotlib.image import imsave

from palpate.service.thesis.book import render
from palpate.service.thesis.experiments import exposures
from palpate.service.thesis.results import ThesisResults
from palpate.service.thesis.run import ThesisRequest
from palpate.storage.backends.atomic import explained, write_file
from palpate.storage.plain import to_plain
from palpate.storage.records.typed_json import to_json
from palpate.workers.tasks.thesis.mammograms import ExposedPhantom


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
    for one in exposures(str(request.store), request.scale):
        record, arrays = one.part.load(ExposedPhantom)
        if not record.converged:
            continue
        stem = f"phantom-{one.phantom}-{one.view}"
        for kind in ("adaptive", "homogeneous", "difference"):
            write_file(folder / f"{stem}-{kind}.png", png_bytes(arrays[kind]))
        for kind in ("adaptive", "homogeneous"):
            write_file(folder / f"{stem}-{kind}.dcm", arrays[f"{kind}_dicom"].tobytes())


def png_bytes(grey: object) -> bytes:
    """Return the content of a PNG file of 8-bit grey values, shape (rows, columns)."""
    file = BytesIO()
    imsave(file, grey, cmap="gray", vmin=0, vmax=255, format="png")  # type: ignore[arg-type]
    return file.getvalue()
