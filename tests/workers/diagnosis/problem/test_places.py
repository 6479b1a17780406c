"""Localised effects: their candidate places, and recovery of the true place."""

import numpy as np
import pytest

from palpate.workers.diagnosis.fits.effect_sensitivities import places_of, scan_sensitivity
from palpate.workers.diagnosis.fits.gauss_newton import fit
from palpate.workers.diagnosis.problem.inverse_problem import unknowns
from palpate.workers.diagnosis.problem.scan_prediction import predict_scan
from palpate.workers.diagnosis.verdict.joint_fit import fit_jointly
from palpate.workers.mechanics.fem.external_forces import stated_springs
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from tests.workers.diagnosis.fits.test_gauss_newton import FREE, analysed, problem_between_plates

effect = CATALOGUE.named
ATTACHED, LUMP, GROWN = effect("local_attachment"), effect("inclusion"), effect("growth")


def fitted(inverse):
    free = unknowns(FREE, [])
    found = fit(inverse, free, free.mean, [None] * len(inverse.scans))
    assert found is not None
    return found


def test_lump_places_are_inside_the_body():
    inverse = problem_between_plates()
    offsets = places_of(inverse, LUMP)
    assert len(offsets) > 10
    assert (np.abs(offsets) < np.asarray(inverse.frame.half_mm)).all()


def test_attachment_places_cover_skin_and_wall():
    """Places are boundary nodes, and no boundary node is farther than a diagonal away."""
    inverse = problem_between_plates()
    level = inverse.model.finest
    found = places_of(inverse, ATTACHED)
    boundary = np.union1d(level.contact_nodes.index, level.wall)
    for radius, spacing_mm in ((12.0, 20.0), (30.0, 50.0)):
        places = found[found[:, 3] == radius, :3] + np.asarray(inverse.frame.centre_mm)
        away = np.linalg.norm(level.nodes[boundary][:, None] - places[None], axis=2)
        assert (away.min(axis=0) < 1e-9).all()
        assert away.min(axis=1).max() < np.sqrt(3) * spacing_mm
        assert len(np.unique(places, axis=0)) == len(places)
    assert len(found) == np.isin(found[:, 3], ATTACHED.place.radii_mm).sum()


def test_global_effects_have_no_places():
    assert places_of(problem_between_plates(), GROWN).shape == (0, 3)


def test_attachment_secants_match_simulations():
    """They match at the prior standard deviation, which moves the body by millimetres; tangents are
    1.5 to 3.5 times too long."""
    inverse = problem_between_plates(forces=(15.0,))
    nominal = fitted(inverse)
    columns = scan_sensitivity(inverse, nominal, 0, ATTACHED).columns
    assert columns is not None
    free = unknowns(FREE, [ATTACHED])
    sd = ATTACHED.prior_sd[0]
    ratios, cosines = [], []
    offsets = places_of(inverse, ATTACHED)
    for i in range(0, len(offsets), 4):
        q = i // 4 % 3
        at = ATTACHED.neutral | {ATTACHED.names[q]: sd}
        at |= dict(zip(ATTACHED.place.names, offsets[i], strict=True))
        z = np.append(nominal.z, [at[name] for name in ATTACHED.names])
        there = predict_scan(inverse, inverse.scans[0], free, z, nominal.predictions[0].at)
        assert there is not None
        expected = there.residual - nominal.predictions[0].residual
        found = sd * columns[i, :, q]
        ratios.append(np.linalg.norm(found) / np.linalg.norm(expected))
        cosines.append(found @ expected / np.linalg.norm(found) / np.linalg.norm(expected))
    assert np.median(ratios) == pytest.approx(1.0, abs=0.15)
    assert 0.7 < min(ratios) < max(ratios) < 1.6
    assert min(cosines) > 0.6


def test_attachment_is_found_at_its_true_place():
    true = {
        "attachment_stiffness_x": 6e-4,
        "attachment_stiffness_y": 3e-4,
        "attachment_x": 26.0,
        "attachment_y": 3.0,
        "attachment_z": -2.0,
    }
    inverse = problem_between_plates(ATTACHED, true)
    analysis = analysed(inverse, fitted(inverse), [ATTACHED, effect("gravity_change")])
    assert analysis.screening[0].name == "local_attachment"
    again = fit_jointly(analysis, [ATTACHED])
    assert again is not None
    values = again.fit.values()
    for name in ATTACHED.place.names[:3]:
        assert values[name] == pytest.approx(true[name], abs=4.0)
    assert values["attachment_stiffness_x"] > values["attachment_stiffness_y"]
    for axis in range(2):
        expected = total_n_per_mm(inverse, true)[axis]
        assert total_n_per_mm(inverse, values)[axis] == pytest.approx(expected, rel=0.3)


@pytest.mark.slow
def test_skin_held_along_one_side_is_a_large_attachment():
    """Springs cover a radius of 28 mm on one side of the body."""
    true = {"attachment_stiffness_y": 2e-4, "attachment_radius": 28.0, "attachment_x": 26.0}
    inverse = problem_between_plates(ATTACHED, true)
    analysis = analysed(inverse, fitted(inverse), [ATTACHED, effect("gravity_change")])
    screened = analysis.screening_by_name["local_attachment"]
    radii = places_of(inverse, ATTACHED)[:, 3]
    best = {r: screened.place_log_bayes_factors[radii == r].max() for r in (12.0, 30.0)}
    assert best[30.0] > best[12.0]
    again = fit_jointly(analysis, [ATTACHED])
    assert again is not None
    expected = total_n_per_mm(inverse, true)[1]
    assert total_n_per_mm(inverse, again.fit.values())[1] == pytest.approx(expected, rel=0.3)


def total_n_per_mm(inverse, values):
    """Return the total stiffness of an attachment's springs."""
    level = inverse.model.finest
    chosen = {name: values[name] for name in ATTACHED.names if name in values}
    without = inverse.scans[0].problem({"E_fat": 0.01, "E_gl": 0.03})
    problem = ATTACHED.apply(without, chosen, inverse.frame)
    both = (stated_springs(level, one).sum(axis=0) for one in (problem, without))
    return next(both) - next(both)


def test_growth_is_recovered():
    true = {"ln_growth_fat": 0.02, "ln_growth_glandular": -0.03}
    inverse = problem_between_plates(GROWN, true)
    analysis = analysed(inverse, fitted(inverse), [GROWN, effect("plate_tilt")])
    assert analysis.screening[0].name == "growth"
    again = fit_jointly(analysis, [GROWN])
    assert again is not None
    for name, value in true.items():
        assert again.fit.values()[name] == pytest.approx(value, abs=0.005)
