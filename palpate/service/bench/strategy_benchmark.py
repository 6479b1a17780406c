"""Benchmarks of strategies on the same targets: evaluations and core-seconds to reach given errors.

Each target is a compressed body whose constants are hidden from the search. Its study runs to
completion in one process and counts CPU seconds; an interrupted study is resumed. A chart shows the
convergence: score and error against evaluations and seconds.
"""

import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from palpate.service.cluster.task_dispatch import Ending, SingleProcess, Task, TaskCalls
from palpate.service.report.drawing.colours import BLUE, GREEN, INK, ORANGE, PINK
from palpate.service.report.drawing.matplotlib_figures import TEXT_PT, calm, figure, svg
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.loop import Study
from palpate.service.study.study_folder import StudyLog
from palpate.service.study.study_keys import StudySpec, parse_spec
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.best_candidate import BestSoFar, best_of, score_of
from palpate.storage.journal_records import EvaluationRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STRATEGIES = ("least-squares", "genetic+least-squares", "genetic", "cma")
# Young's moduli are the constants that an image of a breast determines well.
MODULI = ("E_fat_kpa", "E_glandular_kpa")
NEAR = 0.02
BOUNDS = {
    "E_fat_kpa": (5, 20),
    "eta_fat_kpa": (50, 200),
    "E_glandular_kpa": (5, 80),
    "eta_glandular_kpa": (50, 200),
}
# Targets are in this part of the searched intervals, in logarithms.
INNER = (0.1, 0.9)
SEED, TEN = 445, 10

TEMPLATE = """
name: {name}
case:
  reference: {{phantom: {{preset: 445ml, spacing_mm: {spacing_mm}, glandular_fraction: 0.2}}}}
  mesh: {{nodes: {nodes}}}
  load: {{force_n: 100}}
target: {{constants: {constants}{target_mesh}}}
search:
  strategy: {strategy}
  parameters: {bounds}
  {population}
seed: {seed}
"""


@dataclass(frozen=True)
class Improvement:
    """The best candidate of a study after some evaluations.

    Parameters
    ----------
    evaluations : int
    core_s : float
        CPU time of these evaluations.
    gsf : float
    error : float
        The larger relative error of the two Young's moduli.
    """

    evaluations: int
    core_s: float
    gsf: float
    error: float


@dataclass(frozen=True)
class Reached:
    """The outcome of one study.

    Parameters
    ----------
    strategy : str
    target : int
    evaluations : int
        Total number of evaluations.
    core_s : float
        CPU time of all evaluations.
    until_near : int or None
        Evaluations until the best candidate stays within 2 % in both moduli; None if never.
    core_s_until_near : float or None
    gsf : float
        Score of the best candidate.
    errors : mapping of str to float
        Signed relative errors of the best candidate, by gene.
    within : mapping of str to bool
        Whether the 90 % interval covers the true value, by gene.
    improvements : tuple of Improvement
        Every new best candidate.
    """

    strategy: str
    target: int
    evaluations: int
    core_s: float
    until_near: int | None
    core_s_until_near: float | None
    gsf: float
    errors: Mapping[str, float]
    within: Mapping[str, bool]
    improvements: tuple[Improvement, ...]


def targets(count: int) -> list[dict[str, float]]:
    """Return the constants of the targets: a Latin hypercube in the logarithms.

    Fewer than ten targets are a subset of the ten.
    """
    rng, strata = np.random.default_rng(SEED), max(count, TEN)
    found: list[dict[str, float]] = [{} for _ in range(strata)]
    for name, (lower, upper) in BOUNDS.items():
        unit = (rng.permutation(strata) + rng.random(strata)) / strata
        share = INNER[0] + (INNER[1] - INNER[0]) * unit
        for target, s in zip(found, share, strict=True):
            target[name] = float(f"{lower * (upper / lower) ** s:.4g}")
    return found[:count]


class OneCore(SingleProcess):
    """A single process that reports CPU seconds, which other processes do not affect."""

    def run(self, task: Task, calls: TaskCalls) -> Iterator[Ending]:
        """Run tasks that may fail; see `SingleProcess.run`."""
        for call in calls:
            began = time.process_time()
            for ending in super().run(task, [call]):
                yield _with_seconds(ending, time.process_time() - began)


