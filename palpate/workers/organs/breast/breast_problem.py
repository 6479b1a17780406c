"""Forward problem of a breast: its materials, their constants, and compression by two plates.

Ligaments behave as fat (thesis section 4.5); so does muscle, unless its own constants are given,
and it always uses the law of fat. Skin is fat (``none``), fat under a membrane (``membrane``), or a
separate tissue in the mesh (``layer``). Fibres run from chest wall to nipple, along z.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Triple, Volume
from palpate.workers.body.mesh.body_outline import skin_thickness_mm
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Frame, Membrane, Problem
from palpate.workers.mechanics.fem.loads_and_regions import (
    Box,
    Device,
    DistanceControl,
    ForceControl,
    Hold,
    Load,
    Pressed,
)
from palpate.workers.mechanics.model_parameters import BREAST
from palpate.workers.organs.breast.breast_effects import BREAST_MODEL, CATALOGUE
from palpate.workers.organs.breast.breast_keys import LoadSpec, ModelSpec

Extent = tuple[float, float]
"""Start and end along the axis of compression, in mm."""

UNIT_FRAME = Frame()
# The body touches a plate where it is no further away, so that a round body touches in an area
# and not in one node.
TOUCHING_MM = 0.5
_EFFECT_NAMES = tuple(name for name in BREAST_MODEL.names if name not in BREAST)


def materials_of(labels: Volume, model: ModelSpec) -> Volume:
    """Return labels for meshing, in which tissues of the same material are merged.

    An element takes the tissue of most of its five points. Fat, ligament and skin without a layer
    are one material; as three tissues they would lose votes that they win together.
    """
    alike = np.arange(256, dtype=np.uint8)
    alike[Tissue.LIGAMENT] = Tissue.FAT
    if model.skin != "layer":
        alike[Tissue.SKIN] = Tissue.FAT
    return replace(labels, values=alike[labels.values])


def problem_of(
    model: ModelSpec,
    load: LoadSpec,
    constants: Mapping[str, float],
    body: Extent,
    target: Extent | None = None,
    frame: Frame = UNIT_FRAME,
) -> Problem:
    """Return the problem for the solver.

    Parameters
    ----------
    model, load : ModelSpec and LoadSpec
    constants : mapping of str to float
        Every parameter of `model_parameters.BREAST`, in internal names and units, the
        shape constants of the laws, and the parameters of the model's effects.
    body : tuple of float
        Extent of the undeformed body along the axis of compression, in mm.
    target : tuple of float, optional
        Extent of an imaged target; see `plates_of`.
    frame : Frame
        Frame of the undeformed body.
    """

    def tissue(name: str, law_of: str) -> Constants:
        own = Constants(constants[f"E_{name}"], constants["nu"], constants[f"eta_{name}"])
        return model.law.applied(law_of, own, constants)

    fat = tissue("fat", "fat")
    skin = Constants(constants["E_skin"], constants["nu"])
    tissues = {
        Tissue.FAT: fat,
        Tissue.LIGAMENT: fat,
        Tissue.SKIN: skin if model.skin == "layer" else fat,
        Tissue.MUSCLE: tissue("muscle", "fat"),
        Tissue.GLANDULAR: tissue("glandular", "glandular"),
    }
    effects = {name: constants[name] for name in _EFFECT_NAMES if name in constants}
    membrane = Membrane(constants["E_skin"], model.skin_thickness_mm)
    problem = Problem(
        constants=tissues,
        load=plates_of(load, body, target, frame),
        membrane=membrane if model.skin == "membrane" else None,
        literal_fibre=model.fibres == "literal",
        isochoric_fibre=model.fibre_invariant == "isochoric",
        holds=(held_at_plate(frame),) if load.fixed_plate_holds_x else (),
    )
    return CATALOGUE.apply(problem, effects, frame)


def plates_of(
    load: LoadSpec, body: Extent, target: Extent | None = None, frame: Frame = UNIT_FRAME
) -> Load:
    """Return the load with the positions of the plates.

    Under a force the plates start at the ends of the undeformed body. At a distance they end
    centred on the imaged target, if there is one, because the device held it there, or else centred
    on the undeformed body.
    """
    device = Device(
        axis=compression_axis(load.oblique_deg),
        pivot_mm=frame.centre_mm,
        lower_share=0.5 if load.moving == "both" else 0.0,
    )
    if load.force_n is not None:
        return ForceControl(load.force_n, *body, device)
    distance = load.plate_distance_mm
    if distance is None:
        raise AssertionError("a load has a force or a distance")
    if distance.lower is not None and distance.upper is not None:
        return DistanceControl(distance.lower, distance.upper, device)
    if distance.final is None:
        raise AssertionError("plates need a final distance or two final positions")
    centre = sum(body if target is None else target) / 2
    return DistanceControl(centre - distance.final / 2, centre + distance.final / 2, device)


def held_at_plate(frame: Frame) -> Hold:
    """Return the hold along x of the nodes already in contact with the lower plate (4.5.4)."""
    lowest_mm = frame.centre_mm[1] - frame.half_mm[1]
    touching = Box((-np.inf,) * 3, (np.inf, lowest_mm + TOUCHING_MM, np.inf))
    return Hold(touching, axes=(True, False, False))


def compression_axis(oblique_deg: float) -> Triple:
    """Return the unit vector from the lower to the upper plate."""
    angle = np.radians(oblique_deg)
    return -float(np.sin(angle)), float(np.cos(angle)), 0.0


def pressed_by(load: LoadSpec) -> Pressed:
    """Return the direction and force of a compression."""
    return Pressed(compression_axis(load.oblique_deg), load.force_n)


def extent_of(volume: Volume, oblique_deg: float = 0.0) -> Extent:
    """Return the extent of the body along the axis of compression, in mm.

    Along y it ends at the outer faces of the outermost voxels, along an oblique axis at the ends of
    the voxels' projections.

    Raises
    ------
    InputError
        If the volume is all air.
    """
    y, x = np.nonzero((volume.values != Tissue.AIR).any(axis=0))
    if not len(y):
        raise InputError("The volume is all air: there is no body in it. Check its label map.")
    ax, ay, _ = compression_axis(oblique_deg)
    dx, dy, _ = volume.spacing_mm
    along = (volume.origin_mm[0] + x * dx) * ax + (volume.origin_mm[1] + y * dy) * ay
    half = (abs(ax) * dx + abs(ay) * dy) / 2
    return float(along.min() - half), float(along.max() + half)


def check_skin_layer(labels: Volume, element_size_mm: float) -> None:
    """Check that the elements can resolve a layer of skin.

    Raises
    ------
    InputError
        If the elements are larger than the skin is thick, or no voxel is skin.
    """
    thickness = skin_thickness_mm(labels)
    if not thickness:
        raise InputError(
            "skin: layer needs skin voxels, but the body has none. Label its skin, or use "
            "skin: membrane, which needs no voxels, or skin: none."
        )
    if element_size_mm > thickness:
        raise InputError(
            f"skin: layer needs elements no larger than the skin is thick: the skin is "
            f"{thickness:.2g} mm thick, the elements are {element_size_mm:.2g} mm. "
            f"Use skin: membrane with skin_thickness_mm: {thickness:.2g}, or "
            f"mesh: {{element_size_mm: {thickness:.2g}}}."
        )
