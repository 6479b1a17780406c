"""The acquisition described by a case: its body, loads and noise."""

from palpate.storage.values import Volume
from palpate.workers.body.mesh.hierarchy import Hierarchy
from palpate.workers.body.mesh.whole_body import mesh_whole_body
from palpate.workers.comparison.observation.smooth_outline import smooth_outline
from palpate.workers.diagnosis.problem.acquisition import Acquisition
from palpate.workers.organs.breast.case.scanned_case import ScannedCase


def acquisition_of(case: ScannedCase) -> Acquisition:
    """Return the acquisition of a case, without its loaded scans.

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
    """Mesh a body with approximately the given number of nodes."""
    return mesh_whole_body(body, nodes=nodes)


def body_of(case: ScannedCase) -> Volume:
    """Return the volume to be meshed: the reference scan, smoothed if its segmentation is rough."""
    if not case.noise.reference_sd_mm:
        return case.reference
    return smooth_outline(case.reference, case.noise.correlation_mm)
