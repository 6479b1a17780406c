"""Data of the viewers on a live page, made in a separate process, one at a time.

A body of 100 Mvoxel takes memory and seconds that the service cannot spare. The results are
stored in the folder of the job, named after the candidate shown.
"""

import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

from palpate.service.report.page.page_elements import Json
from palpate.service.report.study.study_data import Bodies, find_bodies
from palpate.service.report.study.study_pictures import body_data, slice_data
from palpate.service.report.study.study_sections import difference_legend, tissue_legend
from palpate.service.server.api_models import BodiesView
from palpate.service.server.jobs.home_and_tokens import helper_command, helper_environment
from palpate.service.study.study_folder import read_study
from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.atomic_files import write_file
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.best_candidate import best_of
from palpate.storage.errors import PalpateError, StoreError
from palpate.workers.common_keys import validated

NAME = "bodies-{candidate}.json"


class BodiesMaker:
    """A provider of the bodies of a study's best candidate."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._path = Path()
        self._failed: set[Path] = set()

    def of(self, folder: Path, candidate: int | None) -> Path | None:
        """Return the viewer file of a candidate, else the latest one; None if there is none.

        A missing file is made in the background. A search may find better candidates faster than
        they can be drawn.

        Parameters
        ----------
        folder : Path
            Folder of a study that has started.
        candidate : int or None
            The best one; None shows reference and target only.

        Raises
        ------
        StoreError
            If the file cannot be made.
        """
        path = folder / NAME.format(candidate="none" if candidate is None else candidate)
        with self._lock:
            self._look()
            if path.is_file():
                return path
            if path in self._failed:
                raise StoreError(f"The bodies of {folder.name} cannot be drawn; see the log.")
            if self._process is None:
                self._path = path
                module = "palpate.service.server.live_bodies"
                self._process = subprocess.Popen(
                    helper_command(module, str(folder), str(path)),
                    env=helper_environment(),
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                )
            return max(folder.glob(NAME.format(candidate="*")), key=_made, default=None)

    def close(self) -> None:
        """Stop the process."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
                self._process.wait()
                self._process = None

    def _look(self) -> None:
        """Check whether the process has ended, and its exit status."""
        if self._process is None or self._process.poll() is None:
            return
        if self._process.returncode != 0:
            self._failed.add(self._path)
        for older in self._path.parent.glob(NAME.format(candidate="*")):
            if older != self._path:
                older.unlink(missing_ok=True)
        self._process = None


def _made(path: Path) -> int:
    return path.stat().st_mtime_ns


def best_bodies(folder: Path) -> BodiesView:
    """Return the viewer data of a study's best candidate.

    Raises
    ------
    PalpateError
        If its journal cannot be read.
    """
    study, log = read_study(folder)
    spec = validated(StudySpec, study.spec, "The study")
    best = best_of(log.endings)
    digest = None if best is None else best.digest
    bodies = find_bodies(folder, spec, log.last_session, digest, compare=False)
    slices, body = _shown(bodies, spec)
    return BodiesView(
        ready=True,
        candidate=None if best is None else best.candidate,
        slices=slices,
        body=body,
        missing=list(bodies.missing),
        tissues=tissue_legend(bodies),
        differences=difference_legend(),
    )


def _shown(bodies: Bodies, spec: StudySpec) -> tuple[Json | None, Json | None]:
    with suppress(PalpateError):  # a body of air only
        return slice_data(bodies, spec.score.parts, spec.case), body_data(bodies, spec.case)
    return None, None


def main(folder: str, path: str) -> None:
    """Write the viewer data of the study in a folder."""
    assert StudyLayout(Path(folder)).journal.is_file()
    write_file(Path(path), best_bodies(Path(folder)).model_dump_json().encode())


if __name__ == "__main__":
    main(*sys.argv[1:])
