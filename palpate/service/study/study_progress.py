"""Progress of a running study: counts, a live panel on a terminal, plain lines elsewhere.

Terminal, pages, service and Dask's dashboard share the counts. Evaluations are counted once they
have ended, generations once all of their scores are known.
"""

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from palpate.service.search.search_interface import Generation
from palpate.service.study.study_events import Observer, StudyFacts
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.best_candidate import BestSoFar
from palpate.storage.journal_records import EvaluationRecord
from palpate.storage.values import PreparedBody, PreparedTarget
from palpate.workers.comparison.score_objective import GSF

RATE_OVER_S = 300.0
# A rate is shown after this many evaluations, and after one for each worker.
FIRST_EVALUATIONS = 3
FAILED = ("diverged", "crashed", "lost")


def ended_of(counts: Mapping[str, int]) -> int:
    """Return the number of evaluations that have ended, given the counts by status."""
    return sum(counts.get(status, 0) for status in ("done", *FAILED))


def evaluations_text(counts: Mapping[str, int], at_most: int) -> str:
    """Return the number of evaluations as text.

    Examples
    --------
    >>> evaluations_text({"done": 1200, "diverged": 3}, 1260)
    '1,203 of at most 1,260 (3 diverged)'
    """
    failed = ", ".join(f"{counts[s]:,} {s}" for s in FAILED if counts.get(s))
    text = f"{ended_of(counts):,} of at most {at_most:,}"
    return f"{text} ({failed})" if failed else text


def generations_text(complete: int, at_most: int) -> str:
    """Return the number of complete generations as text."""
    return f"{complete:,} of at most {at_most:,} complete"


class Pace:
    """Evaluations per minute, measured while they are computed.

    Parameters
    ----------
    clock : callable
        Returns the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._began: float | None = None
        self._count = 0
        self._recent: deque[float] = deque(maxlen=10_000)

    def add(self, seconds: float) -> None:
        """Add an evaluation that has just ended and its duration in seconds."""
        now = self._clock()
        if self._began is None:
            self._began = now - seconds
        self._count += 1
        self._recent.append(now)

    def per_minute(self, workers: int = 1) -> float | None:
        """Return the recent rate; None before the first evaluations of all workers."""
        first = max(FIRST_EVALUATIONS, workers)
        if self._began is None or self._count < first:
            return None
        now = self._clock()
        recent = [at for at in list(self._recent) if now - at < RATE_OVER_S]
        watched_s = now - self._began
        if watched_s > RATE_OVER_S and len(recent) >= first:
            return 60.0 * len(recent) / max(now - recent[0], 1e-3)
        return 60.0 * self._count / max(watched_s, 1e-3)


def left_s(counts: Mapping[str, int], at_most: int, per_minute: float | None) -> float:
    """Return the longest remaining time in seconds; infinite if the rate is unknown."""
    if not per_minute:
        return math.inf
    return 60.0 * max(0, at_most - ended_of(counts)) / per_minute


LINE_EVERY_S = 10.0
# Rows of the panel that lines do not repeat; the report has the note on the best candidate.
_ONCE = ("", "phase", "page", "dashboard")


def progress_observer(console: Console) -> "Progress":
    """Return a live panel for a terminal, plain lines for a log."""
    return LiveProgress(console) if console.is_terminal else PlainProgress(console)


class Progress(Observer):
    """Counts of evaluations, displayed by `LiveProgress` and `PlainProgress`.

    Parameters
    ----------
    console : rich.console.Console
        The output console.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.facts: StudyFacts | None = None
        self.counts: Counter[str] = Counter()
        self.complete = 0
        self.evaluations = 0
        self.ended_in_generation = 0
        self.ranked = BestSoFar()
        self.phase = "starting"
        self._pace = Pace()

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *error: object) -> None:
        """Stop the display."""

    def started(self, facts: StudyFacts) -> None:
        """Store the facts of the study."""
        self.facts = facts
        self.phase = "preparing body and mesh"

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Set the next phase."""
        self.phase = "making the target" if what == "case" else "searching"

    def generation_begun(self, number: int, evaluations: int) -> None:
        """Reset the counts of the generation."""
        self.phase = "searching"
        self.evaluations = evaluations
        self.ended_in_generation = 0

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Count the evaluation, and update the best."""
        self.counts[record.status.value] += 1
        self.ended_in_generation += 1
        if not replayed and not record.reused:
            self._pace.add(sum(record.seconds.values()))
        self.ranked.add(record)

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Count the complete generation."""
        self.complete = number + 1
        self.evaluations = 0

    def stopped(self, reason: str) -> None:
        """Store the reason why the search stopped."""
        self.phase = f"stopped: {reason}"

    @property
    def best(self) -> EvaluationRecord | None:
        """Return the best candidate so far."""
        return self.ranked.record

    @property
    def ended(self) -> int:
        """Return the number of candidates that have an ending."""
        return ended_of(self.counts)

    @property
    def per_minute(self) -> float:
        """Return the evaluations per minute computed by this run; 0 if unknown."""
        workers = 1 if self.facts is None else self.facts.workers
        return self._pace.per_minute(workers) or 0.0

    @property
    def left_s(self) -> float:
        """Return the seconds to the last generation at the current rate; infinite if unknown."""
        most = 0 if self.facts is None else self.facts.most_evaluations
        return left_s(self.counts, most, self.per_minute)

    def rows(self) -> list[tuple[str, str]]:
        """Return the lines to show, as (heading, text)."""
        rows = [("phase", self.phase)]
        facts = self.facts
        if facts is None:
            return rows
        generations = generations_text(self.complete, facts.generations)
        if self.evaluations:
            next_ones = f"{self.ended_in_generation} of {self.evaluations} candidates of the next"
            generations += f"; {next_ones}"
        rows.append(("generations", generations))
        if self.best is not None and self.best.score is not None:
            score = self.best.score
            own = facts.objective.text(score, 4)
            scores = f"{own}   JC {score['jc']:.4f}   MHD {score['mhd_mm']:.4g} mm"
            rows.append(("best so far", f"{scores}   (candidate {self.best.candidate})"))
            if self.ranked.note:
                rows.append(("", self.ranked.note))
        rows.append(("evaluations", evaluations_text(self.counts, facts.most_evaluations)))
        if self.per_minute:
            rate = f"{self.per_minute:.1f} per minute on {facts.workers} workers"
            rows.append(("rate", f"{rate}, at most {clock(self.left_s)} left"))
        rows.append(("page", f"{_page(facts)}, new after every generation"))
        if facts.dashboard:
            rows.append(("dashboard", facts.dashboard))
        return rows


class LiveProgress(Progress):
    """A live panel."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._live = Live(console=console, refresh_per_second=2, get_renderable=self._render)

    def __enter__(self) -> "LiveProgress":
        self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def _render(self) -> RenderableType:
        table = Table.grid(padding=(0, 2))
        for heading, text in self.rows():
            table.add_row(Text(heading, style="dim"), Text(text))
        if self.facts is None:
            return table
        bar = ProgressBar(total=self.facts.most_evaluations, completed=self.ended, width=60)
        return Group(Text(self.facts.name, style="bold"), table, bar)


