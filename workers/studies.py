"""The folder of a study, as far as a diagnosis needs it: what was asked, found and stored."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from storage.errors import InputError
from storage.journal import Journal
from storage.layout import StudyLayout
from storage.records import EvaluationRecord, StudyRecord, record_of
from storage.status import Status
from storage.stores import open_store
from workers.cases.study import StudyPieces, StudySource
from workers.images.one_body import in_air
from workers.library import Library
from workers.spec import CaseSpec, TargetSpec, validated

KINDS = (StudyRecord.kind, EvaluationRecord.kind)


def is_study(folder: Path) -> bool:
    """Whether `palpate run` has made this folder."""
    return StudyLayout(folder).journal.is_file()


def open_study(folder: Path) -> StudySource:
    """A study that has run, as the source of a diagnosis.

    Parameters
    ----------
    folder : Path
        Of the study. Its store must still hold the volumes that it was run with.

    Raises
    ------
    InputError
        If there is no study, or it has not begun to evaluate.
    JournalError, StoreError
        If journal or store are damaged, or a volume is missing.
    """
    layout = StudyLayout(folder)
    if not is_study(folder):
        raise InputError(f"{folder} is no study: it has no {layout.journal.name}.")
    lines = list(Journal.read(layout.journal))
    records = [record_of(line) for line in lines if line.get("kind") in KINDS]
    sessions = [line for line in lines if line.get("kind") == "session"]
    studies = [r for r in records if isinstance(r, StudyRecord)]
    if not sessions or not studies:
        raise InputError(
            f"The study {folder} has not run: nothing is known of its body. Run it first with "
            f"`palpate run {folder}`."
        )
    asked = studies[0].spec
    case = validated(CaseSpec, asked["case"], str(layout.study))
    wanted = validated(TargetSpec, asked["target"], str(layout.study))
    prepared, target = sessions[-1]["prepared"]["volume"], sessions[-1]["target"]["target"]
    store = open_store(sessions[-1]["store"])
    library = Library(store)
    pieces = StudyPieces(
        name=asked["name"],
        case=case,
        bounds=case.parameters.bounds_from_door(asked["search"]["parameters"]),
        best=case.parameters.from_door(_best_genes(records)),
        reference=in_air(library.volume(prepared)),
        target=in_air(library.volume(target)),
        target_mesh=None if wanted.constants is None else wanted.mesh or case.mesh,
        files=[layout.journal, *(store.layout.volume(name) for name in (prepared, target))],
    )
    return StudySource(pieces)


def _best_genes(records: Iterable[EvaluationRecord | StudyRecord]) -> Mapping[str, float]:
    """Of the candidate with the least score; empty if none has one."""
    scored = [
        (float(r.score["gsf"]), r.candidate, r.genes)
        for r in records
        if isinstance(r, EvaluationRecord) and r.status is Status.DONE and r.score
    ]
    return min(scored)[2] if scored else {}
