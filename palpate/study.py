"""Studies: created from files or mappings, run on a cluster, read as arrays, compared."""

import warnings
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from palpate.diagnosis import Diagnosis, diagnose
from palpate.results import StudyResults
from palpate.service.errors_and_interrupts import Interrupted
from palpate.service.installed_packages import frame_type
from palpate.service.report.notebook_html import comparison_html, spec_html
from palpate.service.report.study.comparison_page import write_comparison
from palpate.service.report.study.study_data import read_study_data
from palpate.service.report.study.study_page import write_report
from palpate.service.results.results_as_json import evaluation_columns
from palpate.service.results.study_comparison import StudyComparison, compare_studies
from palpate.service.run_study import Entrance, run_study
from palpate.service.simulation.candidate_batch import BatchProgress, evaluate_batch, plan_batch
from palpate.service.simulation.candidate_tables import Evaluations, design_columns
from palpate.service.study.loop import Study as StudyLoop
from palpate.service.study.study_events import Observer
from palpate.service.study.study_folder import read_study
from palpate.service.study.study_keys import StudySpec, read_spec
from palpate.service.study.study_progress import progress_observer
from palpate.service.study.study_session import chosen_session
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import has_volume, load_volume
from palpate.volumes import Volume
from palpate.workers.common_keys import validated

if TYPE_CHECKING:
    from distributed import Client
    from pandas import DataFrame


def study_spec(spec: Mapping[str, Any]) -> StudySpec:
    """Return the specification of a study, including defaults.

    Parameters
    ----------
    spec : mapping
        The keys of a study file; ``palpate new breast NAME`` writes one that explains every
        key.

    Raises
    ------
    InputError
        If a key is not valid; the message names each one and the expected value.
    """
    return validated(StudySpec, spec, "The study")


