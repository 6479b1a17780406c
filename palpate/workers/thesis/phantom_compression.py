"""The ten phantoms of the thesis: their scales, how they are pressed, and what is searched on them.

The phantoms are of thesis sections 4.4 and 4.5. They are compressed on homogeneous and adaptive
meshes (Table 4.3), and one of them is imaged on both (Fig. 4.18).

The searches of section 4.5 have bodies, targets and bounds: the thesis assigns target X1 to
phantoms 1 to 5 and X2 to phantoms 6 to 10, both without skin, and X3, with skin, to phantoms 1 to 5
again.
"""

import time
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Triple, Volume
from palpate.workers.body.mesh.mesh_hierarchy import Hierarchy
from palpate.workers.body.phantom.phantom_generation import Phantom, generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.comparison.mammogram_image import (
    Mammogram,
    Noise,
    difference_picture,
    expose,
    grey_picture,
)
from palpate.workers.comparison.similarity_coefficients import coefficients
from palpate.workers.comparison.warp_volume import warp_labels
from palpate.workers.comparison.xray_beam import (
    CC_AXIS,
    Beam,
    Unit,
    geometry_of,
    mlo_axis,
    spectrum_of,
)
from palpate.workers.mechanics.fem.body_equilibrium import solve
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Outcome, Problem
from palpate.workers.mechanics.fem.discretisation import prepare
from palpate.workers.mechanics.fem.loads_and_regions import Ball, Device, DistanceControl, Hold
from palpate.workers.mechanics.materials.polynomial_laws import MooneyRivlin

# A sketch takes a minute and shows what the results look like; its numbers mean little.
Scale = Literal["sketch", "reduced", "full"]
SCALES: tuple[Scale, ...] = ("sketch", "reduced", "full")


def check_scale(scale: str) -> None:
    """Refuse an unknown scale.

    Raises
    ------
    InputError
        If `scale` is not in `SCALES`.
    """
    if scale not in SCALES:
        raise InputError(f"scale must be 'sketch', 'reduced' or 'full', got {scale!r}.")


PHANTOM_COUNT = 10
SPARSEST, DENSEST = 0.07, 0.35
# The thesis gives 250 ml and 170 x 100 x 50 mm, but a body of that size has 445 ml; this one has
# 250 ml, and voxels of 0.2 mm.
FULL = BreastPhantom.preset("250ml", spacing_mm=0.2)
# An eighth of that volume, with compartments, ligaments and skin of the same size.
REDUCED = BreastPhantom(
    lower_mm=18.75,
    upper_mm=66.25,
    half_width_mm=18.75,
    depth_mm=18.75,
    compartments=42,
    spacing_mm=0.3,
)

# The same body in coarse voxels.
SKETCH = replace(REDUCED, spacing_mm=1.0)
SETTINGS: dict[Scale, BreastPhantom] = {"sketch": SKETCH, "reduced": REDUCED, "full": FULL}
# Phantoms used by an experiment: a sketch uses one of the first five and one of the others.
NUMBERS: dict[Scale, tuple[int, ...]] = {
    "sketch": (3, 8),
    "reduced": tuple(range(1, PHANTOM_COUNT + 1)),
    "full": tuple(range(1, PHANTOM_COUNT + 1)),
}


def density_of(number: int) -> float:
    """Return the glandular fraction of phantom `number`, 1 to 10, evenly spaced from 7 to 35 %."""
    if not 1 <= number <= PHANTOM_COUNT:
        raise InputError(f"The number of a phantom must be 1 to {PHANTOM_COUNT}, got {number}.")
    return float(np.linspace(SPARSEST, DENSEST, PHANTOM_COUNT)[number - 1])


def thesis_phantom(number: int, scale: Scale = "reduced") -> Phantom:
    """Return phantom `number`; all have the same outline, but different compartments.

    Parameters
    ----------
    number : int
        1 to 10, from the sparsest to the densest.
    scale : {"sketch", "reduced", "full"}

    Raises
    ------
    InputError
        If the number or the scale is unknown.
    """
    check_scale(scale)
    return generate_breast(replace(SETTINGS[scale], glandular_fraction=density_of(number)), number)


def two_materials(labels: Volume) -> Volume:
    """Return labels of gland and fat; skin and ligaments count as fat (thesis section 4.4.1)."""
    values = np.where(labels.values == Tissue.AIR, Tissue.AIR, Tissue.FAT).astype(np.uint8)
    values[labels.values == Tissue.GLANDULAR] = Tissue.GLANDULAR
    return replace(labels, values=values)