def _with_seconds(ending: Ending, core_s: float) -> Ending:
    """Scale the stage times of a new evaluation to a total of `core_s`."""
    value = ending.value
    if not isinstance(value, Mapping) or value.get("reused") or not value.get("seconds"):
        return ending
    wall_s = sum(value["seconds"].values())
    share = core_s / wall_s if wall_s > 0 else 1.0
    seconds = {stage: share * s for stage, s in value["seconds"].items()}
    return replace(ending, value={**value, "seconds": seconds})


@dataclass(frozen=True)
class Bench:
    """The size of the benchmark.

    Parameters
    ----------
    targets : int
    nodes : int
        Nodes of the candidates' mesh.
    spacing_mm : float
    target_nodes : int or None
        Nodes of a separate mesh for the target; None if target and candidates share one.
    """

    targets: int = 10
    nodes: int = 2000
    spacing_mm: float = 1.0
    target_nodes: int | None = None


def study_of(strategy: str, target: int, constants: Mapping[str, float], bench: Bench) -> StudySpec:
    """Return the study of one strategy and target."""
    few = "genetic" in strategy
    finer = bench.target_nodes
    text = TEMPLATE.format(
        name=f"{strategy.replace('+', '-')}-{target}",
        spacing_mm=bench.spacing_mm,
        nodes=bench.nodes,
        constants=dict(constants),
        target_mesh="" if finer is None else f", mesh: {{nodes: {finer}}}",
        strategy=strategy,
        bounds={name: list(ends) for name, ends in BOUNDS.items()},
        population=_population(strategy) if few else "",
        seed=target + 1,
    )
    return parse_spec(text, "the benchmark of strategies", Path())


def measure_strategies(
    folder: Path, strategies: Sequence[str], bench: Bench, processes: int = 1
) -> Iterator[Reached]:
    """Run the studies that have not ended yet, and yield the outcome of each.

    Parameters
    ----------
    folder : Path
        Folder of the studies; existing ones are continued.
    strategies : sequence of str
    bench : Bench
    processes : int
        Number of concurrent studies, each on one core.
    """
    each = [
        (folder, strategy, number, constants, bench)
        for number, constants in enumerate(targets(bench.targets))
        for strategy in strategies
    ]
    # Separate processes even for one study, since their libraries then use one thread.
    # Ctrl-C ends them immediately; the journals are kept.
    at_ctrl_c = (signal.SIGINT, signal.SIG_DFL)
    with ProcessPoolExecutor(
        processes, get_context("spawn"), initializer=signal.signal, initargs=at_ctrl_c
    ) as pool:
        yield from pool.map(_measure_one, *zip(*each, strict=True))


def _measure_one(
    folder: Path, strategy: str, target: int, constants: Mapping[str, float], bench: Bench
) -> Reached:
    """Run one study to its end."""
    spec = study_of(strategy, target, constants, bench)
    home = folder / spec.name
    study = Study(spec, home, folder / "store")
    if not study.ended:
        study.run(OneCore())
    return reached(home, strategy, target, constants)


def reached(home: Path, strategy: str, target: int, constants: Mapping[str, float]) -> Reached:
    """Return the outcome of a study from its journal."""
    log, results = StudyLog.read(StudyLayout(home).journal), study_results(home)
    best = best_of(log.endings)
    if best is None:
        raise AssertionError("every target of the benchmark can be simulated")
    order = [log.endings[c] for c in sorted(log.endings)]
    improvements = _improvements(order, constants)
    near = near_from(improvements)
    within = {}
    if results.identification is not None:
        for name, constant in results.identification.constants.items():
            gene, interval = results.estimates[name].gene, constant.interval
            inside = interval is not None and interval.lower <= constants[gene] <= interval.upper
            within[gene] = inside
    return Reached(
        strategy=strategy,
        target=target,
        evaluations=len(order),
        core_s=_seconds(order),
        until_near=None if near is None else near.evaluations,
        core_s_until_near=None if near is None else near.core_s,
        gsf=score_of(best),
        errors={gene: best.genes[gene] / value - 1 for gene, value in constants.items()},
        within=within,
        improvements=improvements,
    )


