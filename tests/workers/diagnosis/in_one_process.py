"""A diagnosis computed in this process, without a store."""

from collections.abc import Sequence

from palpate.workers.diagnosis.screening.nominal_analysis import NominalAnalysis
from palpate.workers.diagnosis.verdict.diagnosis import (
    Diagnosis,
    SecondReading,
    advance,
    base_of,
    diagnose,
)
from palpate.workers.diagnosis.verdict.joint_fit import JointFit, fit_jointly
from palpate.workers.diagnosis.verdict.second_reading import read_again
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.scan_threads import Each


def diagnose_here(
    analysis: NominalAnalysis, effects: Sequence[Effect], each: Each = map
) -> Diagnosis:
    """Return the diagnosis, with all requests computed in this process, without a store."""
    course = diagnose(analysis, effects)
    reached = advance(course)
    known: dict[tuple[str, ...], JointFit] = {}
    while not isinstance(reached, Diagnosis):
        if isinstance(reached, SecondReading):
            analysis = read_again(analysis, reached.singles, reached.best, each)
            reached, known = advance(course, analysis), {}
            continue
        found = [fit_jointly(analysis, one, each, known.get(base_of(one))) for one in reached]
        known |= {one.names: one for one in found if one is not None}
        reached = advance(course, found)
    return reached
