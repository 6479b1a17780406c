"""Compressed phantoms on homogeneous and adaptive meshes (thesis section 4.4, Table 4.3)."""

import time
from dataclasses import dataclass
from itertools import zip_longest
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Triple, Volume
from palpate.workers.body.mesh.hierarchy import Hierarchy
from palpate.workers.body.phantom.breast import Phantom
from palpate.workers.comparison.coefficients.coefficients import coefficients
from palpate.workers.comparison.mammogram.geometry import CC_AXIS, mlo_axis
from palpate.workers.comparison.warp.warp_volume import warp_labels
from palpate.workers.mechanics.fem.elements.model import prepare
from palpate.workers.mechanics.fem.equilibrium.solve import solve
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Constants, Problem
from palpate.workers.mechanics.fem.problem.loads import Device, DistanceControl, Hold
from palpate.workers.mechanics.fem.problem.outcome import Outcome
from palpate.workers.mechanics.fem.problem.regions import Ball
from palpate.workers.mechanics.materials.mooney_rivlin import MooneyRivlin

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
    at = np.argwhere(labels.values != Tissue.AIR)[:, ::-1]
    spacing = np.asarray(labels.spacing_mm)
    places = np.asarray(labels.origin_mm) + at * spacing
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
        found = coefficients(a, b)
        apart = float(np.linalg.norm(_centroid(a) - _centroid(b)))
        rows.append((apart, abs(found.volume_difference_mm3), found.jc, found.mhd_mm))
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
