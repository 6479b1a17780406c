"""A study of a cornea as the source of a diagnosis."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.json_digests import to_plain
from palpate.workers.common_keys import validated
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate, distances_mm
from palpate.workers.diagnosis.outcome.diagnosis_source import FinishedStudy
from palpate.workers.organs.cornea.cornea_keys import CorneaCase
from palpate.workers.organs.cornea.cornea_organ import ORGAN
from palpate.workers.organs.cornea.cornea_study_source import SEGMENTED, CorneaStudySource
from palpate.workers.organs.source_registry import source_of, source_of_study
from palpate.workers.tasks.diagnosis_sources import check_source
from tests.workers.organs.cornea import blind_eyes
from tests.workers.organs.cornea.blind_eyes import diagnosed

X1 = {"mu1_pa": 11000.0, "alpha1": 30.0, "mu2_pa": 35000.0, "alpha2": 80.0}
CASE: dict[str, Any] = {"organ": "cornea", "mesh": {"elements": 120}}
SEARCHED = {"mu2_pa": [1, 40000], "alpha2": [0.1, 100]}
HELD = {"mu1_pa": 11000.0, "alpha1": 30.0}


def study(searched: dict[str, Any] = SEARCHED, **hidden: float) -> FinishedStudy:
    """Return a study whose target was simulated with deviations from its case."""
    case = validated(CorneaCase, CASE | {"constants": X1 | hidden})
    body = ORGAN.make_body(case.reference)
    mesh = ORGAN.make_mesh(body, case)
    model = ORGAN.prepare(mesh)
    solution = ORGAN.solve(model, ORGAN.problem(model, case, case.complete(), 0.0))
    return FinishedStudy(
        name="x1",
        case=CASE | {"constants": HELD},
        target={"constants": X1},
        score={"window_mm": [-5, 5]},
        parameters=searched,
        best={},
        reference=body,
        deformed=ORGAN.deform(body, mesh, solution.displacement_mm),
    )


def test_source_survives_a_round_trip_through_the_store() -> None:
    source = CorneaStudySource.from_study(study())
    content = source.content
    plain = json.loads(json.dumps(to_plain(content.record)))
    again = source_of(type(content)(content.kind, plain, content.volumes, content.arrays))
    assert isinstance(again, CorneaStudySource)
    assert again.content.record == content.record
    ours, theirs = (s.inverse_problem(0, 0.0) for s in (source, again))
    np.testing.assert_array_equal(ours.points.points, theirs.points.points)
    assert [f.name for f in again.free] == ["mu2", "alpha2"]


def test_points_are_on_both_surfaces_inside_the_window() -> None:
    points = CorneaStudySource.from_study(study()).inverse_problem(0, 0.0).points
    assert set(points.interface) == {0, 1}
    assert np.abs(points.points[:, 0]).max() < 5
    assert (points.points[:, 2] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(points.normals, axis=1), 1.0)
    outer = points.interface == 0
    assert (points.normals[outer, 1] > 0).all()
    assert (points.normals[~outer, 1] < 0).all()


def test_searched_effects_are_not_candidates() -> None:
    names = [e.name for e in CorneaStudySource.from_study(study()).effects]
    assert "whole_eye_motion" in names
    searched = SEARCHED | {"eye_tilt_deg": [-3, 3]}
    assert "whole_eye_motion" not in [
        e.name for e in CorneaStudySource.from_study(study(searched)).effects
    ]


def test_rejects_a_study_without_searched_constants() -> None:
    source = source_of_study("cornea", study({"jet_centre_mm": [-1, 1]}))
    with pytest.raises(InputError, match="needs a constant of the law"):
        check_source(source)
    with pytest.raises(InputError, match="cannot be planned"):
        _ = source.acquisition


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "name"),
    [
        ({}, None),
        ({"eye_shift_y_mm": -0.2, "eye_tilt_deg": 1.0}, "whole_eye_motion"),
        ({"jet_centre_mm": 0.25}, "jet_off_centre"),
    ],
)
def test_names_a_hidden_effect_of_another_form(hidden: dict[str, float], name: str | None) -> None:
    source = CorneaStudySource.from_study(study(**hidden))
    source.study = replace(source.study, noise=SEGMENTED)
    reached = diagnosed(source).verdict
    assert reached.primary == (() if name is None else (name,))


def test_a_middle_that_collapses_does_not_trap_the_fit():
    """From the middle of the intervals, this eye snaps inwards and no small step leads back."""
    inverse = blind_eyes.source_of(1, 20).inverse_problem(0, 0.0)
    fitted_mm, _ = distances_mm(inverse, calibrate(inverse)[1])
    assert fitted_mm < 1.5 * SEGMENTED.sd_mm
