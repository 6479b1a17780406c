"""Plain values that all packages share: a voxel volume, a mesh, and the records of tasks.

Nothing here reads or writes files.

Coordinates are ``(x, y, z)`` in mm; voxel arrays are indexed ``[z, y, x]``, so
x runs fastest in memory (the order of ITK). In a breast x is vertical, y is the
direction of compression and z runs from the chest wall to the nipple.

The tasks of a search exchange JSON records::

    prepare_case     a case                            > PreparedBody
    make_target      a case and a target               > PreparedTarget
    evaluate         an EvaluationRequest              > EvaluationResult

Each is a dictionary at run time: it is sent through Dask and written to the store and the
journal unchanged. Optional keys are marked as such. Units are part of the names; constants are
in MPa.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from palpate.storage.errors import InputError

Triple = tuple[float, float, float]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]
BoolArray = NDArray[np.bool_]


class Tissue(IntEnum):
    """Labels of a voxel volume."""

    AIR = 0
    FAT = 1
    GLANDULAR = 2
    SKIN = 3
    MUSCLE = 4
    LIGAMENT = 5


@dataclass(frozen=True, eq=False)
class Volume:
    """Voxels with a position in space.

    Parameters
    ----------
    values : ndarray, shape (nz, ny, nx)
        Labels (``uint8``, see `Tissue`), compartment ids (``uint16``) or grey values.
    spacing_mm : tuple of float
        Distance between voxel centres along x, y and z; > 0.
    origin_mm : tuple of float
        Centre of the voxel ``values[0, 0, 0]`` as (x, y, z).
    frame_uid : str
        DICOM frame of reference of these coordinates; empty if the file names none.
    place_known : bool
        True if the file gives the position of its voxels. False if origin or orientation had to be
        assumed: such a volume cannot be compared directly with another one.

    Raises
    ------
    InputError
        If the array is not 3-D or a spacing is not a positive number.
    """

    values: NDArray[Any]
    spacing_mm: Triple
    origin_mm: Triple = (0.0, 0.0, 0.0)
    frame_uid: str = ""
    place_known: bool = True

    def __post_init__(self) -> None:
        if self.values.ndim != 3:
            raise InputError(f"A volume needs 3 axes (z, y, x), got shape {self.values.shape}.")
        if not all(np.isfinite(s) and s > 0 for s in self.spacing_mm):
            raise InputError(
                f"Voxel spacing must be positive in x, y and z, got {self.spacing_mm} mm. "
                "Give it with --spacing-mm X Y Z."
            )

    @property
    def shape_xyz(self) -> tuple[int, int, int]:
        """Return the number of voxels along x, y and z."""
        nz, ny, nx = self.values.shape
        return nx, ny, nz

    @property
    def frame_facts(self) -> list[Any]:
        """Return the frame and `place_known` if either differs from its default, else nothing.

        It is the last part of a volume's digest; omitting defaults keeps older digests valid.
        """
        if self.place_known and not self.frame_uid:
            return []
        return [self.frame_uid, self.place_known]

    @property
    def voxel_mm3(self) -> float:
        """Return the volume of one voxel."""
        return float(np.prod(self.spacing_mm))

    def on_lattice_of(self, other: "Volume", tolerance: float = 1e-3) -> bool:
        """Return True if voxel centres of both volumes coincide (the boxes may differ)."""
        spacing = np.asarray(other.spacing_mm)
        shift = (np.asarray(self.origin_mm) - other.origin_mm) / spacing
        return bool(
            np.allclose(self.spacing_mm, spacing, rtol=1e-6)
            and np.all(np.abs(shift - np.rint(shift)) < tolerance)
        )


@dataclass(frozen=True, eq=False)
class TetMesh:
    """Linear tetrahedra.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
        Coordinates (x, y, z) in mm.
    tets : ndarray of int32, shape (m, 4)
        Node numbers, positively oriented: ``det(x1-x0, x2-x0, x3-x0) > 0``.
    """

    nodes: FloatArray
    tets: IntArray


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
``min_j``; see `workers.mechanics.fem.boundary_value_problem.Outcome`."""

BodyFacts = Mapping[str, Any]
"""Properties of an undeformed body and its mesh, such as ``volume_ml``, ``nodes`` or
``element_size_mm``; see `workers.organs.organ_protocol.Organ.facts`."""


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
