"""Progress of a set: a bar on a terminal, occasional lines elsewhere."""

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from palpate.service.study.observers.progress import clock

LINE_EVERY_S = 10.0


class SetProgress:
    """Progress bar for cases, on standard error.

    Parameters
    ----------
    console : rich.console.Console
    what : str
        The operation, such as "made".
    done, of : int
        Numbers of cases.
    """

    def __init__(self, console: Console, what: str, done: int, of: int) -> None:
        self.console, self.what, self.done, self.of = console, what, done, of
        self._begun = self._last = time.monotonic()
        self._bar: Progress | None = None
        if console.is_terminal:
            columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
            self._bar = Progress(*columns, console=console)
            self._task = self._bar.add_task(what, total=of, completed=done)

    def __enter__(self) -> "SetProgress":
        if self._bar is not None:
            self._bar.start()
        else:
            self._line(f"{self.of} cases, {self.done} of them already {self.what}")
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, note: str = "") -> None:
        """Count one more case; a note is printed on a separate line."""
        self.done += 1
        if self._bar is not None:
            self._bar.update(self._task, completed=self.done)
        due = time.monotonic() - self._last >= LINE_EVERY_S
        if note or (self._bar is None and (due or self.done == self.of)):
            self._line(
                f"{self.done} of {self.of} cases {self.what}" + (f": {note}" if note else "")
            )

    def _line(self, text: str) -> None:
        self._last = time.monotonic()
        spent = clock(self._last - self._begun)
        self.console.print(f"[{spent}] {text}", markup=False, highlight=False, soft_wrap=True)
