"""A diagnosis computed in this process, without a store."""

from collections.abc import Sequence

from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis
from palpate.workers.diagnosis.verdict.diagnosis_course import Diagnosis, advance, base_of, diagnose
from palpate.workers.diagnosis.verdict.joint_fit import JointFit, fit_jointly
from palpate.workers.kernels_and_threads import Each
from palpate.workers.mechanics.effects.effect import Effect


def diagnose_here(
    analysis: NominalAnalysis, effects: Sequence[Effect], each: Each = map
) -> Diagnosis:
    """Return the diagnosis, with all requests computed in this process, without a store."""
    course = diagnose(analysis, effects)
    reached = advance(course)
    known: dict[tuple[str, ...], JointFit] = {}
    while not isinstance(reached, Diagnosis):
        found = [fit_jointly(analysis, one, each, known.get(base_of(one))) for one in reached]
        known |= {one.names: one for one in found if one is not None}
        reached = advance(course, found)
    return reached
