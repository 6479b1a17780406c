"""Findings about a fitted eye: against refits, and their sentences."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from palpate.storage.json_digests import dumps, loads
from palpate.workers.common_keys import validated
from palpate.workers.organs.cornea.cornea_findings import figures, findings
from palpate.workers.organs.cornea.cornea_keys import CorneaCase, CorneaScore, CorneaTarget
from palpate.workers.organs.cornea.cornea_organ import ORGAN
from palpate.workers.organs.cornea.cornea_problem import candidate_of
from palpate.workers.organs.cornea.prestressed_equilibrium import deeper, solve_prepared, thickened
from palpate.workers.organs.cornea.section_outline import RigidMotion, generated_section
from palpate.workers.organs.organ_plugins import findings_of
from tests.workers.organs.cornea.frames.generated_frame import generated_frame

X1 = {"mu1_pa": 11000.0, "alpha1": 30.0, "mu2_pa": 35000.0, "alpha2": 80.0}
CASE: dict[str, Any] = {"organ": "cornea", "mesh": {"elements": 240}, "constants": X1}
UNKNOWN = {"not_measured": ["iop", "pachymetry"], "jet_fractions": [0.5, 1.0]}


def found(**more: Any) -> dict[str, Any]:
    case = validated(CorneaCase, CASE | more)
    body = ORGAN.make_body(case.reference)
    model = ORGAN.prepare(ORGAN.make_mesh(body, case))
    return findings(model, case, case.complete(), 0.0, CorneaScore())


@pytest.fixture(scope="module")
def eye() -> dict[str, Any]:
    return found(findings=UNKNOWN)


def test_findings_are_plain_json(eye: dict[str, Any]) -> None:
    assert loads(dumps(eye)) == eye


def test_assumptions_change_the_stiffness_in_the_right_direction(eye: dict[str, Any]) -> None:
    """A stiffer jet requires a stiffer cornea, a thicker cornea a softer one."""
    assumed = eye["numbers"]["assumptions"]
    parts = {name: one["stress_part"] for name, one in assumed.items()}
    assert 0.005 < parts["jet_pressure"] < 0.03
    assert -0.1 < parts["pachymetry"] < -0.01


def test_thicker_cornea_deforms_less() -> None:
    case = validated(CorneaCase, CASE)
    body = ORGAN.make_body(case.reference)
    model = ORGAN.prepare(ORGAN.make_mesh(body, case))
    candidate = candidate_of(model, case, case.complete(), 0.0)
    thin, normal, thick = (
        solve_prepared(one.prepared, one.constants, one.load).apex_displacement_um
        for one in (thickened(candidate, -0.01), candidate, thickened(candidate, 0.01))
    )
    assert thin > 1.03 * normal > 1.06 * thick


def test_missing_measurements_are_reported_first(eye: dict[str, Any]) -> None:
    first = eye["notes"][0]
    assert first.startswith("The pressure of the eye and the thickness of the cornea were not")
    assert "may not be used" in first
    assert not any("may not be used" in note for note in found(findings={})["notes"])


def test_profiles_are_computed_only_on_request(eye: dict[str, Any]) -> None:
    assert "profiles" not in eye["numbers"]
    assert len(list(figures(spec(), (None, None, None), eye))) == 3


def spec() -> Any:
    class Spec:
        case = validated(CorneaCase, CASE)
        target = validated(CorneaTarget, {"constants": X1})

    return Spec()


def test_diverging_cornea_has_no_findings() -> None:
    soft = {"mu1_pa": 20.0, "alpha1": 2.0, "mu2_pa": 20.0, "alpha2": 2.0}
    assert found(constants=soft) == {}


def test_thickening_moves_only_the_posterior_surface() -> None:
    mesh = ORGAN.make_mesh(generated_section(), validated(CorneaCase, CASE))
    nodes = deeper(mesh, 0.05)
    np.testing.assert_allclose(nodes[mesh.anterior], mesh.nodes_mm[mesh.anterior], atol=1e-12)
    moved = np.linalg.norm((nodes - mesh.nodes_mm)[mesh.posterior], axis=1)
    np.testing.assert_allclose(moved, 0.05, rtol=1e-9)
    middle = mesh.posterior[np.argmin(np.abs(mesh.nodes_mm[mesh.posterior, 0]))]
    assert nodes[middle, 1] - mesh.nodes_mm[middle, 1] == pytest.approx(-0.05, rel=1e-3)


def test_frames_are_shown_with_their_contours(tmp_path: Path) -> None:
    pixel_mm = (0.015625, 0.0165)
    rest = RigidMotion((4.5, -2.9)).of_section(generated_section(points=1001))
    later = RigidMotion((0.0, -0.2), 0.01, (4.5, -1.0)).of_section(rest)
    specs = []
    for number, section in enumerate((rest, later)):
        frame = generated_frame(section, pixel_mm, (240, 576), seed=number)
        file = tmp_path / f"{number}.png"
        Image.fromarray(frame.grey.astype(np.uint8)).save(file)
        specs.append({"file": str(file), "pixel_mm": pixel_mm, "refraction": None})

    class Spec:
        case = validated(CorneaCase, CASE | {"reference": {"frame": specs[0]}})
        target = validated(CorneaTarget, {"frame": specs[1]})

    shown = list(figures(Spec(), (rest, later, None), {}))
    assert len(shown) == 2
    assert "-0.200 mm along y, +0.5" in shown[1][1]
    (tmp_path / "0.png").unlink()
    assert len(list(figures(Spec(), (rest, later, None), {}))) == 1


def test_breast_has_no_findings() -> None:
    assert findings_of("breast") is None
    assert findings_of("cornea") is not None
