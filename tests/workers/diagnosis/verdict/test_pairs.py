"""Starting points of joint fits: places, and the residuals of another effect."""

import numpy as np
import pytest

from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_sensitivities import starting_places
from palpate.workers.diagnosis.fits.gauss_newton import fit
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.diagnosis.verdict.diagnosis_course import base_of
from palpate.workers.diagnosis.verdict.joint_fit import fit_jointly
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from tests.workers.diagnosis.fits.test_gauss_newton import FREE, analysed, problem_between_plates

effect = CATALOGUE.named
ATTACHED, LUMP, TILT = effect("local_attachment"), effect("inclusion"), effect("plate_tilt")
EDGE = effect("plate_edge")


def test_starting_places_are_not_neighbours():
    grid = SETTINGS.sensitivities.inside_grid_mm
    places = np.outer([0.0, 1.0, 3.0, 9.0, 5.0], [grid, 0.0, 0.0])
    assert starting_places(LUMP, places, np.array([5.0, 4.9, 4.5, 4.8, 4.0])) == [0, 3]
    # No place far behind is tried, and the first of equal places.
    assert starting_places(LUMP, places, np.array([5.0, 4.9, 1.9, 1.5, 0.0])) == [0]
    assert starting_places(LUMP, places, np.zeros(5)) == [0, 2]
    # The boundary has a wider grid, on which these places are neighbours.
    assert starting_places(ATTACHED, places[:2], np.array([5.0, 4.9])) == [0]


class Both:
    """A tilted plate, and springs at one place on the skin."""

    @staticmethod
    def apply(problem, values, frame):
        tilted = TILT.apply(problem, {n: values[n] for n in TILT.names}, frame)
        rest = {n: v for n, v in values.items() if n not in TILT.names}
        return ATTACHED.apply(tilted, rest, frame)


@pytest.mark.slow
def test_second_effect_is_screened_in_the_remaining_residual():
    """The tilt is stronger, so the place is unknown until the tilt is subtracted."""
    true = {"tilt_depth": 6.0, "tilt_across": 0.0}
    true |= {"attachment_stiffness_x": 5e-4, "attachment_x": 26.0}
    true |= {"attachment_y": 3.0, "attachment_z": -2.0}
    inverse = problem_between_plates(Both, true)
    free = unknowns(FREE, [])
    nominal = fit(inverse, free, free.mean, [None] * len(inverse.scans))
    assert nominal is not None
    analysis = analysed(inverse, nominal, [TILT, ATTACHED])
    base = fit_jointly(analysis, [TILT])
    assert base is not None
    assert base.names == base_of([TILT, ATTACHED])
    found = fit_jointly(analysis, [TILT, ATTACHED], base=base)
    assert found is not None
    values = found.fit.values()
    assert values["tilt_depth"] == pytest.approx(6.0, abs=0.3)
    for name in ATTACHED.place.names[:3]:
        assert values[name] == pytest.approx(true[name], abs=5.0)
    alone = fit_jointly(analysis, [TILT, ATTACHED])
    assert alone is None or found.log_evidence > alone.log_evidence - 0.1
    assert found.log_evidence > base.log_evidence + 3.0


def test_quadratic_effects_start_away_from_zero(monkeypatch):
    """An edge near the wall moves little, so fits to noisy scans stay there: for edges at 3.8 mm,
    they ended at 0.9 mm, with 14 to 18 nats less than from a start further out."""
    inverse = problem_between_plates(EDGE, {"plate_edge": 2.0})
    free = unknowns(FREE, [])
    nominal = fit(inverse, free, free.mean, [None] * len(inverse.scans))
    assert nominal is not None
    analysis = analysed(inverse, nominal, [EDGE, TILT])
    assert analysis.is_steep(EDGE)
    assert not analysis.is_steep(TILT)
    begun = []

    def watched(inverse, free, z, *rest):
        begun.append(free.of_effect(EDGE, z)["plate_edge"])
        return fit(inverse, free, z, *rest)

    monkeypatch.setattr("palpate.workers.diagnosis.verdict.joint_fit.fit", watched)
    found = fit_jointly(analysis, [EDGE])
    assert begun[0] >= SETTINGS.joint_fits.steep_start * EDGE.prior_sd[0]
    assert found is not None
    assert found.fit.values()["plate_edge"] == pytest.approx(2.0, abs=0.1)


def test_unsolvable_starts_move_towards_neutral(monkeypatch):
    """As for a wall that is too compliant and folds, both fits end at the same optimum."""
    inverse = problem_between_plates(TILT, {"tilt_depth": 4.0, "tilt_across": 0.0})
    free = unknowns(FREE, [])
    nominal = fit(inverse, free, free.mean, [None] * len(inverse.scans))
    assert nominal is not None
    analysis = analysed(inverse, nominal, [TILT])
    expected = fit_jointly(analysis, [TILT])
    assert expected is not None
    begun = []

    def failing_at_first(inverse, free, z, *rest):
        begun.append(free.of_effect(TILT, z)["tilt_depth"])
        return fit(inverse, free, z, *rest) if len(begun) > 1 else None

    monkeypatch.setattr("palpate.workers.diagnosis.verdict.joint_fit.fit", failing_at_first)
    found = fit_jointly(analysis, [TILT])
    assert begun[0] > 1.0
    assert begun[1:] == [pytest.approx(SETTINGS.joint_fits.start_shares[1] * begun[0])]
    assert found is not None
    assert found.fit.values()["tilt_depth"] == pytest.approx(4.0, abs=0.1)
    assert found.log_evidence == pytest.approx(expected.log_evidence, abs=0.1)


@pytest.mark.slow
def test_only_the_best_of_several_starts_continues(monkeypatch):
    """One start is at the place, the other across the body; both are tried for three iterations."""
    true = {"attachment_stiffness_x": 5e-4, "attachment_x": 26.0}
    true |= {"attachment_y": 3.0, "attachment_z": -2.0}
    inverse = problem_between_plates(ATTACHED, true)
    free = unknowns(FREE, [])
    nominal = fit(inverse, free, free.mean, [None] * len(inverse.scans))
    assert nominal is not None
    analysis = analysed(inverse, nominal, [ATTACHED])
    near = ATTACHED.neutral | true | {"attachment_stiffness_x": 1e-4, "attachment_z": 4.0}
    far = near | {"attachment_x": -26.0}
    runs = []

    def watched(inverse, free, z, starts, poses, each, most):
        found = fit(inverse, free, z, starts, poses, each, most)
        runs.append((most, free.of_effect(ATTACHED, z)["attachment_x"], found))
        return found

    monkeypatch.setattr("palpate.workers.diagnosis.verdict.joint_fit.fit", watched)
    monkeypatch.setattr(
        "palpate.workers.diagnosis.verdict.joint_fit._starts", lambda *_: [far, near]
    )
    found = fit_jointly(analysis, [ATTACHED])
    few, whole = SETTINGS.joint_fits.trial_iterations, SETTINGS.fit.max_iterations
    assert [most for most, _, _ in runs][:2] == [few, few]
    assert [x for _, x, _ in runs][:2] == [-26.0, 26.0]
    tried = runs[1][2]
    assert found is not None
    if not tried.converged:
        assert runs[2][0] == whole
        assert runs[2][1] == pytest.approx(tried.values()["attachment_x"])
        assert found.fit.iterations > few
    assert found.fit.values()["attachment_x"] == pytest.approx(26.0, abs=5.0)
    assert found.fit.cost <= tried.cost < runs[0][2].cost
