"""Progress of the experiments on standard error: a bar on a terminal, lines elsewhere."""

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from palpate.service.formatting import duration
from palpate.service.study.observers.progress import clock
from palpate.service.thesis.run import Step

LINE_EVERY_S = 10.0


class ThesisProgress:
    """A bar for each phase or search; occasional lines in a log.

    Parameters
    ----------
    console : rich.console.Console
        The console of standard error.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self._begun = time.monotonic()
        self._last = 0.0
        self._cpu_s = 0.0
        self._bars: Progress | None = None
        self._tasks: dict[str, int] = {}
        if console.is_terminal:
            columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
            self._bars = Progress(*columns, TimeElapsedColumn(), console=console)

    def __enter__(self) -> "ThesisProgress":
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, step: Step) -> None:
        """Display one step."""
        self._cpu_s += step.cpu_s
        title = f"{step.experiment}: {step.title}"
        if self._bars is not None:
            if title not in self._tasks:
                self._tasks[title] = self._bars.add_task(title, total=step.of)
            self._bars.update(self._tasks[title], completed=step.done)  # type: ignore[arg-type]
            return
        now = time.monotonic()
        if not step.label or step.done == step.of or now - self._last >= LINE_EVERY_S:
            self._last = now
            label = f": {step.label}" if step.label else ""
            text = f"{title}, {step.done} of {step.of}{label}"
            spent = f"{clock(now - self._begun)}, {duration(self._cpu_s)} of processor time"
            self.console.print(f"[{spent}] {text}", markup=False, highlight=False, soft_wrap=True)
