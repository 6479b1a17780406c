"""Diagnosis of scans, of a study or of a bench experiment."""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.service.diagnosis.diagnosis_run import (
    FinishedDiagnosis,
    finished,
    request_for,
    run_and_tell,
    with_caveats,
)
from palpate.service.diagnosis.diagnosis_words import sentence
from palpate.service.errors_and_interrupts import Interrupted
from palpate.service.report.diagnosis.diagnosis_page import render_diagnosis
from palpate.service.report.notebook_html import diagnosis_html
from palpate.service.study.study_session import session
from palpate.storage.backends.atomic_files import write_file
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.tasks.diagnosis_sources import check_source, open_source, source_caveats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Diagnosis", "diagnose"]


class Diagnosis(FinishedDiagnosis):
    """A completed diagnosis; see `diagnose`.

    - ``summary``: ``verdict``, ``primary`` (the named effects), ``effects`` with their
      gains and magnitudes, ``constants`` and ``gap_mm``,
    - ``maps``: read-only arrays of the points on the interfaces and their residuals in mm,
    - ``scans``: the names of the loaded scans.
    """

    def plot_gap(self) -> "Figure":
        """Plot the gap with and without the named effects, and the residuals of all points."""
        # These load matplotlib, which is rarely needed.
        from palpate.service.report.drawing.matplotlib_figures import on_white
        from palpate.service.report.notebook_figures import gap_figure

        return on_white(gap_figure(self))

    def __repr__(self) -> str:
        return f"<Diagnosis of {self.summary.case}: {sentence(self.summary)}"[:498] + ">"

    def _repr_html_(self) -> str:
        return str(diagnosis_html(self))


def diagnose(
    source: str | Path,
    *,
    nodes: int = SETTINGS.mesh.nodes,
    effects: Iterable[str] | None = None,
    workers: int | str | None = None,
    scheduler: str | None = None,
    store: str | Path = "runs/store",
    page: str | Path | None = None,
    anyway: bool = False,
) -> Diagnosis:
    """Find where, why and by how much a simulated and a real body differ.

    Stored results are reused, and an interrupted diagnosis continues.

    Parameters
    ----------
    source : str or Path
        A folder of scans with its case file, the folder of a completed study, or the
        YAML file of a bench experiment.
    nodes : int
        Approximate number of nodes of the mesh.
    effects : iterable of str, optional
        Suspected effects. Default: the whole catalogue.
    workers : int or str, optional
        Number of local processes, or ``"1-8"`` to follow the workload. Default: as many as fit.
    scheduler : str, optional
        Address of a Dask scheduler to use instead, such as ``"tcp://host:8786"``.
    store : str or Path
        Folder visible to all workers, or ``s3://``, ``gs://`` or ``az://BUCKET/PREFIX``.
    page : str or Path, optional
        Path of the HTML page to write.
    anyway : bool
        Diagnose even if the inputs look implausible; the diagnosis then carries a warning.

    Returns
    -------
    Diagnosis
        ``summary`` with verdict, gains, magnitudes and gaps in mm; ``maps`` with
        the residuals on the interfaces in mm.

    Raises
    ------
    InputError
        If the source cannot be diagnosed.
    ClusterError, TaskError
        If the workers cannot do the work; completed work is saved.
    KeyboardInterrupt
        On Ctrl-C; completed work is saved, and repeating the call continues.
    """
    opened = open_source(Path(source), store)
    findings = check_source(opened, anyway=anyway)
    for finding in findings:
        warnings.warn(finding.text, stacklevel=2)
    request = request_for(opened, store, nodes, effects=effects)
    diagnosis = finished(request)
    if diagnosis is None:
        try:
            with session(scheduler, workers) as at_hand:
                diagnosis = run_and_tell(
                    request, at_hand.dispatcher, Path(source), lambda step: None
                )
        except Interrupted:
            raise KeyboardInterrupt from None
    diagnosis = with_caveats(diagnosis, source_caveats(opened, findings))
    if page is not None:
        write_file(Path(page), render_diagnosis(diagnosis).encode())
    return Diagnosis(diagnosis.summary, diagnosis.maps, diagnosis.scans)
