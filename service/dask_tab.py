"""Adds a tab to the dashboard of Dask's scheduler: studies, the barrier's idle time, stages.

`add_tab` registers a plugin, which sums up the records of `service.dask_records` in the
scheduler's process and adds the page ``/palpate`` to its server. Dask has no public way to add a
page: where a version has other insides, or a scheduler takes no plugins, there is no tab.
"""

import logging
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from html import escape
from typing import Any

from distributed import Client, Scheduler, SchedulerPlugin

from service.dask_records import TOPIC

PAGE = "palpate"
MOST_STUDIES = 30
MOST_GENERATIONS = 200
RENEW_MS = 1000

_log = logging.getLogger(__name__)


def add_tab(client: Client) -> bool:
    """Add the tab to the scheduler of a client, unless it has it.

    Returns
    -------
    bool
        False if that was not possible; the log says why.
    """
    try:
        client.register_plugin(PalpateTab())
    except Exception as error:  # whatever another version of Dask raises
        _log.info("The dashboard of Dask has no tab of Palpate: %r", error)
        return False
    return True


class IdleTime:
    """Integrates the time in which threads of workers have no task.

    Parameters
    ----------
    clock : callable
        In seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since = clock()
        self._threads = self._busy = 0
        self._idle_s = self._all_s = 0.0

    def note(self, tasks_and_threads: list[tuple[int, int]]) -> None:
        """Note the tasks that each worker has from now on, and its threads."""
        self.so_far()
        self._threads = sum(threads for _, threads in tasks_and_threads)
        self._busy = sum(min(pair) for pair in tasks_and_threads)

    def so_far(self) -> tuple[float, float]:
        """Return idle seconds and all seconds, summed over threads."""
        now = self._clock()
        passed, self._since = now - self._since, now
        self._idle_s += passed * (self._threads - self._busy)
        self._all_s += passed * self._threads
        return self._idle_s, self._all_s


@dataclass
class StudyRow:
    """What the tab shows of one study.

    Parameters
    ----------
    name : str
    most : int
        Evaluations, if the search runs to its last generation.
    client : str
        Who runs it.
    state : str
        In words.
    best_gsf : float
        Infinite while there is none.
    endings : Counter of str
        Evaluations by their ending.
    stages : Counter of str
        Seconds by stage, of what was computed in this run.
    generations : deque of (int, float)
        Number, and share of the workers' time without a task until its barrier.
    begun : tuple of float
        Idle and all seconds when the generation began.
    computed : bool
        Whether the generation had anything to compute; one that is known says nothing of barriers.
    """

    name: str
    most: int
    client: str
    state: str = "preparing"
    best_gsf: float = math.inf
    endings: Counter[str] = field(default_factory=Counter)
    stages: Counter[str] = field(default_factory=Counter)
    generations: deque[tuple[int, float]] = field(
        default_factory=lambda: deque(maxlen=MOST_GENERATIONS)
    )
    begun: tuple[float, float] = (0.0, 0.0)
    computed: bool = False

    def add(self, record: dict[str, Any], idle: IdleTime) -> None:
        """Take in one record of `service.dask_records.DaskRecords`."""
        what = record["what"]
        if what == "ended":
            self.endings[record["status"]] += 1
            self.computed |= record["computed"]
            self.stages.update(record["seconds"])
            self.best_gsf = min(self.best_gsf, math.inf if record["gsf"] is None else record["gsf"])
        elif what == "generation begun":
            self.state = f"generation {record['number']}"
            self.begun, self.computed = idle.so_far(), False
        elif what == "generation ended" and self.computed:
            idle_s, all_s = (
                now - then for now, then in zip(idle.so_far(), self.begun, strict=True)
            )
            if all_s > 0.0:
                self.generations.append((record["number"], idle_s / all_s))
        elif what == "stopped":
            self.state = record["reason"]
            self.client = ""


class PalpateTab(SchedulerPlugin):
    """Sums up records of studies in the scheduler's process, and shows them."""

    name = "palpate-tab"
    idempotent = True

    async def start(self, scheduler: Scheduler) -> None:
        """Begin to sum up, and add the page; Dask calls this when the plugin is registered."""
        self._scheduler = scheduler
        self.studies: dict[str, StudyRow] = {}
        self.idle = IdleTime()
        self._note_workers()
        _add_page(self, scheduler)

    def log_event(self, topic: str, msg: Any) -> None:
        """Take in the records of a study."""
        if topic != TOPIC:
            return
        for record in msg["records"]:
            key = record["study"]
            if record["what"] == "started":
                self.studies.pop(key, None)  # shown last
                self.studies[key] = StudyRow(record["name"], record["most"], msg["client"])
                if len(self.studies) > MOST_STUDIES:
                    del self.studies[next(iter(self.studies))]
            elif key in self.studies:
                self.studies[key].add(record, self.idle)

    def transition(self, key: str, start: str, finish: str, *args: Any, **more: Any) -> None:
        """Count the workers that have a task."""
        if "processing" in (start, finish):
            self._note_workers()

    def add_worker(self, scheduler: Scheduler, worker: str) -> None:
        """Count the workers."""
        self._note_workers()

    def remove_worker(self, scheduler: Scheduler, worker: str, **more: Any) -> None:
        """Count the workers."""
        self._note_workers()

    def remove_client(self, scheduler: Scheduler, client: str) -> None:
        """Note that nobody runs the studies of a client any more."""
        for study in self.studies.values():
            if study.client == client:
                study.state = "interrupted"

    def _note_workers(self) -> None:
        workers = self._scheduler.workers.values()
        self.idle.note([(len(worker.processing), worker.nthreads) for worker in workers])


