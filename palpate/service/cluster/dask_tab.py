"""A tab in Dask's dashboard: studies, diagnoses, idle time, stages.

`add_tab` registers a plugin, which sums up the records of `study.observers.dask_records` and
`diagnosis.dask_observer` in the scheduler's process and adds the page ``/palpate`` to its server.
Dask has no public interface for adding a page: if the internals of a version differ, or a
scheduler does not accept plugins, there is no tab.
"""

import logging
from collections import Counter
from collections.abc import Mapping
from functools import partial
from html import escape
from typing import Any, TypeVar

from distributed import Client, Scheduler, SchedulerPlugin

from palpate.service.cluster.dask_rows import TOPIC, DiagnosisRow, IdleTime, StudyRow

PAGE = "palpate"
MOST_ROWS = 30
RENEW_MS = 1000

Row = TypeVar("Row")

_log = logging.getLogger(__name__)


def add_tab(client: Client) -> bool:
    """Add the tab to a client's scheduler, unless it is already there.

    Returns
    -------
    bool
        False if that was not possible; the reason is logged.
    """
    try:
        client.register_plugin(PalpateTab())
    except Exception as error:  # another version of Dask may raise anything
        _log.info("Dask's dashboard has no Palpate tab: %r", error)
        return False
    return True


class PalpateTab(SchedulerPlugin):
    """A plugin that sums up and displays studies and diagnoses in the scheduler's process."""

    name = "palpate-tab"
    idempotent = True

    async def start(self, scheduler: Scheduler) -> None:
        """Start collecting records and add the page; Dask calls this on registration."""
        self._scheduler = scheduler
        self.studies: dict[str, StudyRow] = {}
        self.diagnoses: dict[str, DiagnosisRow] = {}
        self.idle = IdleTime()
        self._note_workers()
        _add_page(self, scheduler)

    def log_event(self, topic: str, msg: Any) -> None:
        """Add the records of a study or a diagnosis."""
        if topic != TOPIC:
            return
        for record in msg["records"]:
            if "diagnosis" in record:
                self._add_diagnosis(record["diagnosis"], record, msg["client"])
            else:
                self._add_study(record["study"], record, msg["client"])

    def _add_study(self, key: str, record: dict[str, Any], client: str) -> None:
        if record["what"] == "started":
            _put_last(self.studies, key, StudyRow(record["name"], record["most"], client))
        elif key in self.studies:
            self.studies[key].add(record, self.idle)

    def _add_diagnosis(self, key: str, record: dict[str, Any], client: str) -> None:
        if record["what"] == "started":
            row = DiagnosisRow(record["name"], client, self.idle.so_far())
            _put_last(self.diagnoses, key, row)
        elif key in self.diagnoses:
            self.diagnoses[key].add(record, self.idle)

    def transition(self, key: str, start: str, finish: str, *args: Any, **more: Any) -> None:
        """Update the number of busy workers."""
        if "processing" in (start, finish):
            self._note_workers()

    def add_worker(self, scheduler: Scheduler, worker: str) -> None:
        """Update the number of workers."""
        self._note_workers()

    def remove_worker(self, scheduler: Scheduler, worker: str, **more: Any) -> None:
        """Update the number of workers."""
        self._note_workers()

    def remove_client(self, scheduler: Scheduler, client: str) -> None:
        """Mark everything that a client was running as stopped."""
        rows: list[StudyRow | DiagnosisRow] = [*self.studies.values(), *self.diagnoses.values()]
        for row in rows:
            if row.client == client:
                row.state = "interrupted"

    def _note_workers(self) -> None:
        workers = self._scheduler.workers.values()
        self.idle.note([(len(worker.processing), worker.nthreads) for worker in workers])


def _put_last(rows: dict[str, Row], key: str, row: Row) -> None:
    """Append a row, which is shown first, and drop the oldest if there are too many."""
    rows.pop(key, None)
    rows[key] = row
    if len(rows) > MOST_ROWS:
        del rows[next(iter(rows))]


def _add_page(tab: PalpateTab, scheduler: Scheduler) -> None:
    """Add ``/palpate`` and its tab to a running scheduler.

    Raises
    ------
    RuntimeError
        If the scheduler has no dashboard.
    ImportError, AttributeError, KeyError
        If Dask's undocumented internals differ.
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
        variables["pages"].append(PAGE)  # the list is shared by the navigation of all pages


def _document(
    tab: PalpateTab, look: dict[str, Any], scheduler: Scheduler, variables: dict[str, Any], doc: Any
) -> None:
    """Fill the document for a visitor, and refresh it every `RENEW_MS`."""
    from bokeh.layouts import column
    from bokeh.models import ColumnDataSource

    sources = {name: ColumnDataSource(data, name=name) for name, data in columns(tab).items()}

    def renew() -> None:
        for name, data in columns(tab).items():
            if data != sources[name].data:
                sources[name].data = data
        table.text = _rows(sources["studies"].data)
        diagnoses.text = _rows(sources["diagnoses"].data)
        stages.y_range.factors = sources["stages"].data["stage"]

    table, diagnoses = _table(sources["studies"]), _table(sources["diagnoses"])
    stages = _stages(sources["stages"])
    doc.title = "Dask: Palpate"
    parts = table, diagnoses, _barrier(sources["barrier"]), stages
    doc.add_root(column(*parts, sizing_mode="stretch_width"))
    doc.template, doc.theme = look["template"], look["theme"]
    doc.template_variables.update(variables)
    doc.add_periodic_callback(renew, RENEW_MS)


def columns(tab: PalpateTab) -> dict[str, dict[str, list[Any]]]:
    """Return the columns of the page's tables; the latest rows come first."""
    studies = list(reversed(tab.studies.values()))
    diagnoses = list(reversed(tab.diagnoses.values()))
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
            "best": [f"{s.best_score:.4g}" if s.endings["done"] else "" for s in studies],
            "idle": [_mean_percent(s) for s in studies],
        },
        "diagnoses": {
            "diagnosis": [d.name for d in diagnoses],
            "state": [d.state for d in diagnoses],
            "tasks ended": [d.tasks for d in diagnoses],
            "idle": ["" if d.idle is None else f"{100.0 * d.idle:.0f} %" for d in diagnoses],
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
    """Return a table as HTML; bokeh's own table does not redraw if the row count is unchanged."""
    titles = {"most": "at most", "best": "best score", "idle": "mean idle"}
    lines = [[titles.get(name, name) for name in data], *zip(*data.values(), strict=True)]
    cell = '<td style="padding: 2px 14px 2px 4px">{}</td>'
    rows = ("".join(cell.format(escape(str(value))) for value in line) for line in lines)
    return "<table>" + "".join(f"<tr>{row}</tr>" for row in rows) + "</table>"


def _barrier(source: Any) -> Any:
    from bokeh.models import DataRange1d
    from bokeh.plotting import figure

    title = "Generations of the latest study: workers' time without a task, up to the barrier"
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
