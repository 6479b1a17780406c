"""Reports of a real study: finished, cut off anywhere, and with volumes lost."""

import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from palpate.service.cluster.task_dispatch import Dispatcher, Ending
from palpate.service.report.study.study_page import write_report
from palpate.service.results.results_as_json import study_json
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.loop import Conclusion, Study
from palpate.service.study.study_keys import parse_spec
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from tests.recovery.stand_ins import rewrite
from tests.service.report.pages import Page

SPEC = """
name: small
case:
  reference: {phantom: {preset: 445ml, spacing_mm: 2.0, seed: 1}}
  mesh: {nodes: 850}
  load: {force_n: 30}
target:
  constants: {E_fat_kpa: 10, E_glandular_kpa: 40}
search:
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
  population: 5
  generations: 2
"""


class Here(Dispatcher):
    """A runner of tasks in this process."""

    threads = 1

    def __init__(self) -> None:
        """Do nothing; no client is needed."""

    def call(self, task: Callable[..., Any], *arguments: Any) -> Any:
        return task(*arguments)

    def run(
        self, task: Callable[..., Any], calls: Iterable[tuple[Any, tuple[Any, ...]]]
    ) -> Iterator[Ending]:
        for key, arguments in calls:
            yield Ending(key, "returned", task(*arguments))


Made = tuple[Path, Conclusion]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("runs") / "small"
    spec = parse_spec(SPEC, "small.yaml", folder.parent)
    return folder, Study(spec, folder).run(Here())


def copied(made: Made, tmp_path: Path) -> Path:
    """Provide the study, moved together with its store."""
    here = tmp_path / "runs"
    shutil.copytree(made[0].parent, here)
    journal = here / "small" / "journal.jsonl"
    text = journal.read_text().replace(str(made[0].parent), str(here))
    rewrite(journal, [json.loads(line) for line in text.splitlines()])
    (here / "small" / "report.html").unlink(missing_ok=True)
    return here / "small"


def test_the_report_of_a_study_shows_its_results(made: Made) -> None:
    folder, conclusion = made
    path = write_report(folder)
    assert path == folder / "report.html"
    assert [p.name for p in folder.glob(".tmp*")] == []
    page = Page(path.read_text())
    # Ranges, sections, search, scatter, stages.
    assert len(page.drawings()) == 1 + 3 * 4 + 1 + 2 + 1
    found = study_json(study_results(folder))
    shown = json.JSONDecoder().raw_decode(page.text, page.text.index('{ "study": "small"'))[0]
    assert shown == found
    best = conclusion.best
    assert best is not None
    assert best.score is not None
    for symbol, name in (("Efat", "E_fat_kpa"), ("Eglandular", "E_glandular_kpa")):
        assert page.row(symbol)[1] == f"{best.genes[name]:.3g}"
    assert page.row("glandular")[1].endswith(f"→ {best.score['jc']:.4g}")
    for tissue, score in found["per_label"].items():
        assert page.row(tissue)[1].endswith(f"→ {score['jc']:.4g}")


def test_recomputes_best_volume_from_displacements(made: Made, tmp_path: Path) -> None:
    folder = copied(made, tmp_path)
    whole = write_report(folder).read_bytes()
    assert made[1].best is not None
    shutil.rmtree(open_store(folder.parent / "store").layout.volume(made[1].best.digest))
    assert write_report(folder).read_bytes() == whole


def test_a_store_that_moved_with_its_study_is_found(made: Made, tmp_path: Path) -> None:
    folder = copied(made, tmp_path)
    moved = tmp_path / "elsewhere"
    folder.parent.rename(moved)
    page = Page(write_report(moved / "small").read_text())
    assert "The store cannot be read" not in page.text
    assert "Best candidate" in page.text


def test_report_without_store_has_results_but_no_pictures_of_bodies(
    made: Made, tmp_path: Path
) -> None:
    folder = copied(made, tmp_path)
    shutil.rmtree(folder.parent / "store")
    page = Page(write_report(folder).read_text())
    assert "The store cannot be read, so there are no pictures" in page.text
    assert len(page.drawings()) == 1 + 1 + 2 + 1
    assert page.row("glandular")[1] != "–"  # the journal has the scores of the best


def test_reports_missing_target(made: Made, tmp_path: Path) -> None:
    folder = copied(made, tmp_path)
    target = study_target(folder)
    shutil.rmtree(open_store(folder.parent / "store").layout.volume(target))
    assert (
        "The volume of the target is no longer in the store"
        in Page(write_report(folder).read_text()).text
    )


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (1, "have not been prepared yet"),
        (2, "No candidate has a score yet, so there is no best candidate to show"),
        (4, "0 complete generations of 5 candidates"),
        (-1, "Running it again continues it"),
    ],
)
def test_a_journal_cut_off_anywhere_gives_a_report(
    made: Made, tmp_path: Path, lines: int, said: str
) -> None:
    folder = copied(made, tmp_path)
    journal = folder / "journal.jsonl"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:lines]))
    page = Page(write_report(folder).read_text())
    assert said in page.text
    assert "interrupted" in page.text


def test_rejects_folder_without_study(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="palpate run"):
        write_report(tmp_path)
    assert list(tmp_path.iterdir()) == []


def study_target(folder: Path) -> str:
    lines = (json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines())
    return next(str(line["target"]["target"]) for line in lines if line["kind"] == "session")
