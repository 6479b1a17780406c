"""The benchmark of strategies and its chart, on handmade studies."""

from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from palpate.service.bench.strategy_benchmark import (
    BOUNDS,
    Bench,
    Improvement,
    OneCore,
    Reached,
    measure_strategies,
    near_from,
    study_of,
    targets,
    write_chart,
)
from palpate.service.cluster.task_dispatch import Ending


def test_targets_are_stratified_and_nested() -> None:
    ten = targets(10)
    assert targets(3) == ten[:3]
    for name, (low, high) in BOUNDS.items():
        share = np.log([t[name] / low for t in ten]) / np.log(high / low)
        cells = np.floor(10 * (share - 0.1) / 0.8 + 1e-3)
        assert sorted(cells) == list(range(10))


@pytest.mark.parametrize(
    ("errors", "evaluations"),
    [
        ((0.5, 0.01, 0.005), 2),
        ((0.01, 0.3, 0.015), 3),  # it was near by chance, then left again
        ((0.5, 0.02), 2),  # the limit counts as near
        ((0.5, 0.021), None),
        ((), None),
    ],
)
def test_near_requires_the_best_candidate_to_stay_near(
    errors: tuple[float, ...], evaluations: int | None
) -> None:
    found = near_from([Improvement(n, 2.0 * n, -n, e) for n, e in enumerate(errors, start=1)])
    assert (None if found is None else found.evaluations) == evaluations


def test_target_may_have_a_separate_mesh() -> None:
    constants = targets(1)[0]
    shared = study_of("cma", 0, constants, Bench(nodes=900, spacing_mm=2.0))
    finer = study_of("cma", 0, constants, Bench(nodes=900, spacing_mm=2.0, target_nodes=3600))
    assert shared.target.mesh is None
    assert finer.target.mesh.nodes == 3600
    assert finer.case == shared.case


def test_reports_cpu_seconds() -> None:
    def idle(seconds: float) -> dict[str, object]:
        return {"seconds": {"solve": 30.0, "score": 10.0}, "reused": seconds < 0}

    calls = [("made", (1.0,)), ("stored", (-1.0,))]
    endings: list[Ending] = list(OneCore().run(idle, calls))
    made, stored = (e.value["seconds"] for e in endings)
    assert sum(made.values()) < 1.0  # it did nothing, whatever it reports
    assert made["solve"] == pytest.approx(3 * made["score"])
    assert stored == {"solve": 30.0, "score": 10.0}


def test_chart_names_the_strategies_that_ran(tmp_path: Path) -> None:
    steps = tuple(Improvement(n, 3.0 * n, -n, 0.5**n) for n in range(1, 8))
    rows = [
        Reached(s, t, 9, 27.0, 6, 18.0, -7.0, {}, {}, steps[t:])
        for s in ("least-squares", "genetic")
        for t in range(3)
    ]
    write_chart(rows, tmp_path / "chart.svg")
    words = [e.text for e in ElementTree.parse(tmp_path / "chart.svg").iter() if e.text]
    assert {"least-squares", "genetic"} <= set(words)
    assert "cma" not in words


class Here:
    """Replaces processes, each of which takes seconds to start."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.map = map

    def __enter__(self) -> "Here":
        return self

    def __exit__(self, *_: object) -> None:
        pass


@pytest.mark.slow
def test_completed_study_is_read_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.service.bench.strategy_benchmark.ProcessPoolExecutor", Here)
    bench = Bench(targets=1, nodes=850, spacing_mm=2.0)
    (first,) = measure_strategies(tmp_path, ["least-squares"], bench)
    assert first.target == 0
    assert first.evaluations > 0
    assert list(measure_strategies(tmp_path, ["least-squares"], bench)) == [first]


@pytest.mark.slow
def test_concurrent_studies_return_in_order(tmp_path: Path) -> None:
    bench = Bench(targets=2, nodes=850, spacing_mm=2.0)
    beside = list(measure_strategies(tmp_path / "beside", ["least-squares"], bench, processes=2))
    assert [row.target for row in beside] == [0, 1]
    (alone,) = measure_strategies(tmp_path / "alone", ["least-squares"], replace(bench, targets=1))
    assert (alone.evaluations, alone.errors) == (beside[0].evaluations, beside[0].errors)
    assert (
        list(measure_strategies(tmp_path / "beside", ["least-squares"], bench)) == beside
    )  # read, not run
