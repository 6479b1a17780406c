"""The study named by a user, and the constants given for it."""

from pathlib import Path

from palpate.service.commands.command_line import RUNS
from palpate.service.study.study_keys import NamedCase, StudySpec, read_case, read_spec
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError
from palpate.workers.common_keys import CaseSpec


def find_study(given: Path | None) -> Path:
    """Return the folder of a study from the user's argument.

    Raises
    ------
    InputError
        If there is no such study.
    """
    if given is None:
        return _latest()
    if given.is_dir():
        return given
    if given.is_file():
        return RUNS / read_spec(given).name
    if (RUNS / given).is_dir():
        return RUNS / given
    known = ", ".join(str(folder) for folder in _studies()) or "none"
    file = given.with_name(f"{given.name}.yaml")
    named = (
        f" {file} is a study file: give {file}, or the name under its key name." * file.is_file()
    )
    raise InputError(f"There is no study {given}. Studies in {RUNS.absolute()}: {known}.{named}")


def load_spec(given: Path) -> StudySpec:
    """Read the study in a file, or in a study's folder.

    Raises
    ------
    InputError
        If there is none, or it is not valid.
    """
    return read_spec(StudyLayout(given).study if given.is_dir() else given)


def load_case(given: Path) -> NamedCase:
    """Read the case from a file (target and search are optional) or a study's folder.

    Raises
    ------
    InputError
        If there is none, or it is not valid.
    """
    return read_case(StudyLayout(given).study if given.is_dir() else given)


def constants_option(case: CaseSpec, given: list[str]) -> dict[str, float]:
    """Convert ``E_fat_kpa=12`` to internal names and units, for one simulation.

    Raises
    ------
    InputError
        If a name is unknown or a value is not a number.
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
    return case.parameters.from_door(stated)


def _latest() -> Path:
    studies = _studies()
    if not studies:
        raise InputError(
            f"There is no study in {RUNS.absolute()}. Start one with `palpate new breast NAME` "
            "and `palpate run NAME.yaml`, or give a study's folder."
        )
    return studies[-1]


def _studies() -> list[Path]:
    """Return the folders with a journal, the most recent last."""
    if not RUNS.is_dir():
        return []
    folders = [folder for folder in RUNS.iterdir() if StudyLayout(folder).journal.is_file()]
    return sorted(folders, key=lambda folder: StudyLayout(folder).journal.stat().st_mtime)
