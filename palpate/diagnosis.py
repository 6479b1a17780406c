"""Diagnosis of scans, of a study or of a bench experiment."""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from palpate.service.diagnosis.dask_observer import run_and_tell
from palpate.service.diagnosis.run import (
    FinishedDiagnosis,
    finished,
    request_for,
    with_caveats,
)
from palpate.service.diagnosis.words import sentence
from palpate.service.errors import Interrupted
from palpate.service.report.diagnosis.page import render
from palpate.service.report.notebook import diagnosis_html
from palpate.service.study.session import session
from palpate.storage.backends.atomic import write_file
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.tasks.sources import check_source, open_source, source_caveats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Diagnosis", "diagnose"]


class Diagnosis(FinishedDiagnosis):
    """A completed diagnosis; see `diagnose`.

    - ``summary``: ``verdict``, ``primary`` (the named effects), ``effects`` with their
      probabilities and magnitudes, ``constants`` and ``gap_mm``,
    - ``maps``: arrays of the points on the interfaces and their residuals in mm,
    - ``scans``: the names of the loaded scans.
    """

    def plot_gap(self) -> "Figure":
        """Plot the gap with and without the named effects, and the residuals of all points."""
        # These load matplotlib, which is rarely needed.
        from palpate.service.report.diagnosis.figures import gap_figure
        from palpate.service.report.drawing.canvas import on_white

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
        ``summary`` with verdict, probabilities, magnitudes and gaps in mm; ``maps`` with
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
    found = finished(request)
    if found is None:
        try:
            with session(scheduler, workers) as at_hand:
                found = run_and_tell(request, at_hand.dispatcher, Path(source), lambda step: None)
        except Interrupted:
            raise KeyboardInterrupt from None
    found = with_caveats(found, source_caveats(opened, findings))
    if page is not None:
        write_file(Path(page), render(found).encode())
    return Diagnosis(found.summary, found.maps, found.scans)
