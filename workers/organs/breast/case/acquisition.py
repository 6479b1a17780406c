"""The acquisition that a case describes: its body, its loads and its noise."""

from palpate.storage.values import Volume
from palpate.workers.body.mesh.hierarchy import Hierarchy
from palpate.workers.body.mesh.whole_body import mesh_whole_body
from palpate.workers.comparison.observation.smooth_outline import smooth_outline
from palpate.workers.diagnosis.problem.acquisition import Acquisition
from palpate.workers.organs.breast.case.scanned_case import ScannedCase


def acquisition_of(case: ScannedCase) -> Acquisition:
    """Return what is known of a case without looking at its loaded scans.

    Raises
    ------
    InputError
        If the case lacks the noise of the segmentation.
    """
    return Acquisition(
        name=case.file.name,
        reference=case.reference,
        body=lambda: body_of(case),
        mesh=mesh_of,
        noise=case.noise,
        free=case.free,
        loads=case.names,
        problem=case.problem,
        effects=case.file.model.laws.suspects,
        pose_sd=case.pose_sd,
    )


def mesh_of(body: Volume, nodes: int) -> Hierarchy:
    """Mesh a body with about so many nodes."""
    return mesh_whole_body(body, nodes=nodes)


def body_of(case: ScannedCase) -> Volume:
    """Return what is meshed: the reference scan without the roughness of its segmentation."""
    if not case.noise.reference_sd_mm:
        return case.reference
    return smooth_outline(case.reference, case.noise.correlation_mm)
