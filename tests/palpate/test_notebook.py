"""The example notebooks run completely and give the documented results."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).parents[2] / "examples"
THREADS = "ignore::DeprecationWarning", "ignore::ResourceWarning"


def text_of(notebook: nbformat.NotebookNode) -> str:
    """Return all text output of the cells."""
    parts = []
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            parts.append(str(output.get("text", "")))
            parts.append(str(output.get("data", {}).get("text/plain", "")))
    return "\n".join(parts)


def executed(name: str, folder: Path) -> nbformat.NotebookNode:
    """Return an example notebook, executed in a folder."""
    notebook = nbformat.read(EXAMPLES / name, as_version=4)
    resources = {"metadata": {"path": str(folder)}}
    return NotebookClient(notebook, timeout=280, resources=resources).execute()


def pictures_in(notebook: nbformat.NotebookNode) -> int:
    """Return the number of pictures in the output."""
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", ())]
    return sum("image/png" in o.get("data", {}) for o in outputs)


@pytest.mark.filterwarnings(*THREADS)
def test_one_simulation_a_batch_and_a_study_fit_in_25_lines(tmp_path: Path) -> None:
    notebook = executed("sensitivity.ipynb", tmp_path)
    sources = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    assert sum(bool(line) for source in sources for line in source.split("\n")) <= 25
    assert pictures_in(notebook) == 2
    text = text_of(notebook)
    found = re.findall(r"E_\w+ [\d.]+ \(([\d.]+), ([\d.]+)\) kPa True", text)
    (fat, gland) = [(float(low), float(high)) for low, high in found]
    assert fat[0] < 10 < fat[1]
    assert gland[0] < 40 < gland[1]
    indices = re.findall(r"^E_\w+ +([\d.]+) +[\d.]+$", text, re.MULTILINE)
    assert all(0.2 < float(index) < 1.5 for index in indices)
    assert len(indices) == 2


@pytest.mark.slow
@pytest.mark.filterwarnings(*THREADS)
def test_the_notebook_runs_and_finds_the_constants(tmp_path: Path) -> None:
    notebook = executed("study.ipynb", tmp_path)
    text = text_of(notebook)
    assert "sead" in text
    assert "seed" in text  # the nearest known key is suggested
    errors = [float(error) for error in re.findall(r"error ([\d.]+)%", text)]
    assert len(errors) == 2
    # Sixteen candidates in four generations; the fat carries most of the load.
    assert errors[0] < 10
    assert pictures_in(notebook) == 2
