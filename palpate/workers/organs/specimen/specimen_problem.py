"""Boundary value problems of a bench specimen, from its materials, loads and holds."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from palpate.storage.values import Tissue, Triple
from palpate.workers.diagnosis.problem.inverse_problem import FreeConstant
from palpate.workers.mechanics.fem.boundary_value_problem import (
    GRAVITY_MM_PER_S2,
    Constants,
    Problem,
)
from palpate.workers.mechanics.fem.loads_and_regions import (
    Box,
    DeadForce,
    DisplacementField,
    Hold,
    NoPlates,
    OutsideCircle,
    Pressure,
    Wall,
)
from palpate.workers.mechanics.materials.law_plugins import DEFAULT_LAW, law_named
from palpate.workers.mechanics.model_parameters import KPA, NUMBER
from palpate.workers.organs.specimen.specimen_body_keys import Axis, RegionSpec
from palpate.workers.organs.specimen.specimen_keys import ForceSpec, LoadsSpec, SpecimenSpec

AXES = ("x", "y", "z")
# Nodes this close to a plane belong to it.
NEAR_MM = 1e-3
# A fit may try any 1 - 2 nu > 0, but auxetic materials are not supported.
MOST_COMPRESSIBLE = 0.998
KG_PER_M3 = 1e-12  # in t/mm^3
T_PER_G = 1e-6


def young_name(spec: SpecimenSpec, material: str) -> str:
    """Return the name of Young's modulus of a material: E, or E_name if there are several."""
    return "E" if len(spec.materials) == 1 else f"E_{material}"


def compressibility_name(spec: SpecimenSpec, material: str) -> str:
    """Return the name of the constant 1 - 2 nu of a material; see `young_name`."""
    return "compressibility" if len(spec.materials) == 1 else f"compressibility_{material}"


def shape_name(spec: SpecimenSpec, material: str, name: str) -> str:
    """Return the name of a shape constant of a material's law; see `young_name`."""
    return name if len(spec.materials) == 1 else f"{name}_{material}"


def region_of(region: RegionSpec) -> Box | OutsideCircle:
    """Return a region of the file as a region of the solver."""
    if region.box_mm is not None:
        low, high = region.box_mm.lower, region.box_mm.upper
        return Box(_moved(low, -NEAR_MM), _moved(high, NEAR_MM))
    if region.outside_circle_mm is not None:
        circle = region.outside_circle_mm
        return OutsideCircle(circle.centre, circle.radius)
    if region.plane is None:
        raise AssertionError("a region is a box, a plane or outside a circle")
    axis = AXES.index(region.plane.axis)
    lower, upper = np.full(3, -np.inf), np.full(3, np.inf)
    lower[axis], upper[axis] = region.plane.at_mm - NEAR_MM, region.plane.at_mm + NEAR_MM
    return Box(_moved(lower, 0.0), _moved(upper, 0.0))


def _moved(corner: Iterable[float], by_mm: float) -> Triple:
    x, y, z = (float(v) + by_mm for v in corner)
    return x, y, z


