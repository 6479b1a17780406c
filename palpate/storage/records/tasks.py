"""Requests and results of the tasks of a search, as JSON records.

::

    prepare_case     a case                            > PreparedBody
    make_target      a case and a target               > PreparedTarget
    evaluate         an EvaluationRequest              > EvaluationResult

Each is a dictionary at run time: it is sent through Dask and written to the store and the
journal unchanged. Optional keys are marked as such. Units are part of the names; constants are
in MPa.
"""

from collections.abc import Mapping
from typing import Any, Literal, NotRequired, TypedDict

SpecJson = Mapping[str, object]
"""Part of a study file as its pydantic model writes it: a case, a target or a score."""


Scores = Mapping[str, float]
"""Similarity of two bodies, by measure.

``jc`` and ``dice`` are overlaps from 0 to 1; ``mhd_mm`` and ``mhd_voxels`` the modified
Hausdorff distance in mm and in voxels; ``gsf`` the logarithm that a search minimises, -inf
for identical bodies.
"""

OutcomeJson = Mapping[str, Any]
"""The solver's report on its result, such as ``newton_iterations``, ``residual_n`` or
``min_j``; see `workers.mechanics.fem.problem.outcome.Outcome`."""

BodyFacts = Mapping[str, Any]
"""Properties of an undeformed body and its mesh, such as ``volume_ml``, ``nodes`` or
``element_size_mm``; see `workers.organs.organ.Organ.facts`."""


class PreparedBody(TypedDict):
    """The undeformed body and its mesh, by their digests in the store."""

    volume: str
    mesh: str
    facts: BodyFacts


TargetKind = Literal["simulated", "image"]


class PreparedTarget(TypedDict):
    """The deformed body that a search tries to match, by its digest in the store.

    A simulated target also has the solver's ``outcome``, the ``constants`` it was made with
    (MPa) and the ``seconds`` of each stage. An aligned image has its ``motion``:
    ``shift_mm`` and ``turn_deg`` along and about x, y and z, and both in ``words``.
    """

    target: str
    kind: TargetKind
    outcome: NotRequired[OutcomeJson]
    constants: NotRequired[dict[str, float]]
    seconds: NotRequired[dict[str, float]]
    motion: NotRequired[Mapping[str, Any]]


class PreparedLevel(TypedDict):
    """Body, mesh and target at a coarser resolution, and the case with that mesh."""

    case: dict[str, Any]
    prepared: PreparedBody
    target: str


class FitJson(TypedDict):
    """The least-squares problem of a candidate: distances of interfaces and their derivatives.

    With the residuals r, divided by their noise, and their derivatives J with respect to the
    parameters: ``cost`` is r'r, ``gradient`` J'r, ``hessian`` J'J. A parameter is the logarithm of
    a constant if ``logarithmic``. ``parameters`` and ``values`` use internal names and units;
    ``rms_mm`` is the root mean square of the residuals; ``noise`` describes the noise they were
    divided by. Each prior of a parameter adds a residual, which ``rms_mm`` leaves out.
    """

    parameters: list[str]
    logarithmic: list[bool]
    values: list[float]
    residuals: int
    rms_mm: float
    cost: float
    gradient: list[float]
    hessian: list[list[float]]
    noise: str


class MeshFit(TypedDict):
    """The least-squares problem of a candidate on a mesh of another size."""

    nodes: int
    fit: FitJson


Prior = tuple[float, float]


class FreeParameter(TypedDict):
    """A free parameter of the residuals: internal name and units, bounds of the search.

    ``prior`` has the mean and the standard deviation of a normal distribution.
    """

    name: str
    lower: float
    upper: float
    prior: NotRequired[Prior]


class EvaluationRequest(TypedDict):
    """One candidate to be simulated and compared with the target.

    ``store`` is the path of the store, ``target`` a digest, ``constants`` are in MPa,
    ``keep_volume`` keeps the deformed volume in the store, ``digest`` is the driver's name for the
    evaluation. With ``free`` the residuals of the interfaces are differentiated with respect to
    these parameters.
    """

    store: str
    case: SpecJson
    prepared: PreparedBody
    target: str
    constants: Mapping[str, float]
    score: NotRequired[SpecJson | None]
    keep_volume: NotRequired[bool]
    digest: NotRequired[str]
    free: NotRequired[list[FreeParameter]]


class EvaluationResult(TypedDict):
    """Result of one simulation, as stored under ``digest``.

    ``reason`` explains a divergence; ``constants`` are in MPa; ``seconds`` has the time of each
    stage; ``worker`` ran it. ``score`` is None if diverged and missing if nothing was compared;
    ``volume`` is the digest of a deformed body stored under its own name; ``reused`` is True if the
    store already had the result; ``fit`` is present if the request names free parameters, and None
    if diverged.
    """

    digest: str
    status: Literal["done", "diverged"]
    reason: str
    outcome: OutcomeJson
    constants: dict[str, float]
    seconds: dict[str, float]
    worker: str
    score: NotRequired[Scores | None]
    volume: NotRequired[str | None]
    reused: NotRequired[bool]
    fit: NotRequired[FitJson | None]
