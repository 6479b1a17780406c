"""Completed studies, diagnoses and volumes in a notebook."""

import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

import palpate
from palpate.workers.diagnosis.outcome.diagnosis_summary import (
    ConfoundedEffect,
    JointFitSummary,
    MarkerResidual,
    MarkerState,
    NextAcquisition,
    PredictedPoint,
    PredictedState,
    Reaction,
)
from tests.recovery.stand_ins import Inline, run, small_spec
from tests.recovery.test_strategies import spec_of
from tests.service.report.diagnosis_at_hand import VERDICTS, found
from tests.service.report.pages import Page
from tests.service.report.study_data_at_hand import BODIES, study_data

Folders = dict[str, Path]
HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "results-in-python.md"
BLOCK = re.compile(r"(?:<!-- needs (\w+) -->\n)?```python\n(.*?)^```", re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    """A study that has converged, and one that has not."""
    root = tmp_path_factory.mktemp("results") / "runs"
    run(root / "fitted", Inline(), spec_of("least-squares"))
    run(root / "searched", Inline(), small_spec())
    return {name: root / name for name in ("fitted", "searched")}


def diagnosis(which: str = "effect") -> palpate.Diagnosis:
    made = found(VERDICTS[which])
    return palpate.Diagnosis(made.summary, made.maps, made.scans)


def test_estimate_has_interval_unit_and_quotability(folders: Folders) -> None:
    fat = palpate.Study.open(folders["fitted"]).results.estimates["E_fat"]
    assert fat.interval is not None and fat.estimate is not None
    assert fat.interval[0] < fat.estimate < fat.interval[1]
    assert (fat.unit, fat.quotable, fat.reasons) == ("kPa", True, ())
    early = palpate.Study.open(folders["searched"]).results.estimates["E_fat"]
    assert (early.interval, early.quotable) == (None, False)
    assert early.reasons == ("the search has not converged",)


def test_results_provide_samples(folders: Folders) -> None:
    results = palpate.Study.open(folders["fitted"]).results
    assert len(results.samples(40)["E_fat_kpa"]) == 40
    with pytest.raises(palpate.InputError, match="has not converged"):
        palpate.Study.open(folders["searched"]).results.samples()


def test_the_how_to_runs_as_printed(
    folders: Folders, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "runs").mkdir()
    for name, folder in zip(("a", "b"), folders.values(), strict=True):
        shutil.copytree(folder, tmp_path / "runs" / name)
    monkeypatch.chdir(tmp_path)
    here: dict[str, Any] = {}
    blocks = BLOCK.findall(HOW_TO.read_text())
    assert len(blocks) == 6
    for mark, text in blocks:
        if mark == "volumes" or (mark == "pandas" and find_spec("pandas") is None):
            continue
        exec(compile(text, HOW_TO.name, "exec"), here)
    assert {path.name for path in tmp_path.iterdir()} == {"corner.png", "comparison.html", "runs"}


def public_objects(folders: Folders) -> dict[str, Any]:
    study = palpate.Study.open(folders["fitted"])
    searched = palpate.Study.open(folders["searched"])
    grey = palpate.Volume(np.linspace(0, 1, 4 * 5 * 6).reshape(4, 5, 6), (1.0, 1.0, 2.0))
    assert BODIES.target is not None
    return {
        "study": study,
        "study that has not begun": palpate.Study(study.spec, folders["fitted"].parent / "no"),
        "study file": study.spec,
        "results": study.results,
        "results without intervals": searched.results,
        "estimate": study.results.estimates["E_fat"],
        "estimate that cannot be quoted": searched.results.estimates["E_fat"],
        "samples": study.results.samples(10),
        "labels": palpate.Volume.of(BODIES.target),
        "grey values": grey,
        "comparison": palpate.compare(study, searched),
        **{f"diagnosis: {name}": diagnosis(name) for name in VERDICTS},
    }


def test_public_objects_have_short_repr(folders: Folders) -> None:
    for name, value in public_objects(folders).items():
        assert len(repr(value)) < 500, name
        assert repr(value).startswith("<"), name


def measured() -> palpate.Diagnosis:
    """A diagnosis of a bench test with many markers, with every part of the record filled."""
    made = found(VERDICTS["not told apart"])
    three = (1.0, 2.0, 3.0)
    points = (MarkerResidual("M", three, three, three),) * 40
    reactions = (Reaction("top", "z", 1.0, 0.1),) * 9
    predicted = PredictedState("next", (PredictedPoint("M", three, three),) * 40, reactions)
    names = [f"effect_{number}" for number in range(40)]
    sizes = {name: {"E_kpa": 100.0} for name in names}
    summary = replace(
        made.summary,
        primary=tuple(names),
        rivals=tuple(names),
        effects=tuple(replace(made.summary.effects[0], name=name) for name in names),
        markers=(MarkerState("pulled", None, points),),
        predictions=(predicted,),
        hidden=(ConfoundedEffect("wall", {"wall_kpa": 1.0}, sizes),),
        refits=(JointFitSummary(tuple(names), 3.0, None, True, dict.fromkeys(names, 1.0)),),
        next_acquisitions=(NextAcquisition("turned", (tuple(names),) * 9, tuple(names), 0.5),),
    )
    return palpate.Diagnosis(summary, made.maps, made.scans)


def parts(name: str, value: Any, deep: int = 4) -> Iterator[tuple[str, Any]]:
    """Yield the project's objects reachable from an object through public attributes."""
    if isinstance(value, dict | tuple | list):
        items = value.items() if isinstance(value, dict) else enumerate(value[:3])
        for key, one in items:
            yield from parts(f"{name}[{key}]", one, deep)
    elif type(value).__module__.startswith("palpate") and not callable(value):
        yield name, value
        fields_of = type(value).model_fields if isinstance(value, BaseModel) else dir(value)
        for attribute in fields_of if deep else ():
            if not attribute.startswith("_"):
                with suppress(palpate.PalpateError):  # a study that has not begun has no results
                    yield from parts(f"{name}.{attribute}", getattr(value, attribute), deep - 1)


def test_reachable_objects_have_short_repr(folders: Folders) -> None:
    lengths = {
        path: len(repr(part))
        for name, value in (public_objects(folders) | {"bench": measured()}).items()
        for path, part in parts(name, value)
    }
    for path in ("results.best", "bench.summary.markers[0]", "results.identification"):
        assert path in lengths
    assert {path: length for path, length in lengths.items() if length >= 500} == {}


def test_public_objects_are_shown_as_html(folders: Folders) -> None:
    without = {"study file", "samples"}
    for name, value in public_objects(folders).items():
        if name not in without:
            html = value._repr_html_()
            assert type(html) is str  # no markup, which escapes what it is added to
            page = Page(html)
            assert page.text, name
            assert not page.addresses or set("data:") <= set(page.addresses[0])
    shown = Page(palpate.Study.open(folders["searched"]).results._repr_html_())
    assert shown.row("Efat")[4] == "no: the search has not converged"


def test_a_volume_is_shown_as_sections_with_their_proportions() -> None:
    assert BODIES.target is not None
    volume = palpate.Volume.of(BODIES.target)
    images = Page(volume._repr_html_()).images
    assert [image["alt"][:2] for image in images] == ["xy", "zy", "xz"]
    x, y, _ = volume.shape_xyz
    assert int(images[0]["width"]) == 150
    assert int(images[0]["height"]) == round(150 * y / x)
    flat = palpate.Volume(volume.values[:1], volume.spacing_mm)
    assert len(Page(flat._repr_html_()).images) == 1


def test_results_agree_with_journal(folders: Folders) -> None:
    results = palpate.Study.open(folders["fitted"]).results
    assert isinstance(results, palpate.StudyResults)
    assert {one.name for one in fields(results)} <= set(dir(results))


@pytest.mark.parametrize("plot", ["plot_convergence", "plot_posterior"])
def test_figures_are_shown_without_pyplot(folders: Folders, plot: str) -> None:
    drawn = getattr(palpate.Study.open(folders["fitted"]).results, plot)()
    assert drawn._repr_png_().startswith(b"\x89PNG")
    assert drawn.get_facecolor() == (1.0, 1.0, 1.0, 1.0)


def test_convergence_shows_every_evaluation(folders: Folders) -> None:
    study = palpate.Study.open(folders["searched"])
    (axes,) = study.results.plot_convergence().axes
    lines = {str(line.get_label()): line for line in axes.get_lines()}
    gsf = study.candidates()["gsf"]
    assert len(lines["evaluation"].get_xdata()) == np.isfinite(gsf).sum()
    assert len(lines["failed"].get_xdata()) == np.isnan(gsf).sum() > 0
    lowest = np.asarray(lines["lowest so far"].get_ydata())
    assert np.all(np.diff(lowest) <= 0)
    assert lowest[-1] == np.nanmin(gsf)


def test_slices_show_all_bodies(folders: Folders, monkeypatch: pytest.MonkeyPatch) -> None:
    results = palpate.Study.open(folders["fitted"]).results
    with pytest.raises(palpate.InputError, match="no longer in the store"):
        results.plot_slices()
    from palpate.service.report import notebook_figures

    monkeypatch.setattr(notebook_figures, "read_study_data", lambda *_, **__: study_data())
    drawn = results.plot_slices("sagittal")
    titles = [axes.get_title() for axes in drawn.axes]
    assert titles == ["Undeformed", "Target", "Best candidate", "Difference, glandular"]
    assert drawn.axes[0].get_ylabel() == "z, mm"
    with pytest.raises(palpate.InputError, match="coronal, transverse, sagittal"):
        results.plot_slices("axial")  # type: ignore[arg-type]


@pytest.mark.parametrize("which", ["effect", "no gap", "one scan"])
def test_the_gap_is_drawn_with_and_without_the_cause(which: str) -> None:
    made = diagnosis(which)
    bars, residuals = made.plot_gap().axes
    legend = bars.get_legend()
    assert legend is not None
    texts = {text.get_text() for text in legend.get_texts()}
    assert ("with plate tilt" in texts) == bool(made.summary.primary)
    assert residuals.get_title(loc="left") == "24 residuals"


def test_rejects_table_without_pandas(folders: Folders, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    results = palpate.Study.open(folders["fitted"]).results
    with pytest.raises(palpate.InputError, match=re.escape("pip install 'palpate[data]'")):
        results.to_frame()
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(palpate.InputError, match="xarray, which is not installed"):
        results.samples(5).to_xarray()


def test_tables_have_a_row_for_each_evaluation_generation_and_constant(folders: Folders) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed: pip install .[data]")
    study = palpate.Study.open(folders["searched"])
    evaluations = study.results.to_frame()
    assert evaluations.equals(study.table())
    assert list(evaluations.index) == list(study.candidates()["candidate"])
    generations = study.results.to_frame("generations")
    assert len(generations) == 5
    assert generations["best"].is_monotonic_decreasing
    estimates = study.results.to_frame("estimates")
    assert list(estimates.index) == ["E_fat_kpa", "E_glandular_kpa"]
    assert not estimates["quotable"].any()
