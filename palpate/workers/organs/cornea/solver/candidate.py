"""A candidate, and candidates with one parameter changed."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.material.constants import CorneaConstants
from palpate.workers.organs.cornea.material.load import CorneaLoad
from palpate.workers.organs.cornea.material.stiffness_gradient import stiffness_factors
from palpate.workers.organs.cornea.solver.prepared_mesh import PreparedMesh

# Smallest scale for changes in a pressure.
SMALLEST_PRESSURE_SCALE_MPA = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A mesh prepared for a model, constants and a load."""

    prepared: PreparedMesh
    constants: CorneaConstants
    load: CorneaLoad


def parameter_names(candidate: Candidate) -> tuple[str, ...]:
    """Return the parameters with respect to which a candidate can be differentiated.

    Ogden terms are numbered from 1: mu1_mpa, alpha1, mu2_mpa, ...
    """
    terms = range(1, len(candidate.constants.mu_mpa) + 1)
    ogden = [name for i in terms for name in (f"mu{i}_mpa", f"alpha{i}")]
    elastic = candidate.prepared.model.limbus_mpa_per_mm is not None
    model = [name for name in _OF_MODEL if elastic or name != "limbus_mpa_per_mm"]
    return (*ogden, "bulk_mpa", *_OF_LOAD, *_OF_EYE, *model)


def scale_of(candidate: Candidate, name: str) -> float:
    """Return a significant change in a parameter, in its unit; difference steps are relative to it.

    Raises
    ------
    InputError
        If the parameter is unknown.
    """
    constants, load = candidate.constants, candidate.load
    if name not in parameter_names(candidate):
        raise InputError(
            f"A cornea has no parameter {name!r}. It has {', '.join(parameter_names(candidate))}."
        )
    if name == "bulk_mpa":
        return constants.bulk_mpa
    if name.startswith("mu"):
        return abs(constants.mu_mpa[_term(name)])
    if name.startswith("alpha"):
        return abs(constants.alpha[_term(name)])
    if name in ("iop_mpa", "jet_pressure_mpa", "iop_rise_mpa"):
        return max(abs(getattr(load, name)), SMALLEST_PRESSURE_SCALE_MPA)
    if name == "limbus_mpa_per_mm":
        return float(candidate.prepared.model.limbus_mpa_per_mm or 1.0)
    return 1.0


def changed(candidate: Candidate, name: str, by: float) -> Candidate:
    """Return a candidate with one parameter increased.

    Raises
    ------
    InputError
        If the parameter is unknown, or cannot be changed that far.
    """
    scale_of(candidate, name)
    constants, load = candidate.constants, candidate.load
    if name == "bulk_mpa":
        return replace(candidate, constants=replace(constants, bulk_mpa=constants.bulk_mpa + by))
    if name.startswith("mu"):
        mu = _increased(constants.mu_mpa, _term(name), by)
        return replace(candidate, constants=replace(constants, mu_mpa=mu))
    if name.startswith("alpha"):
        alpha = _increased(constants.alpha, _term(name), by)
        return replace(candidate, constants=replace(constants, alpha=alpha))
    if name in _OF_LOAD:
        return replace(candidate, load=replace(load, **{name: getattr(load, name) + by}))
    if name in _OF_EYE:
        return replace(candidate, load=_OF_EYE[name](load, by))
    return replace(candidate, prepared=_with_model(candidate.prepared, name, by))


_OF_LOAD = ("iop_mpa", "jet_pressure_mpa", "jet_centre_mm", "jet_width_factor", "iop_rise_mpa")
_OF_MODEL = ("limbus_mpa_per_mm", "depth_gradient", "side_gradient")
_OF_EYE: dict[str, Callable[[CorneaLoad, float], CorneaLoad]] = {
    "eye_shift_x_mm": lambda load, by: replace(
        load, eye_shift_mm=(load.eye_shift_mm[0] + by, load.eye_shift_mm[1])
    ),
    "eye_shift_y_mm": lambda load, by: replace(
        load, eye_shift_mm=(load.eye_shift_mm[0], load.eye_shift_mm[1] + by)
    ),
    "eye_tilt_rad": lambda load, by: replace(load, eye_tilt_rad=load.eye_tilt_rad + by),
}


def _with_model(prepared: PreparedMesh, name: str, by: float) -> PreparedMesh:
    model = replace(prepared.model, **{name: getattr(prepared.model, name) + by})
    return replace(prepared, model=model, stiffness=stiffness_factors(prepared.mesh, model))


def _term(name: str) -> int:
    return int(name.removeprefix("mu").removeprefix("alpha").removesuffix("_mpa")) - 1


def _increased(values: tuple[float, ...], k: int, by: float) -> tuple[float, ...]:
    return (*values[:k], values[k] + by, *values[k + 1 :])
