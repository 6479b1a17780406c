"""The page of a service in a browser, operated by the tests."""

import re
import time
from dataclasses import dataclass, field
from typing import Any

PATIENCE_MS = 60_000


@dataclass
class Shown:
    """The page in a browser, with its errors and outside requests."""

    page: Any
    url: str
    problems: list[str] = field(default_factory=list)
    elsewhere: list[str] = field(default_factory=list)

    def open(self, job: str = "") -> None:
        """Go to a job, or to the list."""
        self.page.goto(f"{self.url}/#/{job}")
        self.page.wait_for_selector(f"h1:has-text('{job or 'Studies and diagnoses'}')")

    def state(self, state: str) -> None:
        """Wait until the job has a state."""
        self.page.wait_for_selector(f"header .badge.{state}", timeout=PATIENCE_MS)

    def drawn(self) -> int:
        """Return the number of evaluations in the chart of scores."""
        return int(self.page.get_attribute("canvas[data-chart=convergence]", "data-drawn") or 0)

    def wait_drawn(self, count: int) -> None:
        """Wait until the chart shows a number of evaluations."""
        until = time.monotonic() + PATIENCE_MS / 1000
        while self.drawn() < count:  # wait_for_function evaluates a string, which the page forbids
            assert time.monotonic() < until, f"{self.drawn()} of {count} are drawn"
            self.page.wait_for_timeout(50)

    def act(self, action: str) -> None:
        """Press a button of the job."""
        self.page.click(f"[data-action={action}]")

    def show_the_best(self) -> None:
        """Wait until the viewers show the best candidate, requesting it if offered."""
        best = self.page.inner_text("#convergence button").strip()
        assert best == "open the best candidate"
        offer = self.page.locator("#bodies button:has-text('now the best')")
        until = time.monotonic() + 4 * PATIENCE_MS / 1000  # it starts one or two processes
        while not re.match(r"Candidate \d+", self.page.inner_text("#bodies .note")) or (
            offer.is_visible()
        ):
            assert time.monotonic() < until
            if offer.is_visible():
                offer.click()
            self.page.wait_for_timeout(100)
        self.page.wait_for_selector('[data-viewer="body"] canvas.body')

    def settled(self) -> None:
        """Wait until the drawing is up to date."""
        self.page.evaluate("() => new Promise(r => requestAnimationFrame(() => setTimeout(r, 30)))")
