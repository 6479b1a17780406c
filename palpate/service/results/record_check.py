"""Checks of the records in study folders: journals and findings."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from palpate.service.results.read import findings_of
from palpate.service.study.log import StudyLog
from palpate.storage.backends.layout import StudyLayout
from palpate.storage.errors import NewerSchemaError, StoreError
from palpate.storage.upkeep.check import Damage


@dataclass(frozen=True)
class RecordCheck:
    """The outcome of a check of several studies.

    Parameters
    ----------
    studies : int
    damages : list of Damage
    unverified : int
        Journal lines without checksums, written by an earlier version.
    """

    studies: int
    damages: list[Damage]
    unverified: int


def check_records(folders: Iterable[Path]) -> RecordCheck:
    """Read the journals and findings of several studies, and verify their checksums.

    Raises
    ------
    NewerSchemaError
        If a record was written by a newer version of Palpate.
    """
    studies = unverified = 0
    damages = []
    for folder in folders:
        studies += 1
        layout = StudyLayout(folder)
        try:
            unverified += StudyLog.read(layout.journal).unverified
        except NewerSchemaError:
            raise
        except StoreError as error:
            damages.append(Damage(layout.journal, str(error)))
        try:
            findings_of(folder)
        except StoreError as error:
            damages.append(Damage(layout.findings, str(error)))
    return RecordCheck(studies, damages, unverified)
