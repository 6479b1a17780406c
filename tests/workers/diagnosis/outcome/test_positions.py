"""Positions of local effects are reported in the coordinates of the scans."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from palpate.workers.diagnosis.outcome import summarising
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.effects.local_stiffness_effects import INCLUSION
from palpate.workers.mechanics.effects.support_effects import LOCAL_ATTACHMENT
from palpate.workers.mechanics.model_parameters import NUMBER

CENTRE_MM = (100.0, -20.0, 22.5)


@pytest.mark.parametrize(("segmented", "between"), [(True, 0.06), (False, 0.0)])
def test_stiffness_intervals_include_the_difference_between_solvers(
    segmented: bool, between: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(summarising, "_parameter_sd", lambda *_: np.array([0.02, 0.03]))
    free = (FreeConstant("E", 0.001, 0.1), FreeConstant("b", 0.1, 10.0, NUMBER))
    fit: Any = SimpleNamespace(unknowns=SimpleNamespace(free=free), z=np.log([0.010, 2.0]))
    inverse = SimpleNamespace(is_segmented=segmented)
    diagnosis: Any = SimpleNamespace(analysis=SimpleNamespace(inverse=inverse))
    found = summarising._intervals(diagnosis, fit)
    reach = np.exp(1.6449 * np.hypot(0.02, between))
    assert found["E"] == pytest.approx((0.010 / reach, 0.010 * reach))
    assert found["b"] == pytest.approx((2.0 / np.exp(1.6449 * 0.03), 2.0 * np.exp(1.6449 * 0.03)))


@pytest.mark.parametrize(
    ("effect", "stem"), [(INCLUSION, "inclusion"), (LOCAL_ATTACHMENT, "attachment")]
)
def test_position_is_the_offset_from_the_middle_of_the_body(
    effect: Effect, stem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted = dict.fromkeys((p.name for p in effect.parameters), 1.0)
    fitted |= {f"{stem}_x": 3.0, f"{stem}_y": 4.0, f"{stem}_z": -7.2}
    monkeypatch.setattr(summarising, "_parameter_sd", lambda *_: np.full(len(fitted), 0.5))
    z = np.array(list(fitted.values()))
    fit = SimpleNamespace(unknowns=SimpleNamespace(names=tuple(fitted)), z=z)
    frame = SimpleNamespace(centre_mm=CENTRE_MM)
    analysis = SimpleNamespace(
        inverse=SimpleNamespace(frame=frame, is_segmented=True),
        screening_by_name={effect.name: SimpleNamespace(estimate=())},
    )
    joint_fits = {(effect.name,): SimpleNamespace(fit=fit)}
    diagnosis = SimpleNamespace(analysis=analysis, joint_fits=joint_fits)
    found = {p.parameter: p for p in summarising._parameters(diagnosis, effect, (effect.name,))}
    position = [found[f"{stem}_position_{axis}_mm"] for axis in "xyz"]
    assert [p.magnitude for p in position] == pytest.approx([103.0, -16.0, 15.3])
    assert [(p.sd, p.unit) for p in position] == [(0.5, "mm")] * 3
    shown = position[2].shown
    assert (shown.low, shown.value, shown.high) == pytest.approx((14.48, 15.3, 16.12), abs=0.01)
    assert f"{stem}_z_mm" not in found
    assert found[f"{stem}_radius_mm"].magnitude == 1.0
