"""Provenance of the numbers on a page: date, inputs, code and command.

That of a study is read from its journal, that of a diagnosis from its source and request.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from palpate.service.number_formatting import count, duration, number
from palpate.service.report.study.study_data import StudyData
from palpate.storage.json_digests import array_digest
from palpate.storage.values import BodyFacts
from palpate.workers.diagnosis.outcome.diagnosis_source import PressedSource, Source
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from palpate.workers.tasks.diagnosis_store import DiagnosisRequest

ProvenanceRow = tuple[str, str]


@dataclass(frozen=True)
class Made:
    """Provenance of a diagnosis.

    Parameters
    ----------
    when : str
        Date and time, ISO 8601; empty if unknown.
    command : str
    seconds : float or None
        Run time; None if the diagnosis came from the store.
    inputs : sequence of (str, str)
        Inputs and their digests.
    mesh : str
    noise : str
    """

    when: str = ""
    command: str = ""
    seconds: float | None = None
    inputs: Sequence[ProvenanceRow] = ()
    mesh: str = ""
    noise: str = ""


def study_provenance(data: StudyData) -> list[ProvenanceRow]:
    """Return the provenance of a study from its journal."""
    results = data.results
    rows: list[ProvenanceRow] = []
    if data.sessions:
        began = [moment(session.began) for session in data.sessions]
        runs = f"{count(len(began))} runs, the first on " if len(began) > 1 else ""
        rows.append(("Date", f"{runs}{began[0]}"))
    rows += [("Input", text) for text in _study_inputs(data)]
    facts = results.body_facts
    if mesh := mesh_text(facts):
        rows.append(("Mesh", mesh))
    noise = (
        "none: the target was simulated with the same model"
        if results.target_kind == "simulated"
        else "segmentation error, which the score does not model"
    )
    if results.target_kind is not None:
        rows.append(("Noise", noise))
    rows.append(("Seed", str(results.spec.seed)))
    rows += version_rows(results.versions)
    if results.wall_s:
        rows.append(("Run time", duration(results.wall_s)))
    rows.append(("Command", f"palpate run {results.folder}"))
    return rows


def diagnosis_provenance(made: Made, versions: Mapping[str, str]) -> list[ProvenanceRow]:
    """Return the provenance of a diagnosis."""
    rows: list[ProvenanceRow] = []
    if made.when:
        rows.append(("Date", moment(made.when)))
    rows += [("Input", f"{what}, {digest}") for what, digest in made.inputs]
    rows += [(name, text) for name, text in (("Mesh", made.mesh), ("Noise", made.noise)) if text]
    rows += version_rows(versions)
    if made.seconds is not None:
        rows.append(("Run time", duration(made.seconds)))
    elif made.when:
        rows.append(("Run time", "reused from the store"))
    if made.command:
        rows.append(("Command", made.command))
    return rows


def version_rows(versions: Mapping[str, str]) -> list[ProvenanceRow]:
    """Return the versions of Palpate and its code, and the others in one line."""
    known = dict(versions)
    rows = []
    if palpate := known.pop("palpate", ""):
        rows.append(("Palpate", palpate))
    if code := known.pop("code", ""):
        rows.append(("Code", code))
    if known:
        rows.append(("Versions", ", ".join(f"{n} {v}" for n, v in sorted(known.items()))))
    return rows


def moment(iso: str) -> str:
    """Format a date and a time in UTC.

    Examples
    --------
    >>> moment("2026-11-22T14:37:01.123456+00:00")
    '22 November 2026, 14:37 UTC'
    """
    try:
        when = datetime.fromisoformat(iso)
    except ValueError:
        return iso
    if when.tzinfo is not None:
        when = when.astimezone(UTC)
    return f"{when.day} {when:%B %Y, %H:%M} UTC"


def mesh_text(facts: BodyFacts) -> str:
    """Return a description of a mesh."""
    parts = []
    for key, what in (("nodes", "nodes"), ("tets", "tetrahedra"), ("triangles", "triangles")):
        if key in facts:
            parts.append(f"{count(int(facts[key]))} {what}")
    if "element_size_mm" in facts:
        parts.append(f"elements of {number(float(facts['element_size_mm']), 3)} mm")
    return ", ".join(parts)


def _study_inputs(data: StudyData) -> list[str]:
    """Return body, mesh and target: their origin, and their digests in the store."""
    session = data.session
    if session is None:
        return []
    case = data.results.spec.as_dict()
    body, target = case.get("case", {}).get("reference"), case.get("target", {})
    prepared = session.prepared
    how = "simulated with known constants" if session.target["kind"] == "simulated" else "image"
    image = target.get("volume") if isinstance(target, dict) else None
    return [
        f"body, {_origin_text(body)}: {prepared.get('volume', '')}",
        f"mesh: {prepared.get('mesh', '')}",
        f"target, {image or how}: {session.target.get('target', '')}",
    ]


def _origin_text(reference: object) -> str:
    if not isinstance(reference, dict):
        return "generated"
    if phantom := reference.get("phantom"):
        preset = phantom.get("preset", "") if isinstance(phantom, dict) else ""
        return f"phantom {preset}".strip()
    return str(reference.get("volume", "generated"))


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
    return Origin(Made(when, command, seconds, inputs, mesh, _noise_text(source)), loads)


def _noise_text(source: Source) -> str:
    if not isinstance(source, PressedSource):
        return ""
    noise = source.segmentation_noise
    return (
        f"standard deviation {number(noise.sd_mm, 2)} mm over "
        f"{number(noise.correlation_mm, 2)} mm; of the scan at rest "
        f"{number(noise.reference_sd_mm, 2)} mm"
    )
