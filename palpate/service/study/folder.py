"""The folder of a study: creation, and checks that it belongs to the same study."""

from pathlib import Path

import yaml

from palpate.service.study.log import StudyLog
from palpate.service.study.spec import StudySpec, differences
from palpate.service.versions import versions
from palpate.storage.backends.atomic import explained, write_file
from palpate.storage.backends.layout import StudyLayout
from palpate.storage.backends.places import Place, place_of
from palpate.storage.errors import InputError
from palpate.storage.records.journal import Journal
from palpate.storage.records.record import StudyRecord
from palpate.storage.records.tasks import PreparedBody, PreparedTarget

HEAD = "# The settings of this study, with all defaults. Changing them has no effect.\n"


class StudyFolder:
    """The folder of one study.

    Parameters
    ----------
    root : Path
        Created if missing.
    spec : StudySpec
        The study to run in this folder.
    accept_new_code : bool
        Whether to continue even if the code has changed since the last run.
    """

    def __init__(self, root: Path, spec: StudySpec, *, accept_new_code: bool = False) -> None:
        self.root = root.expanduser().absolute()
        self.spec = spec
        self.layout = StudyLayout(self.root)
        self._accept_new_code = accept_new_code

    def check(self) -> StudyLog:
        """Read the folder, and raise an error if it belongs to another study.

        Raises
        ------
        InputError
            If the folder holds another study, or other code has run this one.
        JournalError
            If its journal is damaged.
        """
        if self.root.exists() and not self.root.is_dir():
            raise InputError(f"{self.root} is a file; expected a study folder: choose another.")
        log = StudyLog.read(self.layout.journal)
        if log.study is not None and log.sessions:
            self._refuse_other_study(log.study)
            self._refuse_other_code(log)
        return log

    def open(self) -> Journal:
        """Lock the journal, creating the folder if it is missing.

        Raises
        ------
        StoreError
            If the folder cannot be written.
        JournalError
            If the study is already running.
        """
        with explained(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
        return Journal(self.layout.journal)

    def begin(self, journal: Journal) -> StudyLog:
        """Read the locked journal; a new study gets its first record.

        A study may still be changed until its preparation has succeeded once.
        """
        log = self.check()
        if log.study is not None and log.study.spec_digest == self.spec.digest:
            return log
        text = yaml.safe_dump(self.spec.as_dict(), sort_keys=False, allow_unicode=True)
        write_file(self.layout.study, (HEAD + text).encode())
        journal.append(StudyRecord(self.spec.digest, self.spec.as_dict(), versions()).to_json())
        return log

    def default_store(self, log: StudyLog) -> Place:
        """Return the store of the last run if it still exists, else the one next to the study."""
        last = None if log.last_session is None else place_of(log.last_session.store)
        if last is None or (isinstance(last, Path) and not last.is_dir()):
            return self.root.parent / "store"
        return last

    def check_same(self, log: StudyLog, prepared: PreparedBody, target: PreparedTarget) -> None:
        """Raise an error if the body or the target is different.

        Raises
        ------
        InputError
            If an image has changed since the study began.
        """
        last = log.last_session
        if last is None or self._accept_new_code:
            return
        for what, before, now in (
            ("undeformed body", last.prepared["volume"], prepared["volume"]),
            ("mesh", last.prepared["mesh"], prepared["mesh"]),
            ("target", last.target["target"], target["target"]),
        ):
            if before != now:
                raise InputError(
                    f"The {what} of this study was {before}, now it is {now}: its image has "
                    "changed since the study began. Restore the old image, or start a new study "
                    "with --study."
                )

    def _refuse_other_study(self, study: StudyRecord) -> None:
        if study.spec_digest == self.spec.digest:
            return
        changes = "\n".join(f"  {line}" for line in differences(study.spec, self.spec.as_dict()))
        raise InputError(
            f"{self.root} holds a study with different settings:\n{changes}\n"
            "Undo these changes to continue it, or give the changed study another folder with "
            "--study; evaluations in the store are used again."
        )

    def _refuse_other_code(self, log: StudyLog) -> None:
        now = versions()["code"]
        if log.code == now or self._accept_new_code:
            return
        raise InputError(
            f"The code has changed since this study last ran (then {log.code}, now {now}), so "
            "its scores may not be comparable. Install the version it was run with, restart it "
            "in another folder with --study, or add --accept-new-code to continue."
        )
