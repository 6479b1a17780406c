"""What an organ offers: its base class, the specification of its study files, its nuisances.

::

    make_body > make_mesh > prepare > solve > deform > scorer

An organ inherits from `Organ` and is named by an `OrganPlugin`, through which it is searched and
evaluated. It takes and returns values: volumes or sections, meshes, displacements. How they are
stored is decided by `workers.tasks`. An `OrganSpec` states its keys and parameters and is read
without its solver. A `Nuisance` is a parameter that is uncertain but not searched, and allowed
for in intervals.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, FreeParameter, Volume
from palpate.workers.common_keys import CaseSpec, Door, ScoreSpec, TargetSpec
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from palpate.workers.mechanics.model_parameters import Bounds, Vocabulary
from palpate.workers.organs.normal_equations import NormalEquations

if TYPE_CHECKING:
    from palpate.workers.mechanics.effects.effect import Effect


@dataclass(frozen=True, slots=True)
class Nuisance:
    """One nuisance parameter.

    Parameters
    ----------
    name : str
        As in the vocabulary of the organ, or of an effect on the observation.
    group : str
        Its subject, as a noun phrase: ``the place of the scan``.
    sd : float
        Prior standard deviation, in internal units.
    lower, upper : float
        Interval that scales its step when residuals are differentiated.
    always : bool
        Whether it counts even if the residual is at the noise level, which cannot show it, as with
        an error of the force.
    """

    name: str
    group: str
    sd: float
    lower: float
    upper: float
    always: bool = False

    @property
    def free(self) -> FreeParameter:
        """Return the parameter in the form used to request derivatives."""
        return {"name": self.name, "lower": self.lower, "upper": self.upper}


@dataclass(frozen=True, slots=True)
class NuisanceEffect:
    """An effect whose parameters are nuisance parameters of every study that it concerns.

    Parameters
    ----------
    effect : Effect
    group : str
        See `Nuisance.group`.
    sd : float, optional
        Of each parameter, in internal units; default: the effect's.
    interval : (float, float), optional
        See `Nuisance.lower`; default: the parameters' own.
    of : {"model", "image", "force"}
        The uncertain quantity: the model of any target, the image of a scanned target, or the
        force measured with it.
    always : bool
        See `Nuisance.always`.
    """

    effect: "Effect"
    group: str
    sd: float | None = None
    interval: Bounds | None = None
    of: Literal["model", "image", "force"] = "model"
    always: bool = False

    @property
    def parameters(self) -> Iterator[Nuisance]:
        """The nuisance parameters, one for each parameter of the effect."""
        for p, sd in zip(self.effect.parameters, self.effect.prior_sd, strict=True):
            lower, upper = self.interval or (p.lower, p.upper)
            yield Nuisance(p.name, self.group, self.sd or sd, lower, upper, self.always)


@dataclass(frozen=True, slots=True)
class OrganSpec:
    """The keys of an organ's studies, and the parameters behind them.

    Parameters
    ----------
    case, target, score : type
        Models of the keys under ``case``, ``target`` and ``score``.
    parameters : Vocabulary
        All parameters that a study may hold or search, including effects of the model.
    nuisances : callable, optional
        Returns the unsearched parameters that intervals allow for, given a case and whether its
        target is an image. The place, scale and force of a simulated target are exact. Default
        None: the organ has no derivatives, so its constants are not fitted by them.
    """

    case: type[CaseSpec]
    target: type[TargetSpec]
    score: type[ScoreSpec]
    parameters: Vocabulary
    nuisances: Callable[[Any, bool], Sequence[Nuisance]] | None = None

    @property
    def has_derivatives(self) -> bool:
        """Whether constants can be fitted by derivatives, with `Organ.fit`."""
        return self.nuisances is not None


def no_derivatives(organ: str) -> str:
    """Return the sentence for an organ whose constants cannot be fitted by derivatives."""
    return f"the organ {organ} has no derivatives; use the strategy genetic or cma"


Arrays = dict[str, NDArray[Any]]
Facts = Mapping[str, Any]
Scores = Mapping[str, float]

Body = TypeVar("Body")
Compared = TypeVar("Compared", contravariant=True)
Mesh = TypeVar("Mesh")
Model = TypeVar("Model")


class Outcome(Protocol):
    """The outcome of a simulation."""

    @property
    def converged(self) -> bool:
        """Whether the displacement is in equilibrium."""

    @property
    def reason(self) -> str:
        """Why it diverged; empty if it converged."""

    def as_dict(self) -> Facts:
        """Return the outcome as plain values, units in their names."""


class Solution(Protocol):
    """A displacement and the outcome of its simulation."""

    @property
    def displacement_mm(self) -> FloatArray:
        """Displacement of the nodes, shape (n, dimensions)."""

    @property
    def outcome(self) -> Outcome:
        """The outcome of the simulation."""


class Score(Protocol):
    """Similarity of two bodies."""

    def as_dict(self) -> Scores:
        """Return ``jc``, ``mhd_mm``, ``mhd_voxels`` and ``gsf``."""


class Scorer(Protocol[Compared]):
    """A comparison of bodies with one target."""

    def score(self, body: Compared, /) -> Score:
        """Compare a body with the target."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Distances between the interfaces of a simulated body and of the image.

    Parameters
    ----------
    mm : ndarray, shape (m,)
        Signed distances.
    equations : NormalEquations
        Of the free parameters: of their logarithms where `logarithmic`.
    noise : str
        The noise by which the distances were divided, in words.
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
    """Check whether a parameter is fitted as its logarithm, because it cannot be zero."""
    return parameter["lower"] > 0