class Study:
    """One study and its folder.

    Parameters
    ----------
    spec : StudySpec
        See `study_spec`.
    folder : str or Path, optional
        Folder of the study, created when it runs. Default: ``runs/NAME``.
    """

    def __init__(self, spec: StudySpec, folder: str | Path | None = None) -> None:
        self.spec = spec
        self.folder = Path(folder) if folder is not None else Path("runs", spec.name)

    @classmethod
    def from_file(cls, path: str | Path, folder: str | Path | None = None) -> Self:
        """Read a study file.

        Raises
        ------
        InputError
            If the file does not exist, or a key or value is not valid.
        """
        return cls(read_spec(Path(path)), folder)

    @classmethod
    def from_dict(cls, spec: Mapping[str, Any], folder: str | Path | None = None) -> Self:
        """Create a study from the keys of a study file.

        Raises
        ------
        InputError
            If a key or value is not valid.
        """
        return cls(study_spec(spec), folder)

    @classmethod
    def open(cls, folder: str | Path) -> Self:
        """Open a study that has started.

        Raises
        ------
        InputError
            If the folder is not a study.
        """
        return cls(read_spec(StudyLayout(Path(folder)).study), folder)

    def run(
        self,
        *,
        workers: int | str | None = None,
        scheduler: str | None = None,
        client: "Client | None" = None,
        in_process: bool = False,
        store: str | Path | None = None,
        progress: bool = False,
        observers: Iterable[Observer] = (),
        anyway: bool = False,
    ) -> StudyResults:
        """Run the study, or continue it.

        Parameters
        ----------
        workers : int or str, optional
            Number of local processes, or ``"1-8"`` to follow the workload. Default: as many as
            fit.
        scheduler : str, optional
            Address of a Dask scheduler to use instead, such as ``"tcp://host:8786"``.
        client : distributed.Client, optional
            A connected client to use instead, with single-threaded workers; it stays open.
        in_process : bool
            Evaluate in this process, one candidate after the other. No main guard is needed.
        store : str or Path, optional
            Store of volumes and evaluations visible to all workers: a folder, or ``s3://``,
            ``gs://`` or ``az://BUCKET/PREFIX``. Default: the store of the last run, else
            ``store`` next to the study's folder.
        progress : bool
            Show a progress bar.
        observers : iterable of Observer
            Called at every generation and evaluation.
        anyway : bool
            Run the study even if its inputs look implausible; its results then carry a warning.

        Raises
        ------
        InputError
            If the case or the target is not valid or not plausible.
        StoreError
            If the store cannot be used, or the study is running already.
        ClusterError
            If the workers cannot do the work; completed evaluations are saved.
        KeyboardInterrupt
            On Ctrl-C; completed evaluations are saved, and repeating the call continues.
        """
        from rich.console import Console

        opened = chosen_session(
            workers=workers, scheduler=scheduler, client=client, in_process=in_process
        )
        bar = progress_observer(Console(stderr=True)) if progress else None
        shown = [] if bar is None else [bar]
        loop = StudyLoop(self.spec, self.folder, store, observers=[*shown, *observers])
        entrance = Entrance(
            anyway=anyway,
            elsewhere=scheduler is not None or client is not None,
            warn=lambda text: warnings.warn(text, stacklevel=6),
            shown=bar or nullcontext(),
        )
        try:
            run_study(loop, opened, entrance)
        except Interrupted:
            raise KeyboardInterrupt from None
        return self.results

    def evaluate(
        self,
        table: Any,
        *,
        workers: int | str | None = None,
        scheduler: str | None = None,
        client: "Client | None" = None,
        in_process: bool = False,
        store: str | Path | None = None,
        progress: bool = False,
        anyway: bool = False,
    ) -> Evaluations:
        """Evaluate your own candidates against the target of the study.

        Stored evaluations, including the study's own, are reused, so repeating an interrupted call
        continues it. The row of a candidate that does not converge gives the reason.

        Parameters
        ----------
        table : mapping, DataFrame, structured array, or list of mappings
            A column for each constant, named as in a study file, such as ``E_fat_kpa``, or a
            mapping for each candidate; see also `design`. Other constants keep the values of
            the case.
        workers, scheduler, client, in_process, store, progress, anyway
            See `run`.

        Raises
        ------
        InputError
            If a value is not valid, before any work starts; the message names its row and column.
        StoreError, ClusterError, KeyboardInterrupt
            As in `run`.
        """
        from rich.console import Console

        opened = chosen_session(
            workers=workers, scheduler=scheduler, client=client, in_process=in_process
        )
        plan = plan_batch(self.spec, table, self.folder, store)
        elsewhere = scheduler is not None or client is not None
        for finding in plan.check(anyway=anyway, elsewhere=elsewhere):
            warnings.warn(finding.text, stacklevel=2)
        bar = BatchProgress(Console(stderr=True)) if progress else None
        try:
            with opened as session, bar or nullcontext():
                shown = [] if bar is None else [bar]
                return evaluate_batch(plan, session.dispatcher, observers=shown)
        except Interrupted:
            raise KeyboardInterrupt from None

    def design(
        self, n: int = 64, kind: str = "sobol", seed: int = 1
    ) -> dict[str, NDArray[np.float64]]:
        """Return a space-filling design of the searched intervals, for `evaluate`.

        Parameters
        ----------
        n : int
            Number of candidates; for a Sobol design a power of two.
        kind : {"sobol", "halton", "latin-hypercube"}
        seed : int

        Returns
        -------
        dict of str to ndarray, shape (n,)
            Values of each searched parameter by its name.
        """
        return design_columns(self.spec.search.space, kind, n, seed)

    @property
    def results(self) -> StudyResults:
        """Read the results so far, even while the study is running.

        Raises
        ------
        InputError
            If it has not started.
        """
        return StudyResults.read(self.folder)

    def candidates(self) -> dict[str, NDArray[Any]]:
        """Return all completed evaluations as arrays of equal length.

        Returns
        -------
        dict of str to ndarray
            ``candidate``, ``generation`` and ``status``; the searched parameters by their
            names with units; ``jc``, ``mhd_mm`` and ``gsf``, NaN without a score; ``reason``.
        """
        _, log = read_study(self.folder)
        return evaluation_columns(log.endings, self.spec.search.parameters)

    def table(self) -> "DataFrame":
        """Return `candidates` as a pandas table.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        return self.results.to_frame()

    def volume(self, which: Literal["reference", "target", "best"] | int) -> Volume:
        """Return a body of the study as labels.

        Parameters
        ----------
        which : {"reference", "target", "best"} or int
            The undeformed body, the target, or the deformed body of the best candidate; or the
            number of a candidate whose body is stored, see `keep` in the study file.

        Raises
        ------
        InputError
            If it is not in the store.
        """
        if not isinstance(which, str):
            return self._deformed(which)
        if which not in ("reference", "target", "best"):
            raise InputError(
                f"volume {which}: expected reference, target, best or the number of a candidate."
            )
        bodies = read_study_data(self.folder).bodies
        volume = getattr(bodies, which)
        if volume is None:
            raise InputError(f"The study has no {which} volume. {' '.join(bodies.missing)}")
        return Volume.of(volume)

    def _deformed(self, candidate: int) -> Volume:
        _, log = read_study(self.folder)
        if candidate not in log.endings or log.last_session is None:
            raise InputError(
                f"The study has no evaluation of candidate {candidate!r}; `candidates` lists all."
            )
        store, digest = open_store(log.last_session.store), log.endings[candidate].digest
        if not has_volume(store, digest):
            raise InputError(
                f"The volume of candidate {candidate} is not stored: the study has "
                f"keep: {self.spec.keep}. Run it with keep: all."
            )
        return Volume.of(load_volume(store, digest))

    def report(self) -> Path:
        """Write the report page and return its path."""
        return write_report(self.folder)

    def diagnose(self, **options: Any) -> Diagnosis:
        """Find what the model of this study lacks; see `palpate.diagnose`."""
        return diagnose(self.folder, **options)

    def __repr__(self) -> str:
        searched = ", ".join(self.spec.search.parameters)
        return f"<Study {self.spec.name} in {self.folder}: {searched}"[:498] + ">"

    def _repr_html_(self) -> str:
        if StudyLayout(self.folder).journal.is_file():
            return self.results._repr_html_()
        return str(spec_html(self.spec, f"not started; its folder will be {self.folder}"))


class Comparison(StudyComparison):
    """A comparison of studies; see `compare`.

    - ``studies``: for each study, its ``label``, ``results`` (see `StudyResults`) and
      ``lowest_scores``, the lowest score after 1, 2, 3 ... evaluations,
    - ``settings``: the keys of the study file that differ, with their values in every study,
    - ``as_dict()`` and ``as_csv()``: the record and the table of ``palpate compare``.
    """

    @classmethod
    def of(cls, found: StudyComparison) -> Self:
        """Convert a comparison to this class, which notebooks can display."""
        return cls(found.studies, found.settings, found.axis)

    def to_frame(self) -> "DataFrame":
        """Return a pandas table: one row for each constant and score of each study.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        made: DataFrame = frame_type()(list(self.rows()))
        return made

    def write_page(self, path: str | Path) -> Path:
        """Write an HTML page with charts and return its path."""
        return write_comparison(self, Path(path))

    def __repr__(self) -> str:
        labels = ", ".join(study.label for study in self.studies)
        return f"<Comparison of {len(self.studies)} studies: {labels}"[:498] + ">"

    def _repr_html_(self) -> str:
        return str(comparison_html(self))


def compare(*studies: Study | str | Path) -> Comparison:
    """Compare the results and settings of several studies.

    Parameters
    ----------
    *studies : Study, str or Path
        At least two studies or their folders; some may still be running.

    Raises
    ------
    InputError
        If there are fewer than two studies, one is given twice, or a folder is not a study.
    JournalError
        If a journal is damaged.
    """
    folders = [Path(s.folder) if isinstance(s, Study) else Path(s) for s in studies]
    return Comparison.of(compare_studies(folders))
