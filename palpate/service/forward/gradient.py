"""The derivative of a displacement with respect to a constant of the model."""

from collections.abc import Callable

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.mechanics.fem.equilibrium.sensitivity import tangents
from palpate.workers.mechanics.fem.equilibrium.solve import Equilibrium, equilibrium
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Change, Problem
from palpate.workers.mechanics.parameters import Parameter

# Relative step of a constant: of its value, or of its interval if it can be zero.
STEP = 1e-4
# The same for a constant with path-dependent solutions: friction saturates quickly.
PATH_STEP = 0.02


def displacement_gradient(
    at: Equilibrium,
    problem_at: Callable[[float], Problem],
    parameter: Parameter,
    value: float,
    *,
    follows_path: bool = False,
) -> FloatArray:
    """Differentiate the displacement of an equilibrium with respect to one constant.

    Parameters
    ----------
    at : Equilibrium
    problem_at : callable
        Maps a value of the constant, in internal units, to the problem.
    parameter : Parameter
    value : float
        The constant at the equilibrium, in internal units.
    follows_path : bool
        Whether this constant, like friction, makes the solution depend on the load path. If so, the
        problem is solved again on both sides; otherwise a linear solve is enough.

    Returns
    -------
    ndarray, shape (n, 3)
        Derivative in mm per unit of the constant in study files, such as mm per kPa.

    Raises
    ------
    InputError
        If the simulation, or a nearby one, did not converge.
    """
    ahead, behind = either_side(parameter, value, PATH_STEP if follows_path else STEP)
    per_unit = parameter.unit.to_inside(1.0)
    if not follows_path:
        change = Change(problem_at(ahead), problem_at(behind), ahead - behind)
        moved: FloatArray = tangents(at, [change])[0]
        return moved * per_unit
    ends = [_displacement(at, problem_at(one), parameter) for one in (ahead, behind)]
    return (ends[0] - ends[1]) * (per_unit / (ahead - behind))


def either_side(parameter: Parameter, value: float, step: float) -> tuple[float, float]:
    """Return admissible values above and below a value, or the value itself at a bound.

    Examples
    --------
    >>> from palpate.workers.mechanics.parameters import BREAST
    >>> either_side(BREAST["E_fat"], 0.01, 0.5)
    (0.015, 0.005)
    """
    h = step * (value if parameter.lower > 0 else parameter.upper - parameter.lower)
    return _admissible(parameter, value + h, value), _admissible(parameter, value - h, value)


def _admissible(parameter: Parameter, wanted: float, otherwise: float) -> float:
    try:
        return parameter.check(wanted)
    except InputError:
        return otherwise


def _displacement(at: Equilibrium, problem: Problem, parameter: Parameter) -> FloatArray:
    solution = equilibrium(at.imaged, problem, at).solution
    if not solution.outcome.converged:
        raise InputError(
            f"The derivative with respect to {parameter.door_name} cannot be computed: a nearby "
            f"simulation diverged ({solution.outcome.reason})."
        )
    return solution.displacement_mm
