"""Files of a bench experiment: a YAML file and the recordings and mesh that it names.

Only this module finds and opens them; others receive their content. `understood` summarises the
file of an experiment as a table.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.input_files import named_by, parse_yaml, read_text
from palpate.workers.organs.organ_plugins import organ_names
from palpate.workers.organs.specimen.marker_and_field_data import observed
from palpate.workers.organs.specimen.specimen_body_keys import BodySpec, MaterialSpec
from palpate.workers.organs.specimen.specimen_keys import (
    LoadsSpec,
    SpecimenSpec,
    StateSpec,
    read_spec,
)
from palpate.workers.organs.specimen.specimen_source import SpecimenSource
from palpate.workers.organs.specimen.voxelised_mesh import body_of_file, size_of_file


def understood(spec: SpecimenSpec) -> list[tuple[str, str]]:
    """Return the inputs of a diagnosis as names and texts."""
    markers, field = spec.markers, spec.field
    rows = [
        ("experiment", spec.name),
        ("body", _body(spec.body)),
        *((name, _material(material)) for name, material in spec.materials.items()),
        ("held", "; ".join(f"{h.region} along {', '.join(h.axes)}" for h in spec.holds) or "no"),
        ("gravity", spec.gravity),
    ]
    if markers is not None:
        rows.append(("markers", f"{len(markers.markers)}, sd {markers.sd_mm:g} mm"))
    if field is not None:
        rows.append(("displacement field", f"sd {field.sd_mm:g} mm"))
    states = (
        (f"state {s.name}", "; ".join([_loads(s), *_reactions(s), ", ".join(s.files)]))
        for s in spec.states
    )
    predicted = (
        (f"to predict: {p.name}", "; ".join(filter(None, [_loads(p), ", ".join(p.files)])))
        for p in spec.predict
    )
    return [*rows, *states, *predicted]


def _body(body: BodySpec) -> str:
    if body.box_mm is not None:
        return "block of " + " x ".join(f"{s:g}" for s in body.box_mm) + " mm"
    if body.sheet is None:
        return f"{body.mesh}, {body.mm_per_unit:g} mm per unit"
    thick = f", {body.sheet.thickness_mm:g} mm thick"
    if body.sheet.size_mm is not None:
        return "sheet of " + " x ".join(f"{s:g}" for s in body.sheet.size_mm) + " mm" + thick
    return f"sheet with {len(body.sheet.corners_mm)} corners{thick}"


def _material(material: MaterialSpec) -> str:
    low, high = material.E_kpa
    nu = material.nu
    nus = f"searched from {nu[0]:g} to {nu[1]:g}" if isinstance(nu, tuple) else f"{nu:g}"
    shape = "".join(
        f", {name} expected from {value[0]:g} to {value[1]:g}"
        if isinstance(value, tuple)
        else f", {name} {value:g}"
        for name, value in material.constants.items()
    )
    return (
        f"{material.law}{shape}, E expected from {low:g} to {high:g} kPa, nu {nus}, "
        f"{material.density_kg_per_m3:g} kg/m3"
    )


def _reactions(state: StateSpec) -> list[str]:
    return [
        f"{r.region} pushed along {r.axis} with {r.force_n:g} N, sd {r.sd_n:g} N"
        for r in state.reactions
    ]


def _loads(loads: LoadsSpec) -> str:
    texts = [
        f"{f.mass_g:g} g on {f.region}"
        if f.force_n is None
        else f"({', '.join(f'{c:g}' for c in f.force_n)}) N on {f.region}"
        for f in loads.forces
    ]
    texts += [
        f"{m.region} moved as measured"
        if m.displacement_mm is None
        else f"{m.region} moved by ({', '.join(f'{c:g}' for c in m.displacement_mm)}) mm"
        for m in loads.moves
    ]
    if loads.pressure_kpa:
        texts.append(f"pressure of {loads.pressure_kpa:g} kPa")
    return "; ".join(texts) or "no load"


def read_experiment(path: Path) -> SpecimenSource:
    """Read an experiment with its recordings and its mesh.

    Parameters
    ----------
    path : Path
        The YAML file; the paths in it are relative to its folder.

    Raises
    ------
    InputError
        If the file is invalid, or files, markers and body are inconsistent.
    """
    spec = read_spec(path)
    for file in files_of(spec, path):
        if not file.is_file():
            raise InputError(
                f"{path} names {file.name}, which is not in {file.parent.absolute()}. Give paths "
                "relative to the file that names them."
            )
    mesh, observation = spec.body.mesh, observed(spec, path.parent)
    if mesh is None:
        return SpecimenSource(spec, observation, None)
    voxels, notes = body_of_file(spec, path.parent / mesh)
    return SpecimenSource(spec, replace(observation, notes=(*observation.notes, *notes)), voxels)


def files_of(spec: SpecimenSpec, path: Path) -> list[Path]:
    """Return all files on which the result depends: the file itself, mesh and recordings."""
    mesh = spec.body.mesh
    recordings = [named_by(path, file) for state in spec.recorded for file in state.files]
    return [path, *([named_by(path, mesh)] if mesh else []), *dict.fromkeys(recordings)]


class ExperimentReader:
    """Reader of bench experiments; see `workers.organs.source_registry.Reader`."""

    plans = False

    def knows(self, path: Path) -> bool:
        """Test whether a path may be the file of an experiment."""
        if path.suffix not in (".yaml", ".yml") or not path.is_file():
            return False
        try:
            data = parse_yaml(read_text(path), str(path))
        except (OSError, UnicodeDecodeError, InputError):
            return True  # reading it will report the error
        # A file with scans or another organ is not a bench experiment.
        return not isinstance(data, Mapping) or not (
            "scans" in data or data.get("organ") in organ_names()
        )

    def read(
        self, path: Path, stored: Callable[[str], Volume | None] | None = None
    ) -> SpecimenSource:
        """Read an experiment with its recordings and mesh; `stored` is not used."""
        return read_experiment(path)

    def read_planned(
        self, path: Path, stored: Callable[[str], Volume | None] | None = None
    ) -> None:
        """Return None: planning further scans does not apply to a bench experiment."""
        return

    def understood(self, path: Path) -> list[tuple[str, str]]:
        """Return a table of the experiment as it was read: names and texts."""
        spec = read_spec(path)
        rows = [("read from", str(path)), *understood(spec)]
        mesh = spec.body.mesh
        if mesh is not None:
            place = [name for name, _ in rows].index("body") + 1
            rows.insert(place, ("size", size_of_file(spec, named_by(path, mesh))))
        return rows


READER = ExperimentReader()
