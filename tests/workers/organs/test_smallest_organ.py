"""An organ that writes only what has no default: a column of jelly under a pressure."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Volume
from palpate.testing import check_organ
from palpate.workers.common_keys import CaseSpec, Door, ScoreSpec, TargetSpec
from palpate.workers.mechanics.model_parameters import KPA, Parameter, Vocabulary
from palpate.workers.organs import organ_plugins
from palpate.workers.organs.organ_plugins import OrganPlugin, organ_of
from palpate.workers.organs.organ_protocol import Organ, OrganSpec
from palpate.workers.tasks import study_tasks as tasks
from palpate.workers.tasks import task_store

PARAMETERS = Vocabulary([Parameter("E", KPA, 0.001, 0.1, 0.01, "Young's modulus")])


class ColumnReference(Door):
    """A column of layers of 1 mm."""

    layers: int = 10


class ColumnCase(CaseSpec):
    """A column under a pressure."""

    organ: Literal["column"] = "column"
    reference: ColumnReference = ColumnReference()
    pressure_mpa: float = 0.001

    @property
    def parameters(self) -> Vocabulary:
        return PARAMETERS

    def complete(self, constants: Mapping[str, float] | None = None) -> dict[str, float]:
        return PARAMETERS.complete(PARAMETERS.from_door(self.constants), constants or {})


@dataclass
class Height:
    """Compares the heights of two columns."""

    target: Volume

    def score(self, body: Volume, /) -> Any:
        away_mm = abs(_height_mm(body) - _height_mm(self.target))
        gsf = math.log(away_mm) if away_mm else -math.inf
        scores = {"jc": 1.0, "mhd_mm": away_mm, "mhd_voxels": away_mm, "gsf": gsf}
        return SimpleNamespace(as_dict=lambda: scores)


def _height_mm(body: Volume) -> float:
    return body.spacing_mm[2] * len(body.values)


class Column(Organ[Volume, dict[str, Any], dict[str, Any]]):
    """A column, whose strain is its pressure over its modulus."""

    name = "column"
    picture_labels: Mapping[int, str] = {1: "jelly"}

    def make_body(self, spec: Any) -> Volume:
        return Volume(np.ones((spec.layers, 1, 1), np.uint8), (1.0, 1.0, 1.0))

    def make_mesh(self, body: Volume, case: Any) -> dict[str, Any]:
        z = np.linspace(0, _height_mm(body), 5)
        return {"nodes": np.stack([0 * z, 0 * z, z], axis=1)}

    def facts(self, body: Volume, mesh: dict[str, Any]) -> dict[str, Any]:
        return {"nodes": len(mesh["nodes"])}

    def problem(
        self, model: Any, case: Any, constants: Any, landmarks: Any, target_landmarks: Any = None
    ) -> float:
        return float(case.pressure_mpa / constants["E"])

    def solve(self, model: dict[str, Any], problem: float) -> Any:
        outcome = SimpleNamespace(converged=True, reason="", as_dict=dict)
        return SimpleNamespace(displacement_mm=model["nodes"] * [0, 0, -problem], outcome=outcome)

    def deform(
        self, body: Volume, mesh: dict[str, Any], displacement_mm: FloatArray, target: Any = None
    ) -> Volume:
        x, y, z = body.spacing_mm
        return replace(body, spacing_mm=(x, y, z + displacement_mm[-1, 2] / len(body.values)))

    def scorer(self, target: Volume, spec: Any) -> Height:
        return Height(target)


ORGAN = Column()
WRITTEN = [name for name in vars(Column) if not name.startswith("_")]
# The same methods in an object that does not inherit from `Organ`, complete and without a scorer.
NO_ORGAN = SimpleNamespace(**{name: getattr(ORGAN, name) for name in WRITTEN})
INCOMPLETE = SimpleNamespace(**{name: getattr(ORGAN, name) for name in WRITTEN[:-1]})
SPEC = OrganSpec(ColumnCase, TargetSpec, ScoreSpec, PARAMETERS)
UNFITTED = replace(SPEC, nuisances=lambda case, imaged: ())
COLUMN = OrganPlugin("column", f"{__name__}:SPEC", f"{__name__}:ORGAN")


@pytest.mark.parametrize("attribute", ["ORGAN", "NO_ORGAN"])
def test_passes_the_checks_of_a_plug_in(attribute: str) -> None:
    check_organ(replace(COLUMN, organ=f"{__name__}:{attribute}"), {})


@pytest.mark.parametrize("attribute", ["ORGAN", "NO_ORGAN"])
def test_is_simulated_and_compared(
    attribute: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = replace(COLUMN, organ=f"{__name__}:{attribute}")
    monkeypatch.setattr(organ_plugins, "organ_plugin", lambda name: plugin)
    for module in (tasks, task_store):  # a test is no module of a distribution
        monkeypatch.setattr(module, "code_version", lambda *modules: "code")
    store, case = str(tmp_path / attribute), {"organ": "column"}
    prepared = tasks.prepare_case(case, store)
    target = tasks.make_target(case, {"constants": {"E_kpa": 20}}, store)["target"]
    assert target is not None
    request: Any = {"store": store, "case": case, "prepared": prepared, "target": target}
    result = tasks.evaluate({**request, "constants": {"E": 0.01}})
    # A column of 10 mm loses 0.1 of its height where its target loses 0.05.
    assert result["score"]["mhd_mm"] == pytest.approx(0.5)
    assert tasks.score_bodies(case, store, target, target)["column"]["mhd_mm"] == 0
    free = [{"name": "E", "lower": 0.001, "upper": 0.1}]
    with pytest.raises(InputError, match="the organ column has no derivatives"):
        tasks.evaluate({**request, "constants": {"E": 0.01}, "free": free})
    with pytest.raises(InputError, match="the organ column has no derivatives"):
        tasks.prepare_level(case, prepared, target, 2.0, 3, store)


def test_does_without_what_it_lacks() -> None:
    body, case = ORGAN.make_body(ColumnReference()), ColumnCase()
    assert not ORGAN.body_files(case.reference)
    assert ORGAN.pressed(case) is None
    assert ORGAN.coarse(body, 2.0) is body
    assert ORGAN.simulated_case(case, TargetSpec(constants={})) is case
    with pytest.raises(InputError, match="images of the organ column cannot be aligned"):
        ORGAN.aligned(body, body, case)


def test_names_what_is_missing() -> None:
    with pytest.raises(TypeError, match=r"abstract.*scorer"):
        organ_of(replace(COLUMN, organ=f"{__name__}:INCOMPLETE"))


def test_nuisances_without_a_fit_are_refused() -> None:
    plugin = replace(COLUMN, spec=f"{__name__}:UNFITTED")
    with pytest.raises(AssertionError, match="both a fit and nuisances"):
        check_organ(plugin, {})