TargetName = Literal["X1", "X2", "X3"]
TARGETS: dict[TargetName, dict[str, float]] = {
    "X1": {
        "E_fat_kpa": 10.0, "eta_fat_kpa": 100.0,
        "E_glandular_kpa": 40.0, "eta_glandular_kpa": 150.0,
    },
    "X2": {
        "E_fat_kpa": 7.5, "eta_fat_kpa": 75.0,
        "E_glandular_kpa": 30.0, "eta_glandular_kpa": 112.5,
    },
    "X3": {
        "E_fat_kpa": 10.0, "eta_fat_kpa": 100.0,
        "E_glandular_kpa": 40.0, "eta_glandular_kpa": 150.0, "E_skin_kpa": 1600.0,
    },
}  # fmt: skip
BOUNDS: dict[str, tuple[float, float]] = {
    "E_fat_kpa": (5.0, 20.0),
    "eta_fat_kpa": (50.0, 200.0),
    "E_glandular_kpa": (5.0, 80.0),
    "eta_glandular_kpa": (50.0, 200.0),
    "E_skin_kpa": (200.0, 3000.0),
}
SEARCH_PHANTOMS: dict[TargetName, range] = {
    "X1": range(1, 6),
    "X2": range(6, 11),
    "X3": range(1, 6),
}
SEARCH_NODES: dict[Scale, int] = {"sketch": 1_200, "reduced": 5_000, "full": 90_000}
SEARCH_SPACING_MM: dict[Scale, float] = {"sketch": 1.0, "reduced": 0.5, "full": 0.2}
# The reduced body is half as long in every direction; this force gives the same pressure.
SEARCH_FORCE_N: dict[Scale, float] = {"sketch": 25.0, "reduced": 25.0, "full": 100.0}


def runs_at(scale: Scale) -> list[tuple[TargetName, int]]:
    """Return the target and phantom of every search at a scale."""
    check_scale(scale)
    return [
        (name, number)
        for name, numbers in SEARCH_PHANTOMS.items()
        for number in numbers
        if number in NUMBERS[scale]
    ]


def case_of(target: TargetName, number: int, scale: Scale) -> dict[str, Any]:
    """Return the case of a study, in the format of `workers.common_keys`.

    Raises
    ------
    InputError
        If target, number or scale is unknown.
    """
    check_scale(scale)
    if target not in get_args(TargetName):
        raise InputError(f"The target must be one of {', '.join(TARGETS)}; got {target!r}.")
    body = FULL if scale == "full" else REDUCED
    phantom = asdict(body) | {
        "preset": "250ml",
        "seed": number,
        "spacing_mm": SEARCH_SPACING_MM[scale],
        "glandular_fraction": density_of(number),
    }
    return {
        "organ": "breast",
        "reference": {"phantom": phantom},
        "mesh": {"nodes": SEARCH_NODES[scale]},
        "model": {"skin": "membrane" if target == "X3" else "none"},
        "load": {"force_n": SEARCH_FORCE_N[scale], "fixed_plate_holds_x": True},
        "constants": {"nu": 0.49},
    }


def bounds_of(target: TargetName) -> dict[str, tuple[float, float]]:
    """Return the search bounds of the constants for a target."""
    return {name: BOUNDS[name] for name in TARGETS[target]}


View = Literal["CC", "MLO"]
LawName = Literal["neo-Hookean", "Mooney-Rivlin"]
AXES: dict[View, Triple] = {"CC": CC_AXIS, "MLO": mlo_axis(45.0)}
# Reduction of the thickness by the plates, as a fraction.
REDUCTION: dict[View, float] = {"CC": 0.50, "MLO": 0.25}
# Thesis Table 4.1, after Gefen and Dilmoney (2007). It omits the Mooney-Rivlin constants of Tanner
# et al. (2006); here they have the same shear moduli, two thirds of them in c10.
SHEAR_MPA = {Tissue.FAT: 0.01275, Tissue.GLANDULAR: 0.03675}
POISSON, C10_SHARE = 0.49, 2 / 3
# Nodes initially in contact with the fixed plate are held; a round body has few of them.
TOUCHING_MM = 2.0


@dataclass(frozen=True, eq=False)
class Compressed:
    """A phantom after its compression on one mesh.

    Parameters
    ----------
    compartments : Volume or None
        Ids of the glandular compartments, 0 elsewhere; None if the solver did not converge.
    labels : Volume or None
        All tissues, for a mammogram.
    outcome : Outcome
    seconds_per_1000 : float
        Processor time of the solver per 1000 tetrahedra (thesis Fig. 4.16).
    """

    compartments: Volume | None
    labels: Volume | None
    outcome: Outcome
    seconds_per_1000: float


