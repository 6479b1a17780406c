"""A bench experiment as files: a YAML file, the recordings and the mesh that it names.

The only file that opens them; all others get what stands in them.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.documents import parse_yaml
from palpate.workers.input_files import named_by, read_text
from palpate.workers.organs.registry import organ_names
from palpate.workers.organs.specimen.readings.experiment_table import understood
from palpate.workers.organs.specimen.readings.marker_data import observed
from palpate.workers.organs.specimen.source import SpecimenSource
from palpate.workers.organs.specimen.spec import SpecimenSpec, read_spec
from palpate.workers.organs.specimen.voxelised_mesh import body_of_file


def read_experiment(path: Path) -> SpecimenSource:
    """Read an experiment with its recordings and its mesh.

    Parameters
    ----------
    path : Path
        The YAML file; what it names lies relative to its folder.

    Raises
    ------
    InputError
        If the file does not make sense, or files, markers and body do not go together.
    """
    spec = read_spec(path)
    for file in files_of(spec, path):
        if not file.is_file():
            raise InputError(
                f"{path} names {file.name}, which is not at {file.parent}. Give paths "
                "relative to the file that names them."
            )
    mesh, found = spec.body.mesh, observed(spec, path.parent)
    if mesh is None:
        return SpecimenSource(spec, found, None)
    voxels, notes = body_of_file(spec, path.parent / mesh)
    return SpecimenSource(spec, replace(found, notes=(*found.notes, *notes)), voxels)


def files_of(spec: SpecimenSpec, path: Path) -> list[Path]:
    """Return all files that the result depends on: the file itself, the mesh, the recordings."""
    mesh = spec.body.mesh
    recordings = [named_by(path, file) for state in spec.states for file in state.files]
    return [path, *([named_by(path, mesh)] if mesh else []), *dict.fromkeys(recordings)]


class ExperimentReader:
    """See `workers.organs.source_registry.Reader`."""

    plans = False

    def knows(self, path: Path) -> bool:
        """Return whether a path is a file that may describe an experiment."""
        if path.suffix not in (".yaml", ".yml") or not path.is_file():
            return False
        try:
            data = parse_yaml(read_text(path), str(path))
        except (OSError, UnicodeDecodeError, InputError):
            return True  # reading it will name the mistake
        # An organ that is scanned is no specimen on a bench.
        return not isinstance(data, Mapping) or not (
            "scans" in data or data.get("organ") in organ_names()
        )

    def read(
        self, path: Path, stored: Callable[[str], Volume | None] | None = None
    ) -> SpecimenSource:
        """Read an experiment with its recordings and its mesh; it names no volumes of a store."""
        return read_experiment(path)

    def read_planned(
        self, path: Path, stored: Callable[[str], Volume | None] | None = None
    ) -> None:
        """Return nothing: further scans are no measurements of a bench."""
        return

    def understood(self, path: Path) -> list[tuple[str, str]]:
        """Return what the experiment was understood to say."""
        return [("read from", str(path)), *understood(read_spec(path))]


READER = ExperimentReader()
