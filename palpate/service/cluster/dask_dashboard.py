"""Dask's dashboard: which host names it answers to, and its tab of studies and diagnoses.

A page of another site can point its own name at this machine (DNS rebinding) and read the
replies. It cannot, however, forge the Host header, so requests under other names are refused.

The tab shows studies, diagnoses, idle time and stages, a row for each study and each diagnosis.
`add_tab` registers a plugin, which sums up the records that observers of studies and diagnoses
send to the scheduler, in the scheduler's process, and adds the page ``/palpate`` to its server.
Dask has no public interface for adding a page: if the internals of a version differ, or a
scheduler does not accept plugins, there is no tab.
"""

import logging
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from html import escape
from typing import Any, TypeVar
from urllib.parse import urlsplit

from distributed import Client, Scheduler, SchedulerPlugin
from tornado.httputil import (
    HTTPConnection,
    HTTPHeaders,
    HTTPMessageDelegate,
    HTTPServerConnectionDelegate,
    RequestStartLine,
    ResponseStartLine,
)

OWN_HOSTS = frozenset({"localhost", "127.0.0.1", "::1"})
HOST_REFUSAL = b"This dashboard answers to localhost only.\n"


def answer_to_own_hosts(scheduler: Scheduler, hosts: Iterable[str] = OWN_HOSTS) -> None:
    """Make the HTTP server of a scheduler reject requests for other hosts."""
    server: Any = scheduler.http_server
    server.request_callback = _OwnHosts(server.request_callback, frozenset(hosts))


class _OwnHosts(HTTPServerConnectionDelegate):
    """A delegate that passes on requests for allowed hosts only."""

    def __init__(self, inner: HTTPServerConnectionDelegate, hosts: frozenset[str]) -> None:
        self.inner, self.hosts = inner, hosts

    def start_request(
        self, server_conn: object, request_conn: HTTPConnection
    ) -> HTTPMessageDelegate:
        inner = self.inner.start_request(server_conn, request_conn)
        return _CheckedHost(inner, request_conn, self.hosts)

    def on_close(self, server_conn: object) -> None:
        self.inner.on_close(server_conn)


class _CheckedHost(HTTPMessageDelegate):
    """One request."""

    def __init__(
        self, inner: HTTPMessageDelegate, connection: HTTPConnection, hosts: frozenset[str]
    ) -> None:
        self.inner, self.connection, self.hosts = inner, connection, hosts
        self.refused = False

    def headers_received(
        self, start_line: RequestStartLine | ResponseStartLine, headers: HTTPHeaders
    ) -> Any:
        self.refused = _host_name(headers.get("Host", "")) not in self.hosts
        return None if self.refused else self.inner.headers_received(start_line, headers)

    def data_received(self, chunk: bytes) -> Any:
        return None if self.refused else self.inner.data_received(chunk)

    def finish(self) -> None:
        if not self.refused:
            self.inner.finish()
            return
        headers = HTTPHeaders(
            {"Content-Length": str(len(HOST_REFUSAL)), "Content-Type": "text/plain"}
        )
        start = ResponseStartLine("HTTP/1.1", 421, "Misdirected Request")
        self.connection.write_headers(start, headers, HOST_REFUSAL)
        self.connection.finish()

    def on_connection_close(self) -> None:
        if not self.refused:
            self.inner.on_connection_close()


def _host_name(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


# Topics of the scheduler's events that contain records of studies.
TOPIC = "palpate"

MOST_GENERATIONS = 200


class IdleTime:
    """The accumulated time during which worker threads have no task.

    Parameters
    ----------
    clock : callable
        Returns the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since = clock()
        self._threads = self._busy = 0
        self._idle_s = self._all_s = 0.0

    def note(self, tasks_and_threads: list[tuple[int, int]]) -> None:
        """Record the current tasks and threads of each worker."""
        self.so_far()
        self._threads = sum(threads for _, threads in tasks_and_threads)
        self._busy = sum(min(pair) for pair in tasks_and_threads)

    def so_far(self) -> tuple[float, float]:
        """Return idle seconds and total seconds, summed over threads."""
        now = self._clock()
        passed, self._since = now - self._since, now
        self._idle_s += passed * (self._threads - self._busy)
        self._all_s += passed * self._threads
        return self._idle_s, self._all_s


@dataclass
class StudyRow:
    """One study in the tab.

    Parameters
    ----------
    name : str
    most : int
        Number of evaluations if the search runs to its last generation.
    client : str
        The client that runs the study.
    state : str
        The state as text.
    best_score : float
        Score of the best candidate so far, lower is better; infinite before the first.
    endings : Counter of str
        Number of evaluations by ending.
    stages : Counter of str
        Seconds by stage, of evaluations computed in this run.
    generations : deque of (int, float)
        Number, from 1, and share of the workers' time without a task up to its barrier.
    begun : tuple of float
        Idle and total seconds at the start of the generation.
    computed : bool
        Whether any candidate of the generation was computed; if not, it has no idle time to report.
    """

    name: str
    most: int
    client: str
    state: str = "preparing"
    best_score: float = math.inf
    endings: Counter[str] = field(default_factory=Counter)
    stages: Counter[str] = field(default_factory=Counter)
    generations: deque[tuple[int, float]] = field(
        default_factory=lambda: deque(maxlen=MOST_GENERATIONS)
    )
    begun: tuple[float, float] = (0.0, 0.0)
    computed: bool = False

    def add(self, record: dict[str, Any], idle: IdleTime) -> None:
        """Add one record of `service.study.study_session.DaskRecords`."""
        what = record["what"]
        if what == "ended":
            self.endings[record["status"]] += 1
            self.computed |= record["computed"]
            self.stages.update(record["seconds"])
            self.best_score = math.inf if record["best_score"] is None else record["best_score"]
        elif what == "generation begun":
            self.state = f"generation {record['number'] + 1}"
            self.begun, self.computed = idle.so_far(), False
        elif what == "generation ended" and self.computed:
            idle_s, all_s = (
                now - then for now, then in zip(idle.so_far(), self.begun, strict=True)
            )
            if all_s > 0.0:
                self.generations.append((record["number"] + 1, idle_s / all_s))
        elif what == "stopped":
            self.state = record["reason"]
            self.client = ""


@dataclass
class DiagnosisRow:
    """One diagnosis in the tab.

    Parameters
    ----------
    name : str
    client : str
        The client that runs the diagnosis.
    state : str
        As text: the phase and its progress, finally the verdict.
    tasks : int
        Number of finished tasks.
    begun : tuple of float
        Idle and total seconds of the workers at the start.
    idle : float or None
        Share of the workers' time without a task since then; None if unknown.
    """

    name: str
    client: str
    begun: tuple[float, float]
    state: str = "reading"
    tasks: int = 0
    idle: float | None = None

    def add(self, record: dict[str, Any], idle: IdleTime) -> None:
        """Add one record of `service.diagnosis.diagnosis_run.DiagnosisRecords`."""
        if record["what"] == "step":
            done, of, task = record["done"], record["of"], record["task"]
            self.tasks += done > 0
            self.state = f"{record['phase']}, {done} of {of}" + (f": {task}" if task else "")
        elif record["what"] == "stopped":
            self.state, self.client = record["reason"], ""
        idle_s, all_s = (now - then for now, then in zip(idle.so_far(), self.begun, strict=True))
        if all_s > 0.0:
            self.idle = idle_s / all_s


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