@dataclass(frozen=True)
class CompressionRow:
    """Comparison of a homogeneous and an adaptive mesh: compartment means (Table 4.3).

    Parameters
    ----------
    phantom : int
    view : {"CC", "MLO"}
    law : {"neo-Hookean", "Mooney-Rivlin"}
    adaptive, homogeneous : Outcome
    compartments : int
        Number of compartments with voxels on both meshes.
    lost : int
        Number of compartments with voxels on one mesh only; excluded from all means.
    centroid_mm, volume_mm3 : float
        Distance between the centroids; magnitude of the difference in volume.
    jc, mhd_mm : float
    whole_jc, whole_mhd_mm : float
        Scores of all glandular compartments as one set.
    adaptive_s_per_1000, homogeneous_s_per_1000 : float
        Processor seconds of the solver per 1000 tetrahedra.
    """

    phantom: int
    view: View
    law: LawName
    adaptive: Outcome
    homogeneous: Outcome
    compartments: int
    lost: int
    centroid_mm: float
    volume_mm3: float
    jc: float
    mhd_mm: float
    whole_jc: float
    whole_mhd_mm: float
    adaptive_s_per_1000: float
    homogeneous_s_per_1000: float


def constants_of(law: LawName) -> dict[Tissue, Constants]:
    """Return the constants of fat and gland (thesis Table 4.1).

    Raises
    ------
    InputError
        If the law is unknown.
    """
    if law not in get_args(LawName):
        raise InputError(f"The law must be one of {', '.join(get_args(LawName))}; got {law!r}.")
    found = {}
    for tissue, mu in SHEAR_MPA.items():
        matrix = None
        if law == "Mooney-Rivlin":
            matrix = MooneyRivlin(mu / 2 * C10_SHARE, mu / 2 * (1 - C10_SHARE))
        found[tissue] = Constants(2 * mu * (1 + POISSON), POISSON, law=matrix)
    return found


def compression_problem(labels: Volume, view: View, law: LawName) -> Problem:
    """Return the problem of two frictionless plates, of which the upper one moves.

    The chest wall slides in its plane, and the nodes initially in contact with the fixed plate are
    held in all directions. They are selected by voxel, so that two meshes are held in the same
    place. With this literal reading of the thesis, a body in an oblique view can rotate between the
    plates until both press it.

    Parameters
    ----------
    labels : Volume
        The undeformed body.
    view, law : str

    Raises
    ------
    InputError
        If the view or the law is unknown.
    """
    if view not in AXES:
        raise InputError(f"The view must be one of {', '.join(AXES)}; got {view!r}.")
    axis = np.asarray(AXES[view])
    voxels = np.argwhere(labels.values != Tissue.AIR)[:, ::-1]
    spacing = np.asarray(labels.spacing_mm)
    places = np.asarray(labels.origin_mm) + voxels * spacing
    height = places @ axis
    half = float(np.abs(axis) @ spacing) / 2
    low, high = float(height.min()) - half, float(height.max()) + half
    x, y, z = (float(v) for v in places[height <= height.min() + half].mean(axis=0))
    plates = DistanceControl(low, high - REDUCTION[view] * (high - low), Device(axis=AXES[view]))
    hold = Hold(Ball((x, y, z), TOUCHING_MM))
    return Problem(constants=constants_of(law), load=plates, holds=(hold,))


def compress(phantom: Phantom, hierarchy: Hierarchy, view: View, law: LawName) -> Compressed:
    """Compress a phantom on a mesh and deform its voxels."""
    mesh = hierarchy.finest.mesh
    model = prepare(hierarchy)
    problem = compression_problem(phantom.labels, view, law)
    started = time.process_time()
    solution = solve(model, problem)
    seconds = (time.process_time() - started) / (len(mesh.tets) / 1000)
    if not solution.outcome.converged:
        return Compressed(None, None, solution.outcome, seconds)
    ids, labels = phantom.compartments, phantom.labels
    gland = np.where(labels.values == Tissue.GLANDULAR, ids.values, 0).astype(np.uint16)
    glandular = Volume(gland, ids.spacing_mm, ids.origin_mm)
    moved = [warp_labels(v, mesh, solution.displacement_mm, ids) for v in (glandular, labels)]
    return Compressed(moved[0], moved[1], solution.outcome, seconds)


def compared(
    number: int, view: View, law: LawName, adaptive: Compressed, homogeneous: Compressed
) -> CompressionRow:
    """Return the comparison of two compressions of one phantom; nan if one did not converge."""
    common, lost, means, whole = 0, 0, np.full(4, np.nan), (np.nan, np.nan)
    if adaptive.compartments is not None and homogeneous.compartments is not None:
        each, lost = _each_compartment(homogeneous.compartments, adaptive.compartments)
        common, means = len(each), each.mean(axis=0)
        both = coefficients(_as_set(homogeneous.compartments), _as_set(adaptive.compartments))
        whole = both.jc, both.mhd_mm
    centroid, volume, jc, mhd = (float(v) for v in means)
    return CompressionRow(
        number, view, law, adaptive.outcome, homogeneous.outcome, common, lost,
        centroid, volume, jc, mhd, *whole,
        adaptive.seconds_per_1000, homogeneous.seconds_per_1000,
    )  # fmt: skip


