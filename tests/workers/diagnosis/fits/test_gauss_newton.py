"""Fits to a body with a known truth, whose scans were made by the same model."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.values import FloatArray, TetMesh, Tissue
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.body.mesh.nodal_interpolation import interpolation_at_points
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.comparison.observation.segmentation_noise import SegmentationNoise
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis
from palpate.workers.diagnosis.fits.effect_sensitivities import joined_sensitivity, scan_sensitivity
from palpate.workers.diagnosis.fits.gauss_newton import SolvedFit, fit
from palpate.workers.diagnosis.noise.noise_components import LearntNoise
from palpate.workers.diagnosis.problem.inverse_problem import (
    FreeConstant,
    InverseProblem,
    Scan,
    Unknowns,
    unknowns,
)
from palpate.workers.diagnosis.problem.scan_prediction import (
    PosedNoise,
    derivatives,
    predict_scan,
    registered,
    residuals,
)
from palpate.workers.diagnosis.verdict.joint_fit import fit_jointly
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Problem, frame_of
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.fem.loads_and_regions import Wall
from palpate.workers.organs.breast.breast_effects import CATALOGUE
from tests.workers.mechanics.effects.lopsided import plain, volume

effect = CATALOGUE.named
TRUTH = {"E_fat": 0.011, "E_gl": 0.034}
FREE = [FreeConstant("E_fat", 0.007, 0.014), FreeConstant("E_gl", 0.020, 0.050)]
TILT, FRICTION = effect("plate_tilt"), effect("plate_friction")


def problem(values, force_n: float) -> Problem:
    asked = plain()
    constants = {
        Tissue.FAT: Constants(values["E_fat"], 0.49, 0.02),
        Tissue.GLANDULAR: Constants(values["E_gl"], 0.49, 0.02),
    }
    load = replace(asked.load, force_n=force_n)
    held = Wall((False, False, True), (2e-4, 1e-4, 0.0))
    return replace(asked, constants=constants, load=load, wall=held, tolerance_mm=1e-5)


def problem_between_plates(hidden=None, values=None, forces=(10.0, 20.0)) -> InverseProblem:
    """Return a body and its scans without noise, made with `hidden` effects of given `values`."""
    hierarchy = build_hierarchy(volume(), nodes=900)
    model = prepare(hierarchy)
    frame = frame_of(model.finest.nodes)
    surface = np.unique(model.finest.sheet.triangles)[::4]
    nodes = model.finest.nodes[surface]
    outward = nodes - np.asarray(frame.centre_mm)
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    k = len(nodes)
    points = InterfacePoints(
        nodes, outward, np.zeros(k, np.int32), np.ones(k), np.zeros(k, np.int32)
    )
    mesh = TetMesh(model.finest.nodes, model.finest.elements.tets)
    at_points = interpolation_at_points(mesh, nodes)

    def scan(force_n: float) -> Scan:
        asked = problem(TRUTH, force_n)
        if hidden is not None:
            asked = hidden.apply(asked, values, frame)
        solution = solve(model, asked)
        assert solution.outcome.converged
        seen = nodes + at_points @ solution.displacement_mm

        def look(moved, of):
            assert len(of) == len(moved)
            return ((moved - seen) * outward).sum(axis=1), outward

        return Scan(f"{force_n:g} N", lambda v: problem(v, force_n), look)

    scans = [scan(force) for force in forces]
    m = k * len(scans)
    noise = SegmentationNoise(0.1, 4.0, 0.0, 0.01)
    return InverseProblem(
        model, frame, points, at_points, FREE, scans, noise, 0.01 * np.eye(m), np.zeros(m)
    )


def analysed(inverse: InverseProblem, nominal: SolvedFit, effects: list[Effect]) -> NominalAnalysis:
    """Return the nominal fit with the sensitivities of effects, all of which act."""
    sensitivities = []
    for one in effects:
        numbers = range(len(inverse.scans))
        scans = [scan_sensitivity(inverse, nominal, number, one) for number in numbers]
        found = joined_sensitivity(one, scans)
        assert found is not None
        sensitivities.append(found)
    return NominalAnalysis(inverse, nominal, sensitivities)


def test_derivatives_match_the_residual() -> None:
    inverse = problem_between_plates()
    free = unknowns(FREE, [TILT])
    z = np.array([np.log(0.009), np.log(0.03), 0.5, -0.3])
    scan = inverse.scans[1]
    here = predict_scan(inverse, scan, free, z, None)
    assert here is not None
    found = derivatives(inverse, scan, free, z, here).columns
    for i in range(len(z)):
        h = 1e-3
        ahead, behind = z.copy(), z.copy()
        ahead[i] += h
        behind[i] -= h
        there, back = (predict_scan(inverse, scan, free, at, None) for at in (ahead, behind))
        assert there is not None
        assert back is not None
        expected = (there.residual - back.residual) / (2 * h)
        assert np.abs(found[:, i] - expected).max() < 2e-2 * np.abs(expected).max()


def test_recovers_constants_without_a_missing_effect() -> None:
    inverse = problem_between_plates()
    free = unknowns(FREE, [])
    found = fit(inverse, free, free.mean, [None, None])
    assert found is not None
    assert found.converged
    for name, value in TRUTH.items():
        # The prior pulls the fit as far as the noise allows.
        assert found.values()[name] == pytest.approx(value, rel=0.02)


def lying_elsewhere(inverse: InverseProblem, shift_mm: FloatArray) -> InverseProblem:
    """Return shifted scans, with distances that are too small far from the interface."""

    def compress(scan: Scan) -> Scan:
        def compare(moved: FloatArray, of: InterfacePoints) -> tuple[FloatArray, FloatArray]:
            distance, normals = scan.compare(moved - shift_mm, of)
            return np.tanh(distance), normals / np.cosh(distance)[:, None] ** 2

        return replace(scan, compare=compare)

    m = len(inverse.bias)
    stated, none = 0.01 * np.eye(m), np.zeros((m, 0))
    learnt = LearntNoise(stated, np.zeros(m, np.int32), none, none, np.ones(1))
    scans = [compress(scan) for scan in inverse.scans]
    return replace(inverse, scans=scans, learnt=learnt, covariance=learnt.covariance)


def test_scans_are_compared_at_their_poses() -> None:
    """Scans are off by 1.2 mm. Distances there are wrong by 0.3 mm, but they are not used."""
    shift_mm = np.array([1.2, 0.0, -0.5])
    inverse = lying_elsewhere(problem_between_plates(), shift_mm)
    free = unknowns(FREE, [])
    found = fit(inverse, free, free.mean, [None, None])
    assert found is not None
    assert found.converged
    for name, value in TRUTH.items():
        assert found.values()[name] == pytest.approx(value, rel=0.03)
    for pose in found.poses():
        assert pose is not None
        assert pose[:3] == pytest.approx(-shift_mm, abs=0.05)
    again = registered(inverse, free, found.z, found.predictions)
    for before, after in zip(found.predictions, again, strict=True):
        np.testing.assert_allclose(after.residual, before.residual, atol=0.01)


def drawn_roughly(inverse: InverseProblem) -> InverseProblem:
    """Return interfaces whose error has the given size, and falls and rises within 6 mm."""
    rng = np.random.default_rng(5)
    waves, phases = rng.standard_normal((3, 100)) / 4.0, rng.uniform(0, 2 * np.pi, 100)
    size = 0.1 * np.sqrt(2 / 100)

    def rough(scan: Scan) -> Scan:
        def compare(moved: FloatArray, of: InterfacePoints) -> tuple[FloatArray, FloatArray]:
            distance, normals = scan.compare(moved, of)
            turns = moved @ waves + phases
            slopes = size * np.sin(turns) @ waves.T
            return distance - size * np.cos(turns).sum(axis=1), normals + slopes

        return replace(scan, compare=compare)

    return replace(inverse, scans=[rough(scan) for scan in inverse.scans])


def cost(inverse: InverseProblem, free: Unknowns, z: FloatArray, near: SolvedFit) -> float:
    """Return minus twice the log posterior at the most probable poses."""
    found = [
        predict_scan(inverse, scan, free, z, start, pose)
        for scan, start, pose in zip(inverse.scans, near.starts(), near.poses(), strict=True)
    ]
    compared = registered(inverse, free, z, [one for one in found if one is not None])
    noise = PosedNoise(inverse, compared)
    white = noise.whiten(residuals(inverse, compared))
    return float(white @ noise.cleared(white) + (((z - free.mean) / free.sd) ** 2).sum())


def test_a_fit_ends_at_a_local_optimum() -> None:
    """Poses absorb part of every change, and normals of a rough interface change within a mm."""
    shift_mm = np.array([0.6, 0.0, -0.4])
    inverse = drawn_roughly(lying_elsewhere(problem_between_plates(), shift_mm))
    free = unknowns(FREE, [])
    found = fit(inverse, free, free.mean, [None, None])
    assert found is not None
    assert found.converged
    least = cost(inverse, free, found.z, found)
    assert least == pytest.approx(found.cost, abs=0.02)
    curvature = 1.0 + (found.linearised(inverse).scaled_nominal ** 2).sum(axis=0)
    for step in np.diag(free.sd / np.sqrt(curvature)):
        ahead, behind = (cost(inverse, free, found.z + s * step, found) for s in (1, -1))
        # A whole standard deviation costs 1 on either side, so this is the bottom of a valley.
        assert (ahead + behind) / 2 == pytest.approx(least + 1.0, abs=0.2)
        assert ahead == pytest.approx(behind, abs=0.4)


def test_a_tilt_is_suspected_first_and_found() -> None:
    inverse = problem_between_plates(TILT, {"tilt_depth": 3.0, "tilt_across": -1.0})
    free = unknowns(FREE, [])
    nominal = fit(inverse, free, free.mean, [None, None])
    assert nominal is not None
    suspects = [TILT, effect("stiffness_gradient"), effect("gravity_change"), FRICTION]
    analysis = analysed(inverse, nominal, suspects)
    assert analysis.screening[0].name == "plate_tilt"
    again = fit_jointly(analysis, [TILT])
    assert again is not None
    values = again.fit.values()
    assert values["tilt_depth"] == pytest.approx(3.0, abs=0.1)
    assert values["tilt_across"] == pytest.approx(-1.0, abs=0.1)
    assert values["E_fat"] == pytest.approx(TRUTH["E_fat"], rel=0.02)


@pytest.mark.slow
def test_friction_is_found_along_the_path() -> None:
    inverse = problem_between_plates(FRICTION, {"friction": 0.3}, forces=(20.0,))
    free = unknowns(FREE, [])
    nominal = fit(inverse, free, free.mean, [None])
    assert nominal is not None
    again = fit_jointly(analysed(inverse, nominal, [FRICTION]), [FRICTION])
    assert again is not None
    assert again.fit.values()["friction"] == pytest.approx(0.3, abs=0.03)


def test_fit_accepts_a_subset_of_points() -> None:
    inverse = problem_between_plates()
    which = np.zeros(len(inverse.points), bool)
    which[::3] = True
    fewer = inverse.keeping(which)
    assert len(fewer.points) == which.sum()
    assert fewer.covariance.shape == (2 * which.sum(),) * 2
    assert list(fewer.rows) == [0] * which.sum() + [1] * which.sum()