def _improvements(
    order: Sequence[EvaluationRecord], constants: Mapping[str, float]
) -> tuple[Improvement, ...]:
    """Return every new best candidate, in candidate order."""
    improvements: list[Improvement] = []
    so_far, before, core_s = BestSoFar(), None, 0.0
    for i, record in enumerate(order):
        core_s += _seconds([record])
        so_far.add(record)
        best = so_far.record
        if best is None or best is before:
            continue
        before = best
        error = max(abs(best.genes[gene] / constants[gene] - 1) for gene in MODULI)
        improvements.append(Improvement(i + 1, core_s, score_of(best), error))
    return tuple(improvements)


def near_from(improvements: Sequence[Improvement]) -> Improvement | None:
    """Return the improvement after which the best candidate stays close in both moduli."""
    near = None
    for one in improvements:
        if one.error > NEAR:
            near = None
        elif near is None:
            near = one
    return near


def _seconds(records: Sequence[EvaluationRecord]) -> float:
    return float(sum(sum(record.seconds.values()) for record in records))


def _population(strategy: str) -> str:
    """Return the settings of the genetic stage: the thesis' own, or only a few generations."""
    if strategy == "genetic":
        return "population: 84\n  generations: 15"
    return "population: 24\n  generations: 3"


WIDTH_IN, HEIGHT_IN = 10.4, 6.4
COLOURS = {"least-squares": BLUE, "genetic+least-squares": GREEN, "genetic": ORANGE, "cma": PINK}
# Smaller errors are due to rounding and to the voxels.
LEAST_ERROR = 1e-5


def write_chart(rows: Sequence[Reached], path: Path) -> None:
    """Write the chart to a separate file, on a white background."""
    write_file(path, svg(strategy_chart(rows)).encode())


def strategy_chart(rows: Sequence[Reached]) -> "Figure":
    """Draw each study as a thin line and each strategy's median as a thick one."""
    drawn = figure(WIDTH_IN, HEIGHT_IN)
    drawn.set_facecolor("white")
    grid = drawn.subplots(2, 2, sharex="col", sharey="row", squeeze=False)
    for strategy, colour in COLOURS.items():
        own = [row.improvements for row in rows if row.strategy == strategy and row.improvements]
        if not own:
            continue
        for column, over in enumerate(("evaluations", "core_s")):
            for line, value in enumerate(("gsf", "error")):
                _curves(grid[line, column], own, over, value, colour, strategy)
    titles = ("evaluations", "CPU seconds of one core")
    for column, title in enumerate(titles):
        grid[1, column].set_xlabel(title, fontsize=TEXT_PT)
        for axes in grid[:, column]:
            calm(axes, grid="both")
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter(NullFormatter())
        grid[1, column].set_yscale("log")
        grid[1, column].axhline(NEAR, color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
    grid[0, 0].set_ylabel("GSF of the best candidate", fontsize=TEXT_PT)
    grid[1, 0].set_ylabel("larger error of the Young's moduli", fontsize=TEXT_PT)
    shares = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)
    grid[1, 0].set_yticks(shares, ["0.01 %", "0.1 %", "1 %", "10 %", "100 %"])
    handles, labels = grid[0, 0].get_legend_handles_labels()
    drawn.legend(handles, labels, frameon=False, loc="outside upper left", ncols=4)
    return drawn


def _curves(
    axes: "Axes",
    studies: Sequence[Sequence[Improvement]],
    over: str,
    value: str,
    colour: str,
    title: str,
) -> None:
    """Draw one strategy; a study keeps its last value after its end."""
    curves = []
    for improvements in studies:
        x = np.array([getattr(improvement, over) for improvement in improvements])
        y = np.array([max(getattr(improvement, value), LEAST_ERROR if value == "error" else -np.inf)
                      for improvement in improvements])  # fmt: skip
        axes.step(x, y, where="post", color=colour, linewidth=0.6, alpha=0.4)
        curves.append((x, y))
    # The median starts where every study has a candidate.
    first = max(x[0] for x, _ in curves)
    places = np.unique(np.concatenate([x for x, _ in curves] + [np.array([first])]))
    places = places[places >= first]
    held = [y[np.searchsorted(x, places, side="right") - 1] for x, y in curves]
    middle = np.median(held, axis=0)
    axes.step(places, middle, where="post", color=colour, linewidth=2.2, label=title)
