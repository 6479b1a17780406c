"""An acquisition before its loaded scans are made.

It comprises the reference scan, the planned loads, the segmentation noise and the model with its
plausible constants. With the loaded scans, it becomes an inverse problem.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from palpate.storage.values import Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.comparison.observation.interface_residual import (
    GLANDULAR,
    OUTLINE,
    Interface,
    Observed,
    interface_points,
    observe,
    residual,
)
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise, covariance
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.problem.inverse_problem import (
    FreeConstant,
    InverseProblem,
    Scan,
    Values,
)
from palpate.workers.diagnosis.problem.prepared_parts import (
    BODY,
    POINTS,
    SHAPES,
    Prepared,
    ReadPrepared,
    arrays_of_distances,
    arrays_of_points,
    arrays_of_volume,
    distances_of,
    points_of,
    scan_preparation,
    shapes,
    volume_of,
)
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.boundary_value_problem import Frame, Problem, frame_of
from palpate.workers.mechanics.fem.discretisation import Model, prepare

ProblemBuilder = Callable[[Values], Problem]
"""Function that builds the problem of one load from values of the free constants."""

INTERFACES: Sequence[Interface] = (OUTLINE, GLANDULAR)


@dataclass(frozen=True, eq=False)
class Acquisition:
    """A body at rest, the loads under which it is scanned, and the model of both.

    Parameters
    ----------
    name : str
        The name given by the user.
    reference : Volume
        `Tissue` labels of the body at rest, on whose interfaces the points are placed.
    body : callable
        Returns the volume to be meshed.
    mesh : callable
        Meshes the volume with a given number of nodes.
    noise : SegmentationNoise
    free : sequence of FreeConstant
        Constants of the model that the scans must determine.
    loads : sequence of str
        Names of the loaded scans.
    problem : callable
        Builds the problem of a load from its index and the frame of the body.
    effects : sequence of Effect
        Catalogue of effects that may be missing from the model.
    pose_sd : tuple of float
        Prior standard deviation of a scan's pose relative to its header: along each axis in mm,
        about each axis in degrees.
    """

    name: str
    reference: Volume
    body: Callable[[], Volume]
    mesh: Callable[[Volume, int], Hierarchy]
    noise: SegmentationNoise
    free: Sequence[FreeConstant]
    loads: Sequence[str]
    problem: Callable[[int, Frame], ProblemBuilder]
    effects: Sequence[Effect]
    pose_sd: tuple[float, float] = (SETTINGS.pose.shift_sd_mm, SETTINGS.pose.turn_sd_deg)


def prepare_scan(
    acquisition: Acquisition, name: str, spacing_mm: float, loaded: Sequence[Volume] = ()
) -> Prepared:
    """Make a part of the inverse problem, named in `workers.diagnosis.problem.prepared_parts`.

    Raises
    ------
    InputError
        If a scan shows no body or no glandular tissue.
    """
    if name == BODY:
        return arrays_of_volume(acquisition.body())
    if name == POINTS:
        clear_mm = SETTINGS.points.clear_noises * acquisition.noise.sd_mm
        margin_mm = SETTINGS.points.wall_margin_mm
        reference = acquisition.reference
        points = interface_points(reference, INTERFACES, spacing_mm, margin_mm, clear_mm)
        return arrays_of_points(points)
    if name == SHAPES:
        return shapes(acquisition.reference, INTERFACES)
    number = [scan_preparation(n) for n in range(len(loaded))].index(name)
    return arrays_of_distances(observe(loaded[number], INTERFACES))


def finer_model(
    acquisition: Acquisition, nodes: int, prepared: ReadPrepared | None = None
) -> Model:
    """Return another mesh of the body, with approximately the given number of nodes."""
    body = acquisition.body() if prepared is None else volume_of(prepared(BODY))
    return prepare(acquisition.mesh(body, nodes))


def inverse_problem_of(
    acquisition: Acquisition,
    nodes: int,
    spacing_mm: float,
    loaded: Sequence[Volume] = (),
    prepared: ReadPrepared | None = None,
) -> InverseProblem:
    """Mesh the body and place points on its interfaces, for comparison with the loaded scans.

    Parameters
    ----------
    acquisition : Acquisition
    nodes : int
        Number of nodes of the mesh.
    spacing_mm : float
        Distance between neighbouring points on the interfaces.
    loaded : sequence of Volume
        `Tissue` labels under each load, in order. Without them, the problem has no scans, and its
        covariance is for a single scan.
    prepared : callable, optional
        Returns the stored result of `prepare_scan`; by default, the part is made here.

    Raises
    ------
    InputError
        If a scan shows no body or no glandular tissue.
    """
    read = prepared or (lambda name: prepare_scan(acquisition, name, spacing_mm, loaded))
    hierarchy = acquisition.mesh(volume_of(read(BODY)), nodes)
    model, noise = prepare(hierarchy), acquisition.noise
    frame = frame_of(model.finest.nodes)
    points = points_of(read(POINTS))
    states = max(1, len(loaded))
    return InverseProblem(
        model=model,
        frame=frame,
        points=points,
        at_points=interpolation_at_points(hierarchy.finest.mesh, points.points),
        free=acquisition.free,
        scans=[
            _scan(acquisition, number, frame, distances_of(read(scan_preparation(number))))
            for number in range(len(loaded))
        ],
        noise=noise,
        covariance=covariance(points, noise, states),
        bias=np.zeros(len(points) * states),
        pose_sd=acquisition.pose_sd,
    )


def _scan(acquisition: Acquisition, number: int, frame: Frame, observed: Observed) -> Scan:
    return Scan(
        acquisition.loads[number],
        acquisition.problem(number, frame),
        partial(residual, observed=observed),
        interface_mm2=[one.interface_mm2 for one in observed.distances],
        voxel_mm=observed.distances[0].spacing_mm,
    )
