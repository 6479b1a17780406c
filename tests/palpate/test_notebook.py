"""The notebook of the examples runs from top to bottom and finds what it says."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).parents[2] / "examples" / "study.ipynb"


def text_of(notebook: nbformat.NotebookNode) -> str:
    """Return all text that the cells have printed or returned."""
    parts = []
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            parts.append(str(output.get("text", "")))
            parts.append(str(output.get("data", {}).get("text/plain", "")))
    return "\n".join(parts)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_the_notebook_runs_and_finds_the_constants(tmp_path: Path) -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = NotebookClient(notebook, timeout=280, resources={"metadata": {"path": str(tmp_path)}})
    text = text_of(client.execute())
    assert "sead" in text
    assert "seed" in text  # the nearest known key is suggested
    errors = [float(error) for error in re.findall(r"error ([\d.]+)%", text)]
    assert len(errors) == 2
    # Sixteen candidates in four generations; the fat carries most of the load.
    assert errors[0] < 10
    pictures = [
        o
        for cell in notebook.cells
        for o in cell.get("outputs", ())
        if "image/png" in o.get("data", {})
    ]
    assert len(pictures) == 2
