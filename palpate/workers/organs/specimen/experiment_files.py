"""Files of a bench experiment: a YAML file and the recordings and mesh that it names.

Only this module finds and opens them; others receive their content.
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
    mesh, found = spec.body.mesh, observed(spec, path.parent)
    if mesh is None:
        return SpecimenSource(spec, found, None)
    voxels, notes = body_of_file(spec, path.parent / mesh)
    return SpecimenSource(spec, replace(found, notes=(*found.notes, *notes)), voxels)


def files_of(spec: SpecimenSpec, path: Path) -> list[Path]:
    """Return all files on which the result depends: the file itself, mesh and recordings."""
    mesh = spec.body.mesh
    recordings = [named_by(path, file) for state in spec.states for file in state.files]
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
        return [("read from", str(path)), *understood(read_spec(path))]


READER = ExperimentReader()
