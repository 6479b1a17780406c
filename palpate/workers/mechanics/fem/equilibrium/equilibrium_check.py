"""Check that the last state of Newton's method is in equilibrium.

Newton's method ends when its last full step is short. In a body that is very stiff for its
load every step is short, in equilibrium or not; so the forces of the last state are
compared with the load.
"""

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.elements.states import Stage, State
from palpate.workers.mechanics.fem.linear.level import Energy, Level

# Largest fraction of the load that may be out of balance, or missing on the plates.
LARGEST_SHARE = 1e-3
# Problems with a looser tolerance than this are allowed a proportionally larger fraction:
# the diagnosis solves such ones where a column only selects what to fit.
USUAL_TOLERANCE_MM = 2e-3
# Smaller forces are rounding errors: the body is not loaded.
ROUNDING_N = 1e-7


def equilibrium_fault(
    level: Level, state: State, at: Energy, stage: Stage, force: FloatArray
) -> str:
    """Return the reason why a state is not in equilibrium, with the residual; empty if it is.

    Parameters
    ----------
    level : Level
    state, at : State and Energy
        The last state, and its energy.
    stage : Stage
        The full load.
    force : ndarray, shape (n, 3)
        Out-of-balance force on every node in N, including held ones.
    """
    load_n = load_size_n(level, state, at, stage, force)
    allowed = LARGEST_SHARE * max(1.0, level.problem.tolerance_mm / USUAL_TOLERANCE_MM)
    allowed_n = max(allowed * load_n, ROUNDING_N)
    residual_n = float(np.linalg.norm(force * level.free))
    missing_n = 0.0 if stage.force_n is None else abs(at.contact.travel_force - stage.force_n)
    if residual_n <= allowed_n and missing_n <= allowed_n:
        return ""
    what, size_n = (
        ("forces on the plates miss the load by", missing_n)
        if missing_n > allowed_n
        else ("forces out of balance are", residual_n)
    )
    share = f"{size_n / load_n:.2g} of the load" if load_n > 0 else "without a load"
    return f"not in equilibrium: {what} {size_n:.3g} N, {share}; {allowed:g} is allowed"


def load_size_n(level: Level, state: State, at: Energy, stage: Stage, force: FloatArray) -> float:
    """Return the size of the load in N: plates, forces, prescribed displacements.

    If none of these act, it is the size of the reactions of the supports.
    """
    plates_n = stage.force_n if stage.force_n is not None else max(at.plate_forces)
    follower = state.history.follower_force
    outer = level.dead_load if follower is None else level.dead_load + follower
    reactions = np.abs(force * (1 - level.free))
    moved_n = float(reactions[level.prescribed_mm != 0].sum())
    load_n = max(plates_n, float(np.abs(outer).sum()), moved_n)
    return load_n if load_n > ROUNDING_N else float(reactions.sum())
