"""Current results of a study, read from its journal, and checks of journals and findings.

Nothing is recomputed, and the study may be running.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.service.number_formatting import number
from palpate.service.results.identification import (
    Identification,
    identification_from_scatter,
    identification_from_tangents,
)
from palpate.service.results.intervals import (
    LocalModel,
    OtherProblems,
    Posterior,
    SearchedConstants,
)
from palpate.service.results.result_records import (
    CandidateResults,
    EvaluationCounts,
    GenerationResult,
    GenerationScores,
    ParameterEstimate,
    StageTime,
    StudyResults,
    StudyState,
)
from palpate.service.study.study_folder import (
    FINDINGS_OF,
    RecordedGeneration,
    RecordedGenerations,
    StudyLog,
    best_in,
    finite,
    read_study,
)
from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.best_candidate import best_of, best_searched, best_so_far, equally_good
from palpate.storage.errors import InputError, JournalError, NewerSchemaError, StoreError
from palpate.storage.journal import Journal
from palpate.storage.journal_records import EndRecord, EvaluationRecord
from palpate.storage.json_digests import unseal
from palpate.workers.common_keys import validated
from palpate.workers.organs.organ_plugins import organ_spec

if TYPE_CHECKING:
    from palpate.storage.upkeep import Damage


def study_results(folder: Path) -> StudyResults:
    """Return the current results of a study.

    Raises
    ------
    InputError
        If `folder` is not a study.
    JournalError
        If its journal is damaged.
    """
    study, log = read_study(folder)
    spec = validated(StudySpec, study.spec, f"The study in {folder}")
    ranked, session, end = best_so_far(log.endings.values()), log.last_session, log.end
    best, findings = ranked.record, findings_of(folder, end)
    identification, posterior = _identification(spec, log, best, findings)
    endings = [record for _, record in sorted(log.endings.items())]
    return StudyResults(
        folder=folder.absolute(),
        spec=spec,
        state=_state(folder, log),
        stop_reason=None if end is None else end.reason,
        estimates=estimates_of(spec, best, _before_polish(spec, log)),
        best=best,
        counts=_counts(endings),
        generations=tuple(_generations(spec, log)),
        failures=tuple(record for record in endings if record.reason),
        undeformed_scores={} if end is None else end.before,
        best_scores={} if end is None else end.per_label,
        wall_s=log.wall_s(_last_sign(folder)),
        stages=_stages(log.endings.values()),
        body_facts={} if session is None else session.prepared["facts"],
        target_kind=None if session is None else session.target["kind"],
        sessions=len(log.sessions),
        versions=study.versions if session is None else session.versions,
        store=None if session is None else session.store,
        findings=findings,
        identification=identification,
        unverified_records=log.unverified,
        unchained_records=log.unchained,
        caveats=(*log.caveats, *_priors_included(spec)),
        lowest_score=ranked.lowest_score,
        best_note=ranked.note,
        posterior=posterior,
    ).judged


def candidate_results(folder: Path, candidate: int | None) -> CandidateResults:
    """Return the results of one candidate, by default the best one.

    Raises
    ------
    InputError
        If there is no such candidate.
    """
    study, log = read_study(folder)
    spec = validated(StudySpec, study.spec, f"The study in {folder}")
    if candidate is None:
        best = best_of(log.endings)
        if best is None:
            raise _no_such("best candidate", folder, "no candidate has a score yet")
        candidate = best.candidate
    recorded = RecordedGenerations(spec, log)
    generation = recorded.generation_of(candidate)
    if generation is None:
        raise _no_such(f"candidate {candidate}", folder, _known_candidates(recorded, log))
    origin = recorded.evaluated_as(candidate)
    genes, ending = dict(generation.genes[candidate]), log.endings.get(origin)
    return CandidateResults(spec, candidate, generation.number, origin, genes, ending)


def is_running(folder: Path) -> bool:
    """Return True if a driver holds the journal of the study."""
    return Journal.is_being_written(StudyLayout(folder).journal)


def _known_candidates(recorded: RecordedGenerations, log: StudyLog) -> str:
    if log.proposals or not log.endings:
        return f"its candidates are 0 to {recorded.candidates - 1} so far"
    return (
        f"its journal has the endings of candidates {min(log.endings)} to {max(log.endings)}; the "
        "version that wrote it did not record which candidates were carried over"
    )


def _no_such(what: str, folder: Path, why: str) -> InputError:
    return InputError(f"The study {folder} has no {what}: {why}.")


def findings_of(folder: Path, end: EndRecord | None = None) -> Mapping[str, Any]:
    """Return the findings about the fitted body; empty if none were stored.

    Parameters
    ----------
    end : EndRecord, optional
        The end of the study, which names the evaluation that the findings are about.

    Raises
    ------
    JournalError
        If the file is damaged or of another study.
    """
    path = StudyLayout(folder).findings
    if not path.is_file():
        return {}
    try:
        findings, _ = unseal(path.read_bytes())
    except ValueError as error:
        raise JournalError(
            f"{path} is damaged: {error}. Remove it: the rest of the study can then be read "
            "without the findings."
        ) from error
    about = findings.pop(FINDINGS_OF, None)  # findings of earlier versions do not name it
    if end is not None and about not in (None, end.volume):
        raise JournalError(
            f"{path} is of another study: it is about the evaluation {about}, but the best one of "
            f"this study is {end.volume}. Put the right file there, or remove it: the rest of the "
            "study can then be read without the findings."
        )
    return findings


def _last_sign(folder: Path) -> datetime:
    """Return the end of the last run: now if it is running, else its last entry in the journal."""
    journal = StudyLayout(folder).journal
    written = datetime.fromtimestamp(journal.stat().st_mtime, UTC)
    return datetime.now(UTC) if is_running(folder) else written


def _state(folder: Path, log: StudyLog) -> StudyState:
    if is_running(folder):
        return "running"
    return "interrupted" if log.end is None else "stopped"


def _before_polish(spec: StudySpec, log: StudyLog) -> EvaluationRecord | None:
    """Return the best candidate of the genetic stage, if another stage follows."""
    polished = spec.search.strategy == "genetic+least-squares"
    return best_searched(log.endings) if polished else None


def estimates_of(
    spec: StudySpec, best: EvaluationRecord | None, before: EvaluationRecord | None
) -> dict[str, ParameterEstimate]:
    """Return the estimate of each searched parameter, by internal name."""
    parameters = spec.case.parameters
    target: dict[str, float] = {}
    if spec.target.constants is not None:
        constants = spec.case.complete(parameters.from_door(spec.target.constants))
        known = {name: value for name, value in constants.items() if name in parameters}
        stated = parameters.to_door(known) | dict(spec.target.constants)
        searched = {gene: stated[gene] for gene in spec.search.parameters if gene in stated}
        target = spec.case.canonical(searched)
    genes = None if best is None else spec.case.canonical(best.genes)
    estimates = {}
    for gene, (lower, upper) in spec.search.parameters.items():
        parameter = parameters.at_door(gene)
        estimate = None if genes is None else genes[gene]
        unpolished = None if before is None else spec.case.canonical(before.genes)[gene]
        estimates[parameter.name] = ParameterEstimate(
            gene, parameter.unit.symbol, lower, upper, estimate, target.get(gene), unpolished,
            limit=parameter.door_limit, description=parameter.description,
        )  # fmt: skip
    return estimates


def _priors_included(spec: StudySpec) -> list[str]:
    """Return a sentence for each constant with a prior."""
    sentences = []
    for name, prior in spec.search.prior.items():
        unit = spec.case.parameters.at_door(name).unit.symbol
        known = f"{number(prior.mean)} ± {number(prior.sd)} {unit}".rstrip()
        sentences.append(f"The estimate and the interval of {name} include its prior, {known}.")
    return sentences


def _identification(
    spec: StudySpec, log: StudyLog, best: EvaluationRecord | None, findings: Mapping[str, Any]
) -> tuple[Identification | None, Posterior | None]:
    """Return the identifiability of the constants, once the search has stopped."""
    if best is None or log.end is None:
        return None, None
    searched = SearchedConstants(
        spec.case.parameters,
        spec.case.parameters.bounds_from_door(spec.search.parameters),
        spec.common_scale,
        spec.priors,
    )
    derivatives = log.identification
    if derivatives is not None and derivatives.fit is not None:
        nuisances = organ_spec(spec.case.organ).nuisances
        priors = nuisances(spec.case, spec.target.constants is None) if nuisances else ()
        others = OtherProblems(derivatives.nuisances, tuple(priors), derivatives.meshes or ())
        derived = [quantity for quantity in findings.get("derived", ()) if "mesh_sd" in quantity]
        known = identification_from_tangents(
            searched, derivatives.candidate, derivatives.fit, others, derived
        )
        return known, Posterior(LocalModel(derivatives.fit, searched, others), searched)
    note = (
        "the study was run before derivatives were recorded"
        if derivatives is None
        else derivatives.reason
    )
    alike, here = (
        [spec.constants_of(spec.case.canonical(record.genes)) for record in records]
        for records in (equally_good(log.endings, best, spec.objective.equally_good), [best])
    )
    return identification_from_scatter(searched, best.candidate, here[0], alike, note), None


def _generations(spec: StudySpec, log: StudyLog) -> Iterable[GenerationResult]:
    recorded = RecordedGenerations(spec, log)
    for generation in recorded.generations:
        scores = recorded.scores(generation)
        yield GenerationResult(
            generation.number,
            generation.evaluations,
            generation.ended(log.endings),
            None if scores is None else _scores(generation, scores, log.endings),
        )


def _scores(
    generation: RecordedGeneration,
    scores: Mapping[int, float],
    endings: Mapping[int, EvaluationRecord],
) -> GenerationScores:
    own = best_of({c: r for c in scores if (r := endings.get(c)) and r.fit is not None})
    best, known = best_in(scores) if own is None else own.candidate, finite(scores)
    return GenerationScores(
        best=scores[best],
        mean=float(np.mean(known)) if known else None,
        best_candidate=best,
        best_genes=dict(generation.genes[best]),
        failed=sum(score == np.inf for score in scores.values()),
    )


def _counts(endings: Iterable[EvaluationRecord]) -> EvaluationCounts:
    endings = list(endings)
    by_status = Counter(str(record.status) for record in endings)
    done, diverged, crashed, lost = (
        by_status[status] for status in ("done", "diverged", "crashed", "lost")
    )
    reused = sum(record.reused for record in endings)
    return EvaluationCounts(done, diverged, crashed, lost, reused)


def _stages(endings: Iterable[EvaluationRecord]) -> dict[str, StageTime]:
    """Return the total time of each stage over the evaluations computed by this study."""
    seconds_by_stage: dict[str, list[float]] = {}
    for record in endings:
        if not record.reused:
            for stage, seconds in record.seconds.items():
                seconds_by_stage.setdefault(stage, []).append(seconds)
    return {
        stage: StageTime(sum(spent), sum(spent) / len(spent), len(spent))
        for stage, spent in seconds_by_stage.items()
    }


@dataclass(frozen=True)
class RecordCheck:
    """The outcome of a check of several studies.

    Parameters
    ----------
    studies : int
    damages : list of Damage
    unverified : int
        Journal lines without checksums, written by an earlier version.
    unchained : int
        Journal lines that do not name the line before, written by an earlier version.
    """

    studies: int
    damages: "list[Damage]"
    unverified: int
    unchained: int


def check_records(folders: Iterable[Path]) -> RecordCheck:
    """Read the journals and findings of several studies, and verify their checksums.

    Raises
    ------
    NewerSchemaError
        If a record was written by a newer version of Palpate.
    """
    from palpate.storage.upkeep import Damage  # loads Zarr, which reading a journal does without

    studies = unverified = unchained = 0
    damages = []
    for folder in folders:
        studies += 1
        layout, end = StudyLayout(folder), None
        try:
            log = StudyLog.read(layout.journal)
            end = log.end
            unverified += log.unverified
            unchained += log.unchained
        except NewerSchemaError:
            raise
        except StoreError as error:
            damages.append(Damage(layout.journal, str(error)))
        try:
            findings_of(folder, end)
        except StoreError as error:
            damages.append(Damage(layout.findings, str(error)))
    return RecordCheck(studies, damages, unverified, unchained)
