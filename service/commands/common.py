"""Defines what commands share: options, and how results are written."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from palpate.service.commands.settings import RUNS
from palpate.storage.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from palpate.service.study.spec import StudySpec
    from palpate.workers.organs.study_checks import Finding

AllOption = Annotated[
    bool, typer.Option("--all", help="Also show constants at their neutral values.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON record on standard output.")
]
StoreOption = Annotated[
    str | None,
    typer.Option(
        "--store",
        metavar="FOLDER|s3://BUCKET/PREFIX",
        help="Store for volumes and evaluations. Default: $PALPATE_STORE, else runs/store.",
        show_default=False,
    ),
]
WorkersOption = Annotated[
    str | None,
    typer.Option(
        "--workers",
        metavar="N|MIN-MAX",
        help="Worker processes on this machine: 4, or 1-4 to follow the workload. "
        "Default: $PALPATE_WORKERS, else one per core.",
        show_default=False,
    ),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Use the running Dask cluster at this address, such as tcp://HOST:8786. "
        "Default: $PALPATE_SCHEDULER.",
        show_default=False,
    ),
]
AnywayOption = Annotated[
    bool,
    typer.Option(
        "--anyway",
        help="Continue even if a plausibility check fails; the results then begin with a warning.",
    ),
]
StudyArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="[STUDY]",
        help="Study folder, file or name. Default: the study in runs/ that ran last.",
        show_default=False,
    ),
]


def print_findings(findings: "Iterable[Finding]") -> None:
    """Print what plausibility checks have found, on standard error."""
    for finding in findings:
        typer.echo(f"Warning: {finding.text}", err=True)


def print_json(value: Any) -> None:
    """Print one record, readable by people as well; infinities as the texts "-inf" and "inf"."""
    from palpate.storage.plain import to_plain

    typer.echo(json.dumps(to_plain(value), indent=2, ensure_ascii=False, allow_nan=False))


def find_study(given: Path | None) -> Path:
    """Find the folder of a study from what a user types.

    Raises
    ------
    InputError
        If there is none.
    """
    if given is None:
        return _latest()
    if given.is_dir():
        return given
    if given.is_file():
        from palpate.service.study.spec import read_spec

        return RUNS / read_spec(given).name
    if (RUNS / given).is_dir():
        return RUNS / given
    known = ", ".join(str(folder) for folder in _studies()) or "none"
    raise InputError(f"There is no study {given}. Studies in {RUNS.absolute()}: {known}.")


def load_spec(given: Path) -> "StudySpec":
    """Read the study in a file, or in a study's folder.

    Raises
    ------
    InputError
        If there is none, or it makes no sense.
    """
    from palpate.service.study.spec import read_spec
    from palpate.storage.backends.layout import StudyLayout

    return read_spec(StudyLayout(given).study if given.is_dir() else given)


def constants_option(spec: "StudySpec", given: list[str]) -> dict[str, float]:
    """Convert ``E_fat_kpa=12`` to inside names and units, for one simulation.

    Raises
    ------
    InputError
        If a name is unknown or a value is no number.
    """
    stated: dict[str, float] = {}
    for text in given:
        name, equals, value = text.partition("=")
        try:
            stated[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--set {text}: expected NAME=VALUE, such as --set E_fat_kpa=12.")
    return spec.case.parameters.from_door(stated)


def _latest() -> Path:
    studies = _studies()
    if not studies:
        raise InputError(
            f"There is no study in {RUNS.absolute()}. Start one with `palpate new breast NAME` "
            "and `palpate run NAME.yaml`, or give a study's folder."
        )
    return studies[-1]


def _studies() -> list[Path]:
    """Return the folders with a journal, the one written last at the end."""
    from palpate.storage.backends.layout import StudyLayout

    if not RUNS.is_dir():
        return []
    folders = [folder for folder in RUNS.iterdir() if StudyLayout(folder).journal.is_file()]
    return sorted(folders, key=lambda folder: StudyLayout(folder).journal.stat().st_mtime)
