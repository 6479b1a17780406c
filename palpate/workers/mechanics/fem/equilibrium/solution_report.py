"""The outcome of a simulation, from the end of its load path."""

from collections.abc import Sequence

from palpate.storage.values import Tissue
from palpate.workers.mechanics.fem.contact.plates import PlateContact
from palpate.workers.mechanics.fem.elements import element_energy
from palpate.workers.mechanics.fem.elements.model import LevelModel
from palpate.workers.mechanics.fem.elements.states import Stage, State
from palpate.workers.mechanics.fem.equilibrium.equilibrium_check import equilibrium_fault
from palpate.workers.mechanics.fem.equilibrium.load_schedule import touching_gap
from palpate.workers.mechanics.fem.equilibrium.load_stepping import LoadPath
from palpate.workers.mechanics.fem.linear.level import Level
from palpate.workers.mechanics.fem.problem.outcome import SQUEEZED_J, Outcome, Solution


def report(finest: Level, imaged: LevelModel, path: LoadPath) -> Solution:
    """Return the displacement from the imaged shape, and the outcome."""
    model, stage, state, results = finest.model, path.stage, path.states[-1], path.results
    at = finest.energy(state, stage)
    lower, upper = at.plate_forces
    min_j = float(element_energy.smallest_volume_ratio(state.x, model.elements))
    force = finest.force(state, at, stage)
    reason = path.reason or equilibrium_fault(finest, state, at, stage, force)
    if min_j <= 0 and not reason:
        reason = "elements are turned inside out"
    if reason:
        reason += _collapsed_tissue(model, state)
    deepest = max((float(p.penetration.max()) for p in at.plate_contacts), default=0.0)
    sprung = finest.springs * (state.x - model.nodes)
    reaction = (force - sprung)[model.wall, 2].sum()
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
            contact_area_mm2=_contact_area_mm2(model, at.plate_contacts),
            penetration_mm=deepest,
            min_j=min_j,
            energy_mj=at.elastic,
            force_imbalance=abs(upper - lower) / max(upper, 1e-12),
            wall_force_n=float(reaction),
            squeezed=not reason and min_j < SQUEEZED_J,
        ),
    )


def _collapsed_tissue(model: LevelModel, state: State) -> str:
    """Return a clause on squeezed elements and their main tissue to append to a reason; or ""."""
    ratios = element_energy.volume_ratios(state.x, model.elements)
    collapsed = ratios < SQUEEZED_J
    if not collapsed.any():
        return ""
    lost = model.elements.volumes[collapsed] @ model.fractions[collapsed]
    tissue = Tissue(int(lost.argmax())).name.lower()
    return (
        f"; {collapsed.sum()} of {len(ratios)} elements, most of them {tissue}, are squeezed to "
        f"less than {SQUEEZED_J:g} of their volume (the worst to {ratios.min():.2g})"
    )


def _travel_mm(model: LevelModel, stage: Stage, state: State) -> float:
    """Return the distance by which the plates approached after just touching the body."""
    if stage.force_n is not None:
        return state.travel_mm
    if stage.gap is None:
        return 0.0
    touching = touching_gap(model.nodes, stage.device)
    return (touching.upper_mm - touching.lower_mm) - (stage.gap.upper_mm - stage.gap.lower_mm)


def _contact_area_mm2(model: LevelModel, contacts: Sequence[PlateContact]) -> float:
    """Return the undeformed surface area pressed against the upper plate."""
    if not contacts:
        return 0.0
    stiffness = model.contact_nodes.stiffness
    pressed = stiffness[contacts[-1].gap < 0].sum()
    return float(pressed / stiffness.sum() * model.sheet.area.sum())
