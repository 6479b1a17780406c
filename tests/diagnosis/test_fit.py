"""A body whose truth is known: the same model made the scans."""

from dataclasses import replace

import numpy as np
import pytest
from lopsided import plain, volume

from storage.values import TetMesh, Tissue
from workers.diagnosis.fingerprints import fingerprints, grid
from workers.diagnosis.fit import fit
from workers.diagnosis.refit import refit
from workers.diagnosis.screen import screen
from workers.diagnosis.subject import Free, Scan, Subject, unknowns
from workers.diagnosis.views import derivatives, view
from workers.effects.catalogue import effect
from workers.fem.fields import frame_of
from workers.fem.loads import Wall
from workers.fem.model import prepare
from workers.fem.problem import Constants, Problem
from workers.fem.solve import solve
from workers.mesh.hierarchy import build_hierarchy
from workers.observation.interface import InterfacePoints
from workers.observation.locate import interpolation
from workers.observation.noise import SegmentationNoise

TRUTH = {"E_fat": 0.011, "E_gl": 0.034}
FREE = [Free("E_fat", 0.007, 0.014), Free("E_gl", 0.020, 0.050)]
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


def subject_of(hidden=None, values=None, forces=(10.0, 20.0)) -> Subject:
    """A body and its scans, made by `hidden` effects of `values`, without noise."""
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
    at_points = interpolation(mesh, nodes)

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
    return Subject(
        model, frame, points, at_points, FREE, scans, noise, 0.01 * np.eye(m), np.zeros(m)
    )


def test_derivatives_are_those_of_the_residual() -> None:
    subject = subject_of()
    free = unknowns(FREE, [TILT])
    z = np.array([np.log(0.009), np.log(0.03), 0.5, -0.3])
    scan = subject.scans[1]
    here = view(subject, scan, free, z, None)
    assert here is not None
    found = derivatives(subject, scan, free, z, here).columns
    for i in range(len(z)):
        h = 1e-3
        ahead, behind = z.copy(), z.copy()
        ahead[i] += h
        behind[i] -= h
        there, back = (view(subject, scan, free, at, None) for at in (ahead, behind))
        assert there is not None
        assert back is not None
        expected = (there.residual - back.residual) / (2 * h)
        assert np.abs(found[:, i] - expected).max() < 2e-2 * np.abs(expected).max()


def test_constants_are_found_where_nothing_is_missing() -> None:
    subject = subject_of()
    free = unknowns(FREE, [])
    found = fit(subject, free, free.mean, [None, None])
    assert found is not None
    assert found.converged
    for name, value in TRUTH.items():
        # The prior pulls by what the noise allows.
        assert found.values()[name] == pytest.approx(value, rel=0.02)


def test_a_tilt_is_suspected_first_and_found() -> None:
    subject = subject_of(TILT, {"tilt_depth": 3.0, "tilt_across": -1.0})
    free = unknowns(FREE, [])
    nominal = fit(subject, free, free.mean, [None, None])
    assert nominal is not None
    suspects = [TILT, effect("stiffness_gradient"), effect("gravity_change"), FRICTION]
    prints, places = fingerprints(subject, nominal, suspects)
    findings = screen(nominal.linearised(subject), prints)
    assert findings[0].name == "plate_tilt"
    by_name = {f.name: f for f in findings}
    again = refit(subject, nominal, [TILT], by_name, {p.name: p for p in prints}, places)
    assert again is not None
    values = again.fit.values()
    assert values["tilt_depth"] == pytest.approx(3.0, abs=0.1)
    assert values["tilt_across"] == pytest.approx(-1.0, abs=0.1)
    assert values["E_fat"] == pytest.approx(TRUTH["E_fat"], rel=0.02)


def test_friction_is_found_along_the_path() -> None:
    subject = subject_of(FRICTION, {"friction": 0.3}, forces=(20.0,))
    free = unknowns(FREE, [])
    nominal = fit(subject, free, free.mean, [None])
    assert nominal is not None
    prints, places = fingerprints(subject, nominal, [FRICTION])
    findings = {f.name: f for f in screen(nominal.linearised(subject), prints)}
    by_name = {p.name: p for p in prints}
    again = refit(subject, nominal, [FRICTION], findings, by_name, places)
    assert again is not None
    assert again.fit.values()["friction"] == pytest.approx(0.3, abs=0.03)


def test_places_of_a_lump_lie_inside_the_body() -> None:
    subject = subject_of()
    offsets = grid(subject).offsets
    assert len(offsets) > 10
    inside = np.abs(offsets) < np.asarray(subject.frame.half_mm)
    assert inside.all()


def test_some_points_may_be_left_out() -> None:
    subject = subject_of()
    which = np.zeros(len(subject.points), bool)
    which[::3] = True
    fewer = subject.keeping(which)
    assert len(fewer.points) == which.sum()
    assert fewer.covariance.shape == (2 * which.sum(),) * 2
    assert list(fewer.rows) == [0] * which.sum() + [1] * which.sum()
