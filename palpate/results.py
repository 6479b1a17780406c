"""Results of a study, with tables, posterior samples and figures."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from palpate.service.installed_packages import frame_type
from palpate.service.report.notebook_html import results_html
from palpate.service.report.study.study_charts import posterior_figure
from palpate.service.results import result_records
from palpate.service.results.posterior_samples import Samples, draw_samples
from palpate.service.results.results_as_json import (
    estimate_columns,
    evaluation_columns,
    generation_columns,
)
from palpate.service.results.results_from_journal import study_results
from palpate.service.study.study_folder import read_study

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

Table = Literal["evaluations", "generations", "estimates"]
ViewName = Literal["coronal", "transverse", "sagittal"]


class StudyResults(result_records.StudyResults):
    """The results of a study so far.

    The most important attributes, each described in its own class:

    - ``estimates["E_fat"]``: a `ParameterEstimate` with ``estimate``, ``unit``, ``interval``,
      ``quotable`` and ``reasons``,
    - ``state``: ``"running"``, ``"stopped"`` or ``"interrupted"``, and ``stop_reason``,
    - ``best``: the record of the best candidate, and ``best_score``,
    - ``identification``: how well the image determines each constant,
    - ``counts``, ``generations``, ``failures``, ``wall_s``, ``folder``, ``spec``.
    """

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the results of the study in a folder, even while it is running.

        Raises
        ------
        InputError
            If the folder is not a study.
        JournalError
            If its journal is damaged.
        """
        found = study_results(folder)
        return cls(**{one.name: getattr(found, one.name) for one in fields(found)})

    def samples(
        self, n: int = 1000, *, seed: int = 0, constants: Sequence[str] | None = None
    ) -> Samples:
        """Draw samples from the posterior of the constants.

        The posterior is normal in the logarithms of the constants. It includes the noise of the
        image, the misfit, the mesh and the nuisance parameters; its central 90 % intervals are
        the reported ones.

        Parameters
        ----------
        n : int
            Number of draws, > 0.
        seed : int
            The same seed gives the same draws.
        constants : sequence of str, optional
            Such as ``["E_fat_kpa"]``; default: all searched ones.

        Returns
        -------
        Samples
            A mapping from names such as ``E_fat_kpa`` to arrays of shape (n,);
            ``.to_xarray()`` has the dimensions that ArviZ expects.

        Raises
        ------
        InputError
            If a constant is unknown or has no interval, with the reason.
        """
        return draw_samples(self, n, seed, constants)

    def to_frame(self, of: Table = "evaluations") -> "DataFrame":
        """Return a pandas table.

        Parameters
        ----------
        of : {"evaluations", "generations", "estimates"}
            One row for each completed evaluation, generation, or searched parameter.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        frame = frame_type()
        if of == "generations":
            return frame(generation_columns(self)).set_index("generation")
        if of == "estimates":
            return frame(estimate_columns(self)).set_index("parameter")
        _, log = read_study(self.folder)
        columns = evaluation_columns(log.endings, self.spec.search.parameters)
        return frame(columns).set_index("candidate")

    def plot_convergence(self) -> "Figure":
        """Plot the score of every evaluation and the best score so far."""
        # These load matplotlib, which is rarely needed.
        from palpate.service.report.drawing.matplotlib_figures import on_white
        from palpate.service.report.notebook_figures import convergence_figure

        _, log = read_study(self.folder)
        return on_white(convergence_figure(self, log.endings))

    def plot_posterior(self, constants: Sequence[str] | None = None) -> "Figure":
        """Plot the posterior of the constants as a corner plot.

        Parameters
        ----------
        constants : sequence of str, optional
            Such as ``["E_fat_kpa"]``; default: all searched ones.

        Raises
        ------
        InputError
            If a constant is unknown or has no interval, with the reason.
        """
        from palpate.service.report.drawing.matplotlib_figures import on_white

        return on_white(posterior_figure(self, constants))

    def plot_slices(self, view: ViewName = "coronal") -> "Figure":
        """Plot sections of the undeformed body, the target and the best candidate.

        A fourth section shows where target and best candidate differ.

        Parameters
        ----------
        view : {"coronal", "transverse", "sagittal"}
            Normal to z, x or y. The plane passes through the middle of the compared tissues.

        Raises
        ------
        InputError
            If the store has none of the volumes.
        """
        from palpate.service.report.drawing.matplotlib_figures import on_white
        from palpate.service.report.notebook_figures import slices_figure

        return on_white(slices_figure(self.folder, view))

    def _repr_html_(self) -> str:
        return str(results_html(self))
