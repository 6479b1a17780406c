"""A subject from a case: mesh, points on the interfaces, distance maps, noise."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from storage.values import Volume
from workers.cases.case import WALL_MARGIN_MM, ImagedCase
from workers.diagnosis.subject import Scan, Subject
from workers.fem.fields import frame_of
from workers.fem.model import prepare
from workers.mesh.hierarchy import build_hierarchy
from workers.observation.interface import GLANDULAR, OUTLINE, Interface, interface_points
from workers.observation.locate import interpolation
from workers.observation.noise import covariance
from workers.observation.residual import observe, residual
from workers.observation.smooth_outline import smooth_outline

INTERFACES: Sequence[Interface] = (OUTLINE, GLANDULAR)
NODES = 5000
POINT_SPACING_MM = 6.0
# Tissue on either side of a point, in standard deviations of the segmentation.
CLEAR_NOISES = 5.0


def body_of(case: ImagedCase) -> Volume:
    """What is meshed: the reference scan without the roughness of its segmentation."""
    if not case.noise.reference_sd_mm:
        return case.reference
    return smooth_outline(case.reference, case.noise.correlation_mm)


def build_subject(
    case: ImagedCase, nodes: int = NODES, spacing_mm: float = POINT_SPACING_MM
) -> Subject:
    """Make ready what every fit of the case shares.

    Parameters
    ----------
    case : ImagedCase
    nodes : int
        Of the mesh.
    spacing_mm : float
        Between neighbouring points on the interfaces.

    Raises
    ------
    InputError
        If the scans show no body or no glandular tissue.
    """
    hierarchy = build_hierarchy(body_of(case), nodes=nodes)
    model = prepare(hierarchy)
    frame = frame_of(model.finest.nodes)
    points = interface_points(
        case.reference, INTERFACES, spacing_mm, WALL_MARGIN_MM, CLEAR_NOISES * case.noise.sd_mm
    )
    scans = [
        Scan(
            name,
            case.problem(number, frame),
            partial(residual, observed=observe(labels, INTERFACES)),
        )
        for number, (name, labels) in enumerate(zip(case.names, case.deformed, strict=True))
    ]
    return Subject(
        model=model,
        frame=frame,
        points=points,
        at_points=interpolation(hierarchy.finest.mesh, points.points),
        free=case.free,
        scans=scans,
        noise=case.noise,
        covariance=covariance(points, case.noise, len(case.deformed)),
        bias=np.zeros(len(points) * len(case.deformed)),
    )