class PlainProgress(Progress):
    """One line for each generation, and occasional ones within it."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._last = 0.0

    def started(self, facts: StudyFacts) -> None:
        """Print the location of the study and of its page."""
        super().started(facts)
        where = f", dashboard {facts.dashboard}" if facts.dashboard else ""
        self._line(f"{facts.name}: {facts.workers} workers, study folder {facts.folder}{where}")
        self._line(f"page: {_page(facts)}, new after every generation")

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Print that the case or the target is in the store."""
        super().prepared(what, record)
        self._line(f"{what} prepared")

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Print the progress occasionally."""
        super().evaluation_ended(record, replayed)
        if not replayed and time.monotonic() - self._last >= LINE_EVERY_S:
            shown = [row for row in self.rows() if row[0] not in _ONCE]
            self._line("; ".join(f"{heading} {text}".strip() for heading, text in shown))

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Print the best score."""
        super().generation_ended(number, generation)
        best = self.best.score if self.best is not None else None
        objective = GSF if self.facts is None else self.facts.objective
        text = (
            f"best {objective.text(best, 6)}, JC {best['jc']:.4f}, MHD {best['mhd_mm']:.4g} mm"
            if best
            else "no candidate has a score yet"
        )
        self._line(f"generation {number + 1} done: {text}; {self.ended} evaluations")

    def stopped(self, reason: str) -> None:
        """Print the reason why the search stopped."""
        super().stopped(reason)
        self._line(f"stopped: {reason}")

    def _line(self, text: str) -> None:
        self._last = time.monotonic()
        self.console.print(text, markup=False, highlight=False, soft_wrap=True)


def clock(seconds: float) -> str:
    """Return a duration as text.

    Examples
    --------
    >>> clock(42.3), clock(3700), clock(200_000)
    ('42 s', '1 h 1 min', '2 d 7 h')
    """
    if not math.isfinite(seconds):
        return "unknown"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, hours, days = whole // 60, whole // 3600, whole // 86400
    if minutes < 60:
        return f"{minutes} min {whole % 60} s"
    return f"{hours} h {minutes % 60} min" if days == 0 else f"{days} d {hours % 24} h"


def _page(facts: StudyFacts) -> str:
    return str(StudyLayout(Path(facts.folder)).report)