def _add_page(tab: PalpateTab, scheduler: Scheduler) -> None:
    """Add ``/palpate`` and its tab to a scheduler that runs already.

    Raises
    ------
    RuntimeError
        If the scheduler has no dashboard.
    ImportError, AttributeError, KeyError
        If Dask's insides, which no documentation promises, are others.
    """
    from distributed.dashboard.components.scheduler import BOKEH_THEME, env
    from distributed.dashboard.core import BokehApplication
    from distributed.dashboard.scheduler import template_variables
    from tornado.ioloop import IOLoop

    server = scheduler.http_application
    if not any(hasattr(application, "app_paths") for application in server.applications):
        raise RuntimeError("this scheduler has no dashboard")
    prefix = next(a for a in server.applications if hasattr(a, "app_paths")).prefix
    look = {"template": env.get_template("simple.html"), "theme": BOKEH_THEME}
    variables = template_variables(scheduler)
    document = partial(_document, tab, look)
    page = BokehApplication({f"/{PAGE}": document}, scheduler, prefix, variables)
    server.add_application(page)
    page.initialize(IOLoop.current())
    page.start()
    if PAGE not in variables["pages"]:
        variables["pages"].append(PAGE)  # one list for the navigation of all pages


def _document(
    tab: PalpateTab, look: dict[str, Any], scheduler: Scheduler, variables: dict[str, Any], doc: Any
) -> None:
    """Fill the document of somebody who opens the page, and renew it every `RENEW_MS`."""
    from bokeh.layouts import column
    from bokeh.models import ColumnDataSource

    sources = {name: ColumnDataSource(data, name=name) for name, data in columns(tab).items()}

    def renew() -> None:
        for name, data in columns(tab).items():
            if data != sources[name].data:
                sources[name].data = data
        table.text = _rows(sources["studies"].data)
        stages.y_range.factors = sources["stages"].data["stage"]

    table, stages = _table(sources["studies"]), _stages(sources["stages"])
    doc.title = "Dask: Palpate"
    parts = table, _barrier(sources["barrier"]), stages
    doc.add_root(column(*parts, sizing_mode="stretch_width"))
    doc.template, doc.theme = look["template"], look["theme"]
    doc.template_variables.update(variables)
    doc.add_periodic_callback(renew, RENEW_MS)


def columns(tab: PalpateTab) -> dict[str, dict[str, list[Any]]]:
    """Return the columns of the tables that the page shows; the study begun last comes first."""
    studies = list(reversed(tab.studies.values()))
    shown = studies[0] if studies else StudyRow("", 0, "")
    spent: Counter[str] = sum((study.stages for study in studies), Counter())
    stages = sorted(spent, key=lambda stage: spent[stage])
    return {
        "studies": {
            "study": [s.name for s in studies],
            "state": [s.state for s in studies],
            "ended": [s.endings.total() for s in studies],
            "most": [s.most for s in studies],
            "done": [s.endings["done"] for s in studies],
            "diverged": [s.endings["diverged"] for s in studies],
            "crashed": [s.endings["crashed"] for s in studies],
            "lost": [s.endings["lost"] for s in studies],
            "best": [f"{s.best_gsf:.4g}" if s.endings["done"] else "" for s in studies],
            "idle": [_mean_percent(s) for s in studies],
        },
        "barrier": {
            "generation": [number for number, _ in shown.generations],
            "idle_percent": [100.0 * share for _, share in shown.generations],
        },
        "stages": {"stage": stages, "seconds": [spent[stage] for stage in stages]},
    }


def _mean_percent(study: StudyRow) -> str:
    shares = [share for _, share in study.generations]
    return f"{100.0 * sum(shares) / len(shares):.0f} %" if shares else ""


def _table(source: Any) -> Any:
    from bokeh.models.widgets import Div

    return Div(text=_rows(source.data), tags=[source], sizing_mode="stretch_width")


def _rows(data: Mapping[str, Any]) -> str:
    """Write a table as HTML: bokeh's own does not redraw rows whose number stays."""
    titles = {"most": "at most", "best": "best GSF", "idle": "mean idle"}
    lines = [[titles.get(name, name) for name in data], *zip(*data.values(), strict=True)]
    cell = '<td style="padding: 2px 14px 2px 4px">{}</td>'
    rows = ("".join(cell.format(escape(str(value))) for value in line) for line in lines)
    return "<table>" + "".join(f"<tr>{row}</tr>" for row in rows) + "</table>"


def _barrier(source: Any) -> Any:
    from bokeh.models import DataRange1d
    from bokeh.plotting import figure

    title = "Generations of the study begun last: workers' time without a task, until the barrier"
    plot = figure(
        title=title,
        y_range=DataRange1d(start=0.0),
        height=220,
        sizing_mode="stretch_width",
        toolbar_location=None,
    )
    plot.vbar(x="generation", top="idle_percent", width=0.8, source=source)
    plot.xaxis.axis_label, plot.yaxis.axis_label = "generation", "idle (%)"
    return plot


def _stages(source: Any) -> Any:
    from bokeh.models import DataRange1d
    from bokeh.plotting import figure

    plot = figure(
        title="Evaluations of all studies: seconds by stage",
        x_range=DataRange1d(start=0.0),
        y_range=source.data["stage"],
        height=260,
        sizing_mode="stretch_width",
        toolbar_location=None,
    )
    plot.hbar(y="stage", right="seconds", height=0.8, source=source)
    plot.xaxis.axis_label = "seconds, summed over workers"
    return plot
