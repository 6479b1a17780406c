"""Effects that may explain differences between a simulated cornea and its image."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.storage.values import FloatArray, IntArray, Tissue
from palpate.workers.mechanics.effects.effect import (
    Catalogue,
    Effect,
    Family,
    Values,
    from_zero,
    plugged_effects,
    two_sided,
    unchanged_problem,
)
from palpate.workers.mechanics.fem.boundary_value_problem import Frame
from palpate.workers.mechanics.model_parameters import (
    DEGREE,
    MM,
    MM_PER_KPA,
    MMHG,
    NUMBER,
    Parameter,
    percent,
    ratio,
)
from palpate.workers.organs.cornea.cornea_forward import CorneaProblem, remodelled
from palpate.workers.organs.cornea.cornea_problem import Candidate
from palpate.workers.organs.cornea.corneal_model import JetProfile
from palpate.workers.organs.cornea.prestressed_equilibrium import thickened

THESIS = "M. A. Lago, PhD thesis, 2014, chapter 5"
# Points at which a non-uniform jet is tabulated, relative to its radius.
PROFILE_PLACES = np.linspace(0.0, 1.0, 41)

Change = Callable[[Candidate, Values], Candidate]


def _of_candidate(change: Change) -> Any:
    def transform(problem: Any, values: Values, frame: Frame) -> CorneaProblem:
        return replace(problem, candidate=change(problem.candidate, values))

    return transform


def _of_load(change: Callable[[Any, Values], Any]) -> Any:
    return _of_candidate(lambda c, values: replace(c, load=change(c.load, values)))


def _effect(
    name: str,
    family: Family,
    summary: str,
    parameters: tuple[Parameter, ...],
    prior_sd: tuple[float, ...],
    transform: Any,
    observation: Any = None,
    step: float = 1e-4,
    reference: str = THESIS,
    searched_as: tuple[str, ...] = (),
) -> Effect:
    """Return an effect whose difference steps are a fraction of its prior range."""
    steps = tuple(step * sd for sd in prior_sd)
    return Effect(
        name,
        family,
        summary,
        parameters,
        prior_sd,
        steps,
        transform,
        (reference,),
        observation=observation,
        searched_as=searched_as,
    )


def peaked(load: Any, by: float) -> JetProfile:
    """Return a uniform jet made stronger in the middle and weaker outside at the same force.

    The pressure is ``1 + by (1 - 2 s^2)`` at the fraction s of its radius: the mean over a line
    through the middle changes by a third of `by`, the mean over its area does not change.
    """
    radius = load.jet_diameter_mm / 2
    inside = np.maximum(1.0 + by * (1.0 - 2.0 * PROFILE_PLACES**2), 0.0)
    return JetProfile(tuple((radius * PROFILE_PLACES).tolist()), tuple(inside.tolist()))


def _jet_profile(load: Any, values: Values) -> Any:
    if load.jet_profile is not None:
        return load
    return replace(load, jet_profile=peaked(load, values["jet_peakedness"]))


def _limbus(candidate: Candidate, values: Values) -> Candidate:
    stiffness = candidate.prepared.model.limbus_mpa_per_mm
    softness = values["limbus_yield"] + (0.0 if stiffness is None else 1 / stiffness)
    return remodelled(candidate, limbus_mpa_per_mm=1 / softness) if softness > 0 else candidate


def _graded(candidate: Candidate, values: Values) -> Candidate:
    model = candidate.prepared.model
    return remodelled(
        candidate,
        depth_gradient=model.depth_gradient + values["through_depth"],
        side_gradient=model.side_gradient + values["side_to_side"],
    )


def _moved(load: Any, values: Values) -> Any:
    x, y = load.eye_shift_mm
    return replace(
        load,
        eye_shift_mm=(x + values["eye_shift_x"], y + values["eye_shift_y"]),
        eye_tilt_rad=load.eye_tilt_rad + float(np.radians(values["eye_tilt"])),
    )


def _share(option: str, value: str, name: str) -> Any:
    def transform(problem: Any, values: Values, frame: Frame) -> CorneaProblem:
        if getattr(problem.candidate.prepared.model, option) == value:
            return problem
        return replace(problem, shares=problem.shares | {(option, value): values[name]})

    return transform


def _posterior(
    points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
) -> FloatArray:
    """Return 1 on the inner surface, and a term that grows towards its middle, (k, 2)."""
    inner = (np.asarray(tissues) == Tissue.GLANDULAR).astype(np.float64)
    x = frame.normalised(points)[:, 0]
    return np.stack([inner, inner * (1.0 - x**2)], axis=1)


def _both_surfaces(
    points: FloatArray, normals: FloatArray, tissues: IntArray, frame: Frame
) -> FloatArray:
    return np.ones((len(points), 1))


_LIMBUS_YIELD = MM_PER_KPA.to_inside(0.0005)
_ONE_MMHG = MMHG.to_inside(1.0)

CORNEA_EFFECTS: tuple[Effect, ...] = (
    _effect(
        "jet_off_centre",
        "loading",
        "The jet hits the cornea at a different position than in the model.",
        (two_sided("jet_offset", MM, 0.6, "position of the jet, relative to the stated position"),),
        (0.2,),
        _of_load(lambda load, v: replace(load, jet_centre_mm=load.jet_centre_mm + v["jet_offset"])),
        searched_as=("jet_centre",),
    ),
    _effect(
        "jet_pressure_error",
        "loading",
        "The jet is stronger or weaker than stated.",
        (
            two_sided(
                "jet_pressure_part",
                NUMBER,
                0.3,
                "relative excess of the jet's pressure",
                reading=ratio("times the stated pressure"),
            ),
        ),
        (0.1,),
        _of_load(
            lambda load, v: replace(
                load, jet_pressure_mpa=load.jet_pressure_mpa * np.exp(v["jet_pressure_part"])
            )
        ),
        searched_as=("jet_pressure",),
    ),
    _effect(
        "jet_width_error",
        "loading",
        "The jet is wider or narrower than stated.",
        (
            two_sided(
                "jet_width_part",
                NUMBER,
                0.3,
                "relative excess of the jet's width",
                reading=ratio("times the stated width"),
            ),
        ),
        (0.1,),
        _of_load(
            lambda load, v: replace(
                load, jet_width_factor=load.jet_width_factor * np.exp(v["jet_width_part"])
            )
        ),
        searched_as=("jet_width",),
    ),
    _effect(
        "jet_profile",
        "loading",
        "The pressure of the jet is not uniform over its width.",
        (
            two_sided(
                "jet_peakedness",
                NUMBER,
                1.0,
                "excess in the middle of the jet",
                reading=percent("% more in the middle of the jet"),
            ),
        ),
        (0.3,),
        _of_load(_jet_profile),
    ),
    _effect(
        "iop_error",
        "loading",
        "The intraocular pressure differs from the measured one.",
        (
            two_sided(
                "iop_difference", MMHG, 8.0 * _ONE_MMHG, "pressure in excess of the stated one"
            ),
        ),
        (2.0 * _ONE_MMHG,),
        _of_load(
            lambda load, v: replace(load, iop_mpa=max(0.0, load.iop_mpa + v["iop_difference"]))
        ),
        searched_as=("iop",),
    ),
    _effect(
        "iop_rise",
        "loading",
        "The intraocular pressure rises during the puff.",
        (from_zero("iop_rise", MMHG, 10.0 * _ONE_MMHG, "rise of the intraocular pressure"),),
        (3.0 * _ONE_MMHG,),
        _of_load(lambda load, v: replace(load, iop_rise_mpa=load.iop_rise_mpa + v["iop_rise"])),
    ),
    _effect(
        "whole_eye_motion",
        "boundary",
        "The whole eye moves and tilts under the jet.",
        (
            two_sided("eye_shift_x", MM, 0.5, "motion of the eye to the right"),
            two_sided("eye_shift_y", MM, 0.5, "motion of the eye outwards"),
            two_sided("eye_tilt", DEGREE, 3.0, "rotation of the eye, counter-clockwise"),
        ),
        (0.1, 0.2, 1.0),
        _of_load(_moved),
    ),
    _effect(
        "limbus_compliance",
        "boundary",
        "The limbus yields.",
        (from_zero("limbus_yield", MM_PER_KPA, 2 * _LIMBUS_YIELD, "compliance of the limbus"),),
        (_LIMBUS_YIELD,),
        _of_candidate(_limbus),
        searched_as=("limbus_compliance",),
    ),
    _effect(
        "stiffness_gradient",
        "local stiffness",
        "The cornea is stiffer on one side, or stiffer outside than inside.",
        (
            two_sided(
                "through_depth",
                NUMBER,
                1.5,
                "ln of posterior over anterior stiffness",
                reading=ratio("times as stiff inside as outside"),
            ),
            two_sided(
                "side_to_side",
                NUMBER,
                1.5,
                "ln of right over left stiffness",
                reading=ratio("times as stiff on the right as on the left"),
            ),
        ),
        (0.4, 0.4),
        _of_candidate(_graded),
        searched_as=("depth_gradient", "side_gradient"),
    ),
    _effect(
        "thickness_error",
        "observation",
        "The cornea is thicker or thinner than it appears in both images.",
        (two_sided("thickness_difference", MM, 0.1, "thickness in excess of the apparent one"),),
        (0.02,),
        _of_candidate(lambda c, v: thickened(c, v["thickness_difference"])),
    ),
    _effect(
        "posterior_distortion",
        "observation",
        "The inner surface of the deformed cornea appears displaced, because the camera looks "
        "through the outer one.",
        (
            two_sided("posterior_shift", MM, 0.2, "excess of the apparent thickness when deformed"),
            two_sided(
                "posterior_bow",
                MM,
                0.2,
                "excess of the apparent thickness in the middle, none at the edges",
            ),
        ),
        (0.03, 0.05),
        unchanged_problem,
        _posterior,
        reference="Li et al., J. Biomed. Opt. 20 (2015) 056006",
    ),
    _effect(
        "segmentation_bias",
        "observation",
        "Both surfaces of the deformed cornea are segmented too far outside or inside.",
        (two_sided("segmentation_offset", MM, 0.1, "outward offset of the segmentation"),),
        (0.01,),
        unchanged_problem,
        _both_surfaces,
    ),
    _effect(
        "plane_strain",
        "global material",
        "The cornea is held along the third direction, perpendicular to the section.",
        (
            from_zero(
                "plane_strain_share",
                NUMBER,
                1.0,
                "fraction of the way to plane strain",
                reading=percent("% of the way to plane strain"),
            ),
        ),
        (0.5,),
        _share("kind", "plane strain", "plane_strain_share"),
        step=0.02,
    ),
    _effect(
        "carried_prestress",
        "global material",
        "The cornea in the first image is stiffened by its prestretch.",
        (
            from_zero(
                "carried_share",
                NUMBER,
                1.0,
                "fraction of the way to a carried prestretch",
                reading=percent("% of the way to a carried prestretch"),
            ),
        ),
        (0.5,),
        _share("prestress", "mulf", "carried_share"),
        step=0.02,
        reference="M. W. Gee et al., Int. J. Numer. Meth. Biomed. Engng 26 (2010) 52",
    ),
)

NOT_SIMULATED = (
    ("fibres", "the law of the thesis is isotropic"),
    ("viscosity", "one image under the jet does not show how fast the cornea yields"),
)

CATALOGUE = Catalogue((*CORNEA_EFFECTS, *plugged_effects("cornea")), NOT_SIMULATED)
