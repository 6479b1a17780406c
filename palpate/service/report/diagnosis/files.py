"""Files of a diagnosis: the record for programs, and the page for readers."""

import json
from pathlib import Path

from palpate.service.diagnosis.quotability import summary_json
from palpate.service.diagnosis.run import FinishedDiagnosis
from palpate.service.report.diagnosis.made import Origin
from palpate.service.report.diagnosis.page import render
from palpate.storage.backends.atomic import explained, write_file
from palpate.storage.plain import to_plain


def write_diagnosis(
    diagnosis: FinishedDiagnosis, folder: Path, origin: Origin | None = None
) -> Path:
    """Write ``diagnosis.json`` and ``diagnosis.html``; return the path of the page.

    Parameters
    ----------
    diagnosis : FinishedDiagnosis
    folder : Path
        Created if missing.
    origin : Origin, optional
        Provenance of the diagnosis, if known.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    plain = to_plain(summary_json(diagnosis.summary))
    text = json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)
    write_file(folder / "diagnosis.json", text.encode() + b"\n")
    page = folder / "diagnosis.html"
    write_file(page, render(diagnosis, origin).encode())
    return page
