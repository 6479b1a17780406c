"""Provenance of a diagnosis, from its source and request."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from palpate.service.formatting import count, number
from palpate.service.report.study.provenance import Made
from palpate.storage.digest import array_digest
from palpate.workers.diagnosis.outcome.source import PressedSource, Source
from palpate.workers.mechanics.pressed import Pressed
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest


@dataclass(frozen=True)
class Origin:
    """Provenance of a diagnosis, and the loads of its scans by name."""

    made: Made = field(default_factory=Made)
    loads: Mapping[str, Pressed] = field(default_factory=dict)


def origin_of(
    source: Source,
    request: DiagnosisRequest,
    when: str,
    command: str,
    seconds: float | None,
    nodes: int | None = None,
) -> Origin:
    """Return the provenance of a diagnosis for its page.

    Parameters
    ----------
    source : Source
        Source of the diagnosis.
    request : DiagnosisRequest
    when : str
        Date and time, ISO 8601.
    command : str
        Command line.
    seconds : float or None
        Run time; None if the diagnosis came from the store.
    nodes : int, optional
        Nodes of the mesh. Default: the requested number.
    """
    volumes = source.content.volumes
    inputs = [(f"{request.source.kind} {source.name}", request.source.digest)]
    inputs += [(name.replace("_", " "), array_digest(v.values)) for name, v in volumes.items()]
    points = f"points {number(request.spacing_mm, 2)} mm apart"
    mesh = f"about {count(nodes or request.nodes)} nodes; {points}"
    loads = source.pressed if isinstance(source, PressedSource) else {}
    return Origin(Made(when, command, seconds, inputs, mesh, _noise(source)), loads)


def _noise(source: Source) -> str:
    if not isinstance(source, PressedSource):
        return ""
    noise = source.segmentation_noise
    return (
        f"standard deviation {number(noise.sd_mm, 2)} mm over "
        f"{number(noise.correlation_mm, 2)} mm; of the scan at rest "
        f"{number(noise.reference_sd_mm, 2)} mm"
    )
