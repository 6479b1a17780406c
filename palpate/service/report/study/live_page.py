"""The live page of a running study, written after every generation.

A separate thread writes the page, so the search never waits for it, and it takes only a small
fraction of the time: a page is postponed until the earlier ones have cost less than that. The first
page is not counted, because it also loads shared data. Slow parts, surfaces in three dimensions and
scores by tissue, are left until the end.
"""

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from palpate.service.report.study.study_data import read_study_data
from palpate.service.report.study.study_page import render_study
from palpate.service.search.search_interface import Generation
from palpate.service.study.study_events import Observer, StudyFacts
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import PalpateError
from palpate.storage.values import PreparedBody, PreparedTarget

_log = logging.getLogger(__name__)

# Fraction of the time of the search.
SHARE = 0.01


class LivePage(Observer):
    """An observer that keeps the page of a study up to date; a context around the run.

    Parameters
    ----------
    folder : Path
        Folder of the study.
    share : float
        Maximum fraction of the time for pages, 0 to 1.
    clock : callable
        Returns the time in seconds.
    """

    def __init__(
        self, folder: Path, share: float = SHARE, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.folder = folder
        self.share = share
        self.clock = clock
        self.spent_s = 0.0
        self.pages = 0
        self._began = clock()
        self._wanted = threading.Event()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="page", daemon=True)

    @property
    def path(self) -> Path:
        """Return the path of the page."""
        return StudyLayout(self.folder).report

    def __enter__(self) -> "LivePage":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._wanted.set()
        self._thread.join()

    def prepared(
        self, what: Literal["case", "target"], record: PreparedBody | PreparedTarget
    ) -> None:
        """Write the first page once there is a target."""
        if what == "target":
            self._wanted.set()

    def generation_ended(self, number: int, generation: Generation) -> None:
        """Schedule an update of the page."""
        self._wanted.set()

    def started(self, facts: StudyFacts) -> None:
        """Start counting the time."""
        self._began = self.clock()

    def due_s(self) -> float:
        """Return the seconds until the next page may be written."""
        cost = self.spent_s / max(1, self.pages - 1)
        return self._began + (self.spent_s + cost) / self.share - self.clock()

    def _keep(self) -> None:
        while True:
            self._wanted.wait()
            if self._ended.is_set() or (self.pages and self._ended.wait(max(0.0, self.due_s()))):
                return
            self._wanted.clear()
            self._write()

    def _write(self) -> None:
        began = time.thread_time()
        try:
            page = render_study(read_study_data(self.folder, quick=True))
            write_file(self.path, page.encode())
        except PalpateError as error:
            _log.warning("The page of the study could not be written: %s", error)
        except Exception:
            _log.exception("The page of the study could not be written.")
        if self.pages:
            self.spent_s += time.thread_time() - began
        self.pages += 1
