"""Progress of a batch: one line, updated on a terminal and repeated every 10 s elsewhere."""

import time
from collections import Counter
from typing import Literal, Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from palpate.service.study.count import FAILED, Pace, ended_of, left_s
from palpate.service.study.observers.hooks import Observer, StudyFacts
from palpate.service.study.observers.progress import LINE_EVERY_S, clock
from palpate.storage.records.record import EvaluationRecord
from palpate.storage.records.tasks import PreparedBody, PreparedTarget


class BatchProgress(Observer):
    """A counter of completed candidates, as an observer and a context manager.

    Parameters
    ----------
    console : rich.console.Console
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self.counts: Counter[str] = Counter()
        self.of = self.reused = 0
        self.workers = 1
        self.phase = "starting"
        self._pace = Pace()
        self._last = time.monotonic()
        self._live = Live(console=console, refresh_per_second=2, get_renderable=self._render)

    def __enter__(self) -> Self:
        if self.console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def started(self, facts: StudyFacts) -> None:
        """Store the number of candidates."""
        self.of, self.workers = facts.most_evaluations, facts.workers
        self.phase = "preparing body and mesh"

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Store the next phase."""
        self.phase = "making the target" if what == "case" else ""

    def evaluation_ended(self, record: EvaluationRecord, replayed: bool) -> None:
        """Count a candidate, and print a line from time to time."""
        self.counts[record.status.value] += 1
        self.reused += record.reused
        if not record.reused:
            self._pace.add(sum(record.seconds.values()))
        if not self.console.is_terminal and time.monotonic() - self._last >= LINE_EVERY_S:
            self._last = time.monotonic()
            self.console.print(self.text, markup=False, highlight=False, soft_wrap=True)

    @property
    def text(self) -> str:
        """The progress of the batch as text."""
        if self.phase:
            return self.phase
        parts = [f"{ended_of(self.counts):,} of {self.of:,} candidates"]
        parts += [f"{self.counts[status]:,} {status}" for status in FAILED if self.counts[status]]
        parts += [f"{self.reused:,} reused"] if self.reused else []
        per_minute = self._pace.per_minute(self.workers)
        if per_minute:
            workers = "1 worker" if self.workers == 1 else f"{self.workers} workers"
            left = clock(left_s(self.counts, self.of, per_minute))
            parts.append(f"{per_minute:.1f} per minute on {workers}, {left} left")
        return "; ".join(parts)

    def _render(self) -> Text:
        return Text(self.text)