def _as_set(ids: Volume) -> Volume:
    values = np.where(ids.values > 0, Tissue.GLANDULAR, Tissue.AIR).astype(np.uint8)
    return Volume(values, ids.spacing_mm, ids.origin_mm)


def _each_compartment(first: Volume, second: Volume) -> tuple[FloatArray, int]:
    """Return centroid distance, volume difference, JC and MHD per compartment, shape (k, 4).

    Also return the number of compartments with voxels in one volume only.
    """
    in_first, in_second = (ndimage.find_objects(v.values) for v in (first, second))
    rows, lost = [], 0
    for number, boxes in enumerate(zip_longest(in_first, in_second), start=1):
        if boxes[0] is None and boxes[1] is None:
            continue
        if boxes[0] is None or boxes[1] is None:
            lost += 1
            continue
        a, b = _part(first, boxes[0], number), _part(second, boxes[1], number)
        similarity = coefficients(a, b)
        apart = float(np.linalg.norm(_centroid(a) - _centroid(b)))
        rows.append(
            (apart, abs(similarity.volume_difference_mm3), similarity.jc, similarity.mhd_mm)
        )
    return np.array(rows).reshape(-1, 4), lost


def _part(ids: Volume, box: tuple[slice, ...], number: int) -> Volume:
    values = np.where(ids.values[box] == number, Tissue.GLANDULAR, Tissue.AIR).astype(np.uint8)
    start = np.array([s.start for s in reversed(box)])
    x, y, z = (np.asarray(ids.origin_mm) + start * np.asarray(ids.spacing_mm)).tolist()
    return Volume(values, ids.spacing_mm, (x, y, z))


def _centroid(part: Volume) -> NDArray[np.float64]:
    """Return the mean position of the voxels."""
    at = np.argwhere(part.values)[:, ::-1].mean(axis=0)
    return np.asarray(np.asarray(part.origin_mm) + at * np.asarray(part.spacing_mm))


PIXEL_MM: dict[Scale, float] = {"sketch": 0.8, "reduced": 0.3, "full": 0.2}


@dataclass(frozen=True, eq=False)
class MammogramPair:
    """Mammograms of a phantom on its adaptive and homogeneous meshes, from the same unit.

    Parameters
    ----------
    adaptive, homogeneous : Mammogram
        Mammograms with different noise of equal strength.
    adaptive_picture, homogeneous_picture, difference : ndarray of uint8
        Mammograms, bright where tissue is dense, and their difference, grey where both agree.
    attenuation_rms : float
        Root mean square of the difference in ln(open / energy) behind the body.
    quantum_rms : float
        Contribution of noise alone to `attenuation_rms`.
    """

    adaptive: Mammogram
    homogeneous: Mammogram
    adaptive_picture: NDArray[np.uint8]
    homogeneous_picture: NDArray[np.uint8]
    difference: NDArray[np.uint8]
    attenuation_rms: float
    quantum_rms: float


def mammogram_pair(
    adaptive: Compressed,
    homogeneous: Compressed,
    view: View,
    pixel_mm: float,
    *,
    beam: Beam = "w_rh",
    seed: int = 0,
) -> MammogramPair:
    """Take mammograms of two compressions in the geometry of the first.

    Raises
    ------
    InputError
        If one of the compressions did not converge.
    """
    first, second = adaptive.labels, homogeneous.labels
    if first is None or second is None:
        reasons = [c.outcome.reason for c in (adaptive, homogeneous) if c.labels is None]
        raise InputError(f"A mammogram needs a converged compression: {'; '.join(reasons)}.")
    geometry = geometry_of(first, AXES[view], Unit(pixel_mm=pixel_mm))
    spectrum = spectrum_of(beam)
    clean = [expose(body, geometry, spectrum) for body in (first, second)]
    noisy = [
        expose(body, geometry, spectrum, noise=Noise(seed + k))
        for k, body in enumerate((first, second))
    ]
    behind = clean[0].log_attenuation > 0.05

    def rms(a: Mammogram, b: Mammogram) -> float:
        apart = (a.log_attenuation - b.log_attenuation)[behind]
        return float(np.sqrt(np.mean(apart**2)))

    return MammogramPair(
        adaptive=noisy[0],
        homogeneous=noisy[1],
        adaptive_picture=grey_picture(noisy[0]),
        homogeneous_picture=grey_picture(noisy[1]),
        difference=difference_picture(noisy[0], noisy[1]),
        attenuation_rms=rms(noisy[0], noisy[1]),
        quantum_rms=float(np.hypot(rms(noisy[0], clean[0]), rms(noisy[1], clean[1]))),
    )
