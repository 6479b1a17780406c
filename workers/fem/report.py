"""What the solver says of its own result."""

from collections.abc import Sequence

import numpy as np

from workers.fem import kernels
from workers.fem.contact import Gap
from workers.fem.level import Level, Stage, State
from workers.fem.model import LevelModel
from workers.fem.newton import Result
from workers.fem.outcome import SQUEEZED_J, Outcome, Solution


def report(
    finest: Level, imaged: LevelModel, stage: Stage, state: State, results: Sequence[Result]
) -> Solution:
    """Displacement from the imaged shape, and the outcome."""
    model = finest.model
    at = finest.energy(state, stage)
    lower, upper = at.plate_forces
    min_j = float(kernels.smallest_volume_ratio(state.x, model.elements))
    reason = results[-1].reason
    deepest = max((float(p.depth.max()) for p in at.presses), default=0.0)
    sprung = finest.springs * (state.x - model.nodes)
    reaction = (finest.force(state, at, stage) - sprung)[model.wall, 2].sum()
    return Solution(
        displacement_mm=state.x - imaged.nodes,
        outcome=Outcome(
            converged=not reason,
            reason=reason,
            newton_iterations=tuple(r.iterations for r in results),
            cg_iterations=tuple(r.cg_iterations for r in results),
            residual_n=results[-1].residual_n,
            plate_displacement_mm=_travel_mm(model, stage, state),
            plate_force_n=upper,
            contact_area_mm2=_contact_area_mm2(model, at.presses),
            penetration_mm=deepest,
            min_j=min_j,
            energy_mj=at.elastic,
            force_imbalance=abs(upper - lower) / max(upper, 1e-12),
            wall_force_n=float(reaction),
            squeezed=not reason and min_j < SQUEEZED_J,
        ),
    )


def _travel_mm(model: LevelModel, stage: Stage, state: State) -> float:
    """How far the plates have closed, from where they would just touch the body."""
    if stage.force_n is not None:
        return state.travel_mm
    if stage.gap is None:
        return 0.0
    axis = np.asarray(stage.device.axis) / np.linalg.norm(stage.device.axis)
    along = model.nodes @ axis
    touching = Gap(float(along.min()), float(along.max()))
    return (touching.upper_mm - touching.lower_mm) - (stage.gap.upper_mm - stage.gap.lower_mm)


def _contact_area_mm2(model: LevelModel, presses: Sequence) -> float:  # type: ignore[type-arg]
    if not presses:
        return 0.0
    stiffness = model.pads.stiffness
    pressed = stiffness[presses[-1].gap < 0].sum()
    return float(pressed / stiffness.sum() * model.sheet.area.sum())