def either_side(
    parameter: FreeParameter, value: float, step: float
) -> tuple[float, float | None, float]:
    """Return the values on either side of a value, and their difference as it is fitted.

    The step is one of the logarithm of a parameter that is fitted as one, else relative to the
    interval. At a lower bound of zero there is only one side.
    """
    if logarithmic(parameter):
        return value * float(np.exp(step)), value * float(np.exp(-step)), 2 * step
    h = step * (parameter["upper"] - parameter["lower"])
    if parameter["lower"] == 0 and value < h:
        return value + h, None, h
    return value + h, value - h, 2 * h


class Organ(ABC, Generic[Body, Mesh, Model]):
    """An organ: its bodies and meshes, its model and its score.

    Its keys are an `OrganSpec`. It writes what is abstract here and what differs from the defaults,
    which suit a generated body that is a `Volume`, without parts, plates or derivatives.

    Parameters
    ----------
    name : str
        The name given under ``organ`` in a case.
    picture_labels : mapping of int to str
        The names of the labels of `picture`.
    """

    name: str
    picture_labels: Mapping[int, str]

    @abstractmethod
    def make_body(self, spec: Door) -> Body:
        """Read or generate a body.

        Parameters
        ----------
        spec : Door
            ``reference`` of a case, or a target that is an image.

        Raises
        ------
        InputError
            If its files cannot be read, or show no body.
        """

    @abstractmethod
    def make_mesh(self, body: Body, case: Any) -> Mesh:
        """Mesh a body.

        Raises
        ------
        InputError
            If it cannot be meshed as the case requires.
        """

    @abstractmethod
    def facts(self, body: Body, mesh: Mesh) -> Facts:
        """Return sizes, volumes and counts of body and mesh, with units in their names."""

    @abstractmethod
    def problem(
        self,
        model: Model,
        case: Any,
        constants: Mapping[str, float],
        landmarks: Any,
        target_landmarks: Any | None = None,
    ) -> Any:
        """Return the problem for the solver: materials, load and effects.

        Parameters
        ----------
        constants : mapping of str to float
            Every parameter, in internal names and units; see `CaseSpec.complete`.
        target_landmarks
            Of an imaged target; None for a simulated one and where there is none.
        """

    @abstractmethod
    def solve(self, model: Model, problem: Any) -> Solution:
        """Deform the body; failure to converge is an ordinary outcome."""

    @abstractmethod
    def deform(
        self, body: Body, mesh: Mesh, displacement_mm: FloatArray, target: Body | None = None
    ) -> Body:
        """Return the deformed body, on the lattice of the target if there is one."""

    @abstractmethod
    def scorer(self, target: Body, spec: Any) -> Scorer[Body]:
        """Return the scorer of bodies against a target."""

    def body_files(self, spec: Door) -> Sequence[Path]:
        """Return the files that `make_body` reads; none if the body is generated."""
        return ()

    def body_settings(self, spec: Door) -> Facts:
        """Return the settings besides its files on which a body depends, as plain values."""
        return spec.model_dump(mode="json")

    def stored_name(self, spec: Door) -> str | None:
        """Return the name of a body in the store, or None if the body has to be made."""
        return None

    def adapt_stored(self, body: Body, spec: Door) -> Body | None:
        """Return a stored body as `spec` describes it; None if it is used unchanged.

        Raises
        ------
        InputError
            If `spec` has keys that apply only to files, or the body is unsuitable for a study.
        """
        return None

    def body_to_arrays(self, body: Body) -> Arrays | Volume:
        """Return a body in the form of the store: a volume, or named arrays."""
        return cast(Volume, body)

    def body_from_arrays(self, arrays: Arrays | Volume) -> Body:
        """Return the body from the result of `body_to_arrays`."""
        return cast(Body, arrays)

    def aligned(self, target: Body, reference: Body, case: Any) -> tuple[Body, Facts]:
        """Return an imaged target in the frame of the undeformed body, and the motion applied.

        Facts are ``shift_mm`` and ``turn_deg``, each (x, y, z), and ``words``.

        Raises
        ------
        InputError
            If images of this organ cannot be aligned.
        """
        raise InputError(f"target.align: images of the organ {self.name} cannot be aligned.")

    def coarse(self, body: Body, spacing_mm: float) -> Body:
        """Return a body in coarser voxels; itself where it is as coarse, or has no voxels."""
        return body

    def simulated_case(self, case: Any, target: Any) -> CaseSpec:
        """Return the case for simulating a target, with the target's own mesh settings if any."""
        mesh = getattr(target, "mesh", None)
        return case if mesh is None else case.model_copy(update={"mesh": mesh})

    def mesh_settings(self, case: Any) -> Facts:
        """Return the settings of the mesh, apart from the body, as plain values."""
        return case.model_dump(mode="json", exclude={"organ", "reference", "constants"})

    def mesh_to_arrays(self, mesh: Mesh) -> Arrays:
        """Return a mesh as named arrays."""
        return cast(Arrays, mesh)

    def mesh_from_arrays(self, arrays: Arrays) -> Mesh:
        """Return the mesh from the result of `mesh_to_arrays`."""
        return cast(Mesh, arrays)

    def check(self, case: Any, body: Body, mesh_facts: Facts) -> None:
        """Check that the meshed body of a case can be modelled as specified.

        Raises
        ------
        InputError
            With the value found, the value expected and what to change.
        """
        return

    def prepare(self, mesh: Mesh) -> Model:
        """Prepare everything that depends on the mesh alone; cached for all candidates."""
        return cast(Model, mesh)

    def landmarks(self, body: Body, case: Any) -> Any:
        """Return the landmarks of a body for its load, such as its extent."""
        return None

    def pressed(self, case: Any) -> Pressed | None:
        """Return the compression by plates; None without plates."""
        return None

    def scores_by_part(self, target: Body, candidate: Body, spec: Any) -> dict[str, Scores]:
        """Return the score of each part, by name; an organ without parts is one."""
        return {self.name: self.scorer(target, spec).score(candidate).as_dict()}

    def picture(self, body: Body) -> Volume:
        """Return a body as labelled voxels, to be drawn; a section has one slice."""
        return cast(Volume, body)

    # An organ with derivatives writes these three, and states `OrganSpec.nuisances`.

    def coarse_case(self, case: Any, nodes: int) -> CaseSpec:
        """Return the case with a mesh of approximately the given number of nodes."""
        raise InputError(no_derivatives(self.name))

    def observation(self, body: Body, mesh: Mesh, target: Body, imaged: bool) -> Any:
        """Return the data of body and target for residuals; cached for all candidates.

        Parameters
        ----------
        imaged : bool
            Whether the target is an image; else it was simulated.
        """
        raise InputError(no_derivatives(self.name))

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
        """Deform the body, and differentiate its residuals with respect to the free parameters.

        The displacement equals the result of `solve` for the same problem.
        """
        raise InputError(no_derivatives(self.name))
