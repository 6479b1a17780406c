"""What an organ offers, so that searching and evaluating it needs to know nothing of it.

::

    make_body > make_mesh > prepare > solve > deform > scorer

An organ is a room beside this file with an object that follows `Organ`, and one line in
`workers.organs.registry`. It takes and gives values: volumes or sections, meshes,
displacements. What it is called in a store and what of it is kept there is decided by
`workers.tasks`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from numpy.typing import NDArray

from palpate.storage.records.tasks import FreeParameter
from palpate.storage.values import FloatArray, Volume
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.parameters import Vocabulary
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.organs.nuisances import Nuisance
from palpate.workers.spec import CaseSpec, Door, ScoreSpec, TargetSpec

Arrays = dict[str, NDArray[Any]]
Facts = Mapping[str, Any]
Scores = Mapping[str, float]

Body = TypeVar("Body")
Compared = TypeVar("Compared", contravariant=True)
Mesh = TypeVar("Mesh")
Model = TypeVar("Model")


class Outcome(Protocol):
    """How a simulation has ended."""

    @property
    def converged(self) -> bool:
        """Whether the displacement is in equilibrium."""

    @property
    def reason(self) -> str:
        """Why it diverged; empty when it converged."""

    def as_dict(self) -> Facts:
        """Return the outcome as plain values, units in their names."""


class Solution(Protocol):
    """A displacement and how it was reached."""

    @property
    def displacement_mm(self) -> FloatArray:
        """Displacement of the nodes, shape (n, dimensions)."""

    @property
    def outcome(self) -> Outcome:
        """How the simulation has ended."""


class Score(Protocol):
    """How alike two bodies are."""

    def as_dict(self) -> Scores:
        """Return ``jc``, ``mhd_mm``, ``mhd_voxels`` and ``gsf``."""


class Scorer(Protocol[Compared]):
    """Compares bodies with one target."""

    def score(self, body: Compared, /) -> Score:
        """Compare a body with the target."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """How far the interfaces of a simulated body are from those of the image.

    Parameters
    ----------
    mm : ndarray, shape (m,)
        Signed distances.
    equations : NormalEquations
        Of the free parameters: of their logarithms where `logarithmic`.
    noise : str
        What the distances were divided by, in words.
    """

    mm: FloatArray
    equations: NormalEquations
    noise: str


class Fitted(Protocol):
    """A solution with its residuals."""

    @property
    def solution(self) -> Solution:
        """The displacement."""

    @property
    def residuals(self) -> Residuals | None:
        """None where the solution did not converge."""


def logarithmic(parameter: FreeParameter) -> bool:
    """Return whether a parameter is fitted as its logarithm: where it cannot be zero."""
    return parameter["lower"] > 0


class Organ(Protocol[Body, Mesh, Model]):
    """One organ: its doors, its model and what is compared of it."""

    @property
    def name(self) -> str:
        """The name that a case states under ``organ``."""

    @property
    def case_spec(self) -> type[CaseSpec]:
        """What may be stated under ``case``."""

    @property
    def target_spec(self) -> type[TargetSpec]:
        """What may be stated under ``target``."""

    @property
    def score_spec(self) -> type[ScoreSpec]:
        """What may be stated under ``score``."""

    @property
    def parameters(self) -> Vocabulary:
        """All that a study may hold or search, effects of the model included."""

    @property
    def effects(self) -> Sequence[Effect]:
        """What may be missing from the model; see `workers.mechanics.effects.base`."""

    @property
    def not_simulated(self) -> Sequence[tuple[str, str]]:
        """What no effect stands for, by name, and why."""

    @property
    def picture_labels(self) -> Mapping[int, str]:
        """The names of the labels of `picture`, by number."""

    @property
    def load_direction(self) -> str:
        """How the load acts in a picture, as a sentence."""

    def body_files(self, spec: Door) -> Sequence[Path]:
        """Return the files that a body is read from; none if it is generated.

        Parameters
        ----------
        spec : Door
            ``reference`` of a case, or a target that is an image.
        """

    def body_settings(self, spec: Door) -> Facts:
        """Return all else that the body depends on, as plain values."""

    def make_body(self, spec: Door) -> Body:
        """Read or generate a body.

        Raises
        ------
        InputError
            If its files cannot be read, or show no body.
        """

    def stored_name(self, spec: Door) -> str | None:
        """Return the name of the stored body that is meant, or None where a body is made."""

    def adapt_stored(self, body: Body, spec: Door) -> Body | None:
        """Return a stored body as `spec` describes it; None if it is taken as it is.

        Raises
        ------
        InputError
            If `spec` says what only a file can have, or the body is not fit for a study.
        """

    def body_to_arrays(self, body: Body) -> Arrays | Volume:
        """Return a body as what a store keeps: a volume, or named arrays."""

    def body_from_arrays(self, arrays: Arrays | Volume) -> Body:
        """Return the body that `body_to_arrays` has taken apart."""

    def simulated_case(self, case: Any, target: Any) -> CaseSpec:
        """Return the case under which a target is simulated: its own mesh, where it has one."""

    def mesh_settings(self, case: Any) -> Facts:
        """Return what the mesh depends on beside the body, as plain values."""

    def make_mesh(self, body: Body, case: Any) -> Mesh:
        """Mesh a body.

        Raises
        ------
        InputError
            If it cannot be meshed as the case says.
        """

    def mesh_to_arrays(self, mesh: Mesh) -> Arrays:
        """Return a mesh as named arrays."""

    def mesh_from_arrays(self, arrays: Arrays) -> Mesh:
        """Return the mesh that `mesh_to_arrays` has taken apart."""

    def facts(self, body: Body, mesh: Mesh) -> Facts:
        """Return what body and mesh are like: sizes, volumes, counts, units in their names."""

    def check(self, case: Any, body: Body, mesh_facts: Mapping[str, Any]) -> None:
        """Refuse a case whose body cannot be modelled as it says.

        Raises
        ------
        InputError
            Saying what was found, what was expected and what to change.
        """

    def prepare(self, mesh: Mesh) -> Model:
        """Make ready what the mesh alone decides; kept by a process for all candidates."""

    def landmarks(self, body: Body, case: Any) -> Any:
        """Return what the load must know of a body's place, such as where it begins and ends."""

    def landmarks_depend_on(self, case: Any) -> str:
        """Return the part of the case that the landmarks depend on, as a key of a cache."""

    def problem(
        self,
        model: Model,
        case: Any,
        constants: Mapping[str, float],
        landmarks: Any,
        target_landmarks: Any | None = None,
    ) -> Any:
        """Return what the solver is asked: materials, load and effects.

        Parameters
        ----------
        constants : mapping of str to float
            Every parameter, inside names and units; see `CaseSpec.complete`.
        target_landmarks
            Of an imaged target; None for a simulated one and where there is none.
        """

    def solve(self, model: Model, problem: Any) -> Solution:
        """Deform the body; not to converge is an ordinary outcome."""

    @property
    def no_derivatives(self) -> str:
        """Why constants cannot be fitted by derivatives, as a sentence; empty where they can."""

    def nuisances(self, case: Any, imaged: bool) -> Sequence[Nuisance]:
        """Return the parameters that intervals allow for in addition to those searched.

        Parameters
        ----------
        imaged : bool
            Whether the target is an image; the place, scale and force of a simulated one are exact.
        """

    def coarse(self, body: Body, spacing_mm: float) -> Body:
        """Return a body in coarser voxels, to be fitted first; itself where it is as coarse."""

    def coarse_case(self, case: Any, nodes: int) -> CaseSpec:
        """Return the case with a mesh of about so many nodes."""

    def observation(self, body: Body, mesh: Mesh, target: Body, imaged: bool) -> Any:
        """Return what residuals need of body and target; kept by a process for all candidates.

        Parameters
        ----------
        imaged : bool
            Whether the target is an image; else it was simulated.
        """

    def fit(
        self,
        model: Model,
        case: Any,
        constants: Mapping[str, float],
        free: Sequence[FreeParameter],
        landmarks: Any,
        target_landmarks: Any | None,
        observation: Any,
    ) -> Fitted:
        """Deform the body, and differentiate its residuals by the free parameters.

        The same displacement as that of `solve` for the same problem.
        """

    def deform(
        self, body: Body, mesh: Mesh, displacement_mm: FloatArray, target: Body | None = None
    ) -> Body:
        """Return the deformed body, on the lattice of the target where there is one."""

    def scorer(self, target: Body, spec: Any) -> Scorer[Body]:
        """Return what compares bodies with a target."""

    def picture(self, body: Body) -> Volume:
        """Return a body as labelled voxels, to be drawn; a section has one slice."""

    def scores_by_part(self, target: Body, candidate: Body, spec: Any) -> dict[str, Scores]:
        """Return the score of each part of the organ on its own, by name."""


@runtime_checkable
class AligningOrgan(Protocol):
    """An organ whose imaged targets can be aligned with the undeformed body."""

    def aligned(self, target: Any, reference: Any, case: Any) -> tuple[Any, Facts]:
        """Return a target in the frame of the undeformed body, and how it was moved.

        Facts are ``shift_mm`` and ``turn_deg``, each (x, y, z), and ``words``.
        """