def problem_of(
    spec: SpecimenSpec,
    loads: LoadsSpec,
    values: Mapping[str, float],
    wall_mm: float,
    measured: Mapping[str, DisplacementField] = MappingProxyType({}),
    softer: float = 1.0,
) -> Problem:
    """Return the boundary value problem of one state.

    Parameters
    ----------
    spec : SpecimenSpec
    loads : StateSpec or PredictSpec
    values : mapping of str to float
        Young's modulus of each material in MPa, see `young_name`; 1 - 2 nu if it is fitted,
        see `compressibility_name`; the fitted shape constants of laws, see `shape_name`.
    wall_mm : float
        Lowest z of the body. A hold on that whole plane becomes the wall of the solver, which
        can be made compliant; other regions become `Hold`.
    measured : mapping of str to DisplacementField
        Displacements of the regions that move as measured in this state.
    softer : float
        Factor by which Young's moduli are multiplied.
    """
    places = {name: region_of(region) for name, region in spec.regions.items()}
    wall, holds = Wall((False, False, False)), []
    for hold in spec.holds:
        axes = held_axes(hold.axes)
        if is_wall(spec, hold.region, wall_mm):
            wall = Wall(axes)
        else:
            holds.append(Hold(places[hold.region], axes=axes))
    holds += [
        Hold(
            places[move.region], move.displacement_mm or measured[move.region], held_axes(move.axes)
        )
        for move in loads.moves
    ]
    return Problem(
        constants=_constants(spec, values, softer),
        load=NoPlates(),
        wall=wall,
        gravity_g=spec.unit_down if spec.gravity == "modelled" else (0.0, 0.0, 0.0),
        forces=tuple(
            DeadForce(_force_n(force, spec.unit_down), places[force.region])
            for force in loads.forces
        ),
        holds=tuple(holds),
        pressures=((Pressure(KPA.to_inside(loads.pressure_kpa)),) if loads.pressure_kpa else ()),
    )


def is_wall(spec: SpecimenSpec, region: str, wall_mm: float) -> bool:
    """Test whether a region is the lowest plane of the body, within half a voxel."""
    plane = spec.regions[region].plane
    near = NEAR_MM + (spec.body.voxel_mm or 0.0) / 2
    return plane is not None and plane.axis == "z" and abs(plane.at_mm - wall_mm) < near


def held_axes(axes: tuple[Axis, ...]) -> tuple[bool, bool, bool]:
    """Return axes as flags for x, y and z."""
    return "x" in axes, "y" in axes, "z" in axes


def _constants(
    spec: SpecimenSpec, values: Mapping[str, float], softer: float
) -> dict[Tissue, Constants]:
    constants = {}
    for name, material in spec.materials.items():
        nu = material.nu
        if not isinstance(nu, float):
            nu = (1.0 - min(values[compressibility_name(spec, name)], MOST_COMPRESSIBLE)) / 2.0
        own = Constants(
            softer * values[young_name(spec, name)],
            nu,
            density_t_per_mm3=material.density_kg_per_m3 * KG_PER_M3,
        )
        if material.law != DEFAULT_LAW:
            searched = {n: values[shape_name(spec, name, n)] for n in material.shape_free}
            law = law_named(material.law)
            own = replace(own, law=law.law(own.mu_mpa, material.shape_held | searched))
        constants[spec.tissue_of(name)] = own
    return constants


def _force_n(force: ForceSpec, down: Triple) -> Triple:
    if force.force_n is not None:
        return force.force_n
    weight = (force.mass_g or 0.0) * T_PER_G * GRAVITY_MM_PER_S2
    return down[0] * weight, down[1] * weight, down[2] * weight


def free_constants(spec: SpecimenSpec) -> list[FreeConstant]:
    """Return the fitted constants: E of each material, 1 - 2 nu if nu is fitted, shape constants.

    The fit uses 1 - 2 nu because nu must stay below 0.5, which a normal prior on its logarithm
    cannot ensure. The interval of nu bounds the fit; the interval of E is a prior that contains E
    with a probability of two in three.
    """
    constants = [
        FreeConstant(
            young_name(spec, name),
            KPA.to_inside(material.E_kpa[0]),
            KPA.to_inside(material.E_kpa[1]),
        )
        for name, material in spec.materials.items()
    ]
    for name, material in spec.materials.items():
        if isinstance(material.nu, tuple):
            low, high = (1.0 - 2.0 * nu for nu in reversed(material.nu))
            name_inside = compressibility_name(spec, name)
            constants.append(FreeConstant(name_inside, low, high, NUMBER, is_bound=True))
    for name, material in spec.materials.items():
        for shape, (low, high) in material.shape_free.items():
            unit = material.shape[shape].unit
            constants.append(FreeConstant(shape_name(spec, name, shape), low, high, unit))
    return constants
