r"""Comparison of two sections: the score of a study, and signed distances for a fit.

The score is the similarity of two sections inside a window, as named numbers. Areas of two polygons
and of their intersection are exact, so nothing is rasterised.

For a fit, the nodes on both surfaces, displaced by the model, are compared with the same surface of
the target. A node represents a length :math:`\ell` of contour; for errors of the image with
standard deviation :math:`\sigma`, correlated over a length c, its distance d has the weight
:math:`\ell / (c\,\sigma^2)`. So J'J is the information in `cornea.identifiability`, independent of
the mesh.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, FreeParameter, IntArray
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.comparison.similarity_score import gsf
from palpate.workers.organs.cornea.cornea_keys import CorneaScore
from palpate.workers.organs.cornea.cornea_problem import Candidate
from palpate.workers.organs.cornea.identifiability import ContourNoise, pixel_rounding
from palpate.workers.organs.cornea.prestressed_equilibrium import (
    DERIVATIVE_STEP,
    CandidateChange,
    CorneaOutcome,
    equilibrium,
    sensitivity,
)
from palpate.workers.organs.cornea.section_measures import contour_samples, mean_distance
from palpate.workers.organs.cornea.section_mesh import T6Mesh
from palpate.workers.organs.cornea.section_outline import Section, arclength_mm, cropped_section
from palpate.workers.organs.normal_equations import normal_equations
from palpate.workers.organs.organ_protocol import Residuals, either_side


def overlap_areas(a: FloatArray, b: FloatArray) -> tuple[float, float, float]:
    """Return the areas of two polygons and of their intersection, exact except for rounding.

    Parameters
    ----------
    a, b : ndarray, shape (n, 2) and (m, 2)
        Vertices in order, closed by the side from the last to the first. Where a polygon folds
        over itself, the even-odd rule defines its interior.

    Returns
    -------
    area_a, area_b, area_of_both : float
    """
    first, second = (shapely.make_valid(shapely.Polygon(corners)) for corners in (a, b))
    area_a, area_b = float(first.area), float(second.area)
    # From what they do not share, so that equal polygons share their area to the last digit.
    apart = float(shapely.symmetric_difference(first, second).area)
    return area_a, area_b, (area_a + area_b - apart) / 2


# Spacing of samples along the contours, in pixels; a mean distance of 5 pixels changes by less
# than 0.001 pixels from here to a tenth of this spacing.
SPACING_PIXELS = 5.0


@dataclass(frozen=True)
class SectionScore:
    """Similarity of two sections.

    Parameters
    ----------
    jc : float
        Jaccard coefficient of the areas, 0 to 1.
    mhd_um : float
        Modified Hausdorff distance from contour to contour.
    gsf : float
        Geometric similarity function ln((1 - JC) MHD) with MHD in pixels; -inf for
        identical sections.
    """

    jc: float
    mhd_um: float
    gsf: float


class SectionTarget:
    r"""A section for comparison with candidates, without rasterisation.

    Areas are exact (`overlap_areas`). The modified Hausdorff distance (D22 of the thesis,
    Eq. 3.25 and 3.26) is between boundaries, as the thesis' tables prove,

    .. math:: \max\Big(\frac{1}{|\partial X|}\int_{\partial X} d(x, \partial Y),
                       \frac{1}{|\partial Y|}\int_{\partial Y} d(y, \partial X)\Big)

    with exact distances to the sides of the other contour. By default a piece of a contour is
    weighted by its number of boundary pixels (the larger of its extents along x and y), so the
    result equals that of images without rounding; ``pixelwise=False`` weights it by its length.

    Parameters
    ----------
    section : Section
    pixel_um : float
        Pixels of the thesis' images, 2 um; > 0. Sets only the unit of the distance in the
        GSF and the spacing of the samples.
    pixelwise : bool

    Raises
    ------
    InputError
        If `pixel_um` is not positive or the section has no area.
    """

    def __init__(self, section: Section, pixel_um: float = 2.0, pixelwise: bool = True) -> None:
        if not (np.isfinite(pixel_um) and pixel_um > 0):
            raise InputError(f"A pixel must have a positive size, got {pixel_um} um.")
        self._outline = np.ascontiguousarray(section.outline_mm)
        if overlap_areas(self._outline, self._outline)[0] <= 0:
            raise InputError("The target section has no area. Check its contours.")
        self._pixel_um = pixel_um
        self._pixelwise = pixelwise
        self._samples = contour_samples(self._outline, self._spacing_mm, pixelwise)

    @property
    def _spacing_mm(self) -> float:
        return SPACING_PIXELS * self._pixel_um / 1000

    def score(self, candidate: Section) -> SectionScore:
        """Return the similarity of a candidate.

        Parameters
        ----------
        candidate : Section

        Returns
        -------
        SectionScore
        """
        outline: FloatArray = np.ascontiguousarray(candidate.outline_mm)
        area, target_area, shared = overlap_areas(outline, self._outline)
        union = area + target_area - shared
        # Rounding may leave a difference in the last digit between areas of identical sections.
        jc = float(np.clip(shared / union, 0.0, 1.0))
        samples = contour_samples(outline, self._spacing_mm, self._pixelwise)
        mhd_mm = max(mean_distance(samples, self._outline), mean_distance(self._samples, outline))
        mhd_um = 1000 * mhd_mm
        return SectionScore(jc=jc, mhd_um=mhd_um, gsf=gsf(jc, mhd_um / self._pixel_um))


# Score of a candidate so folded that no part of it is in the window.
NOTHING_SHARED = SectionScore(jc=0.0, mhd_um=math.inf, gsf=math.inf)


@dataclass(frozen=True)
class NamedScore:
    """A score with the pixel size of its GSF.

    Parameters
    ----------
    score : SectionScore
    pixel_um : float
    """

    score: SectionScore
    pixel_um: float

    def as_dict(self) -> dict[str, float]:
        """See `workers.organs.organ_protocol.Score`."""
        jc, mhd_um = self.score.jc, self.score.mhd_um
        return {
            "jc": jc,
            "dice": 2 * jc / (1 + jc),
            "mhd_mm": mhd_um / 1000,
            "mhd_voxels": mhd_um / self.pixel_um,
            "gsf": self.score.gsf,
        }


class SectionScorer:
    """Comparison of sections with one target.

    Parameters
    ----------
    target : Section
    spec : CorneaScore

    Raises
    ------
    InputError
        If the target has no area, or none inside the window.
    """

    def __init__(self, target: Section, spec: CorneaScore) -> None:
        self._spec = spec
        self._target = SectionTarget(self._in_window(target), pixel_um=spec.pixel_um)

    def score(self, body: Section, /) -> NamedScore:
        """Compare a section with the target."""
        try:
            score = self._target.score(self._in_window(body))
        except InputError:
            score = NOTHING_SHARED
        return NamedScore(score, self._spec.pixel_um)

    def _in_window(self, section: Section) -> Section:
        window = self._spec.window_mm
        return section if window is None else cropped_section(section, *window)


ANTERIOR, POSTERIOR = 0, 1


@dataclass(frozen=True, eq=False)
class SurfaceResidual:
    """Signed distances of points from the two surfaces of a section; see `Scan.compare`.

    Parameters
    ----------
    observed : Section
    """

    observed: Section

    def __call__(
        self, points: FloatArray, reference: InterfacePoints
    ) -> tuple[FloatArray, FloatArray]:
        """Return distances, (k,) in mm, positive outside, and outward normals."""
        residual, normals = np.empty(len(points)), np.zeros((len(points), 3))
        lines = {ANTERIOR: self.observed.anterior_mm, POSTERIOR: self.observed.posterior_mm}
        for number, line in lines.items():
            own = reference.interface == number
            outward = 1.0 if number == ANTERIOR else -1.0
            above, normal = signed_distances(points[own, :2], line)
            residual[own] = outward * above
            normals[own, :2] = outward * normal
        return residual, normals


def signed_distances(points: FloatArray, line: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the heights of points above a polyline, and upward normals at their feet.

    Parameters
    ----------
    points, line : ndarray, shape (k, 2) and (n, 2)
        The polyline from left to right.
    """
    start, along = line[:-1], np.diff(line, axis=0)
    arm = points[:, None] - start
    part = np.clip((arm * along).sum(-1) / (along**2).sum(-1), 0, 1)
    nearest = np.linalg.norm(arm - part[..., None] * along, axis=-1).argmin(axis=1)
    # Vertex normals are averaged from their neighbours, which makes the distance smooth.
    tangent = np.gradient(line, axis=0)
    share = part[np.arange(len(points)), nearest][:, None]
    blended = (1 - share) * tangent[nearest] + share * tangent[nearest + 1]
    normal = np.stack([-blended[:, 1], blended[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    foot = line[nearest] + share * along[nearest]
    return ((points - foot) * normal).sum(axis=1), normal


# Accuracy of the score of a study for a simulated section.
SIMULATED = pixel_rounding(2.0)
# Error of a surface segmented in a frame; see `workers.organs.cornea.tonometer_frames`.
SEGMENTED = ContourNoise("10 µm, correlated over 0.5 mm", 10.0, 0.5)
# Closer to an end of an imaged surface, a displaced node may have no point next to it.
END_MARGIN_MM = 0.3
# Non-negative parameters at zero are differentiated over this fraction of their interval.
ONE_SIDED = 1e-4

CandidateOf = Callable[[Mapping[str, float]], Candidate]


@dataclass(frozen=True, eq=False)
class SurfaceObservation:
    """Inputs of the residuals from mesh and target.

    Parameters
    ----------
    nodes : ndarray, shape (k,)
        Nodes of both surfaces.
    points : InterfacePoints
        The same nodes in the image of the undeformed cornea.
    compare : SurfaceResidual
    weight : ndarray, shape (k,)
        Factor of a distance in mm; see the module docstring.
    noise : str
        The noise as text.
    """

    nodes: IntArray
    points: InterfacePoints
    compare: SurfaceResidual
    weight: FloatArray
    noise: str


@dataclass(frozen=True, eq=False)
class FittedCornea:
    """See `workers.organs.organ_protocol.Fitted`."""

    solution: CorneaOutcome
    residuals: Residuals | None


def observe_surfaces(mesh: T6Mesh, target: Section, imaged: bool) -> SurfaceObservation:
    """Select the nodes that the target shows, and compute their weights.

    Parameters
    ----------
    mesh : T6Mesh
        Mesh of the undeformed section.
    target : Section
    imaged : bool
        Whether the target is an image; else it was simulated.
    """
    noise = SEGMENTED if imaged else SIMULATED
    surfaces = (
        (ANTERIOR, mesh.anterior, target.anterior_mm),
        (POSTERIOR, mesh.posterior, target.posterior_mm),
    )
    nodes, lengths, interfaces = [], [], []
    for number, surface, line in surfaces:
        x = mesh.nodes_mm[surface, 0]
        low, high = line[0, 0] + END_MARGIN_MM, line[-1, 0] - END_MARGIN_MM
        shown = (x > low) & (x < high)
        nodes.append(surface[shown])
        lengths.append(np.gradient(arclength_mm(mesh.nodes_mm[surface]))[shown])
        interfaces.append(np.full(int(shown.sum()), number, np.int32))
    chosen, length = np.concatenate(nodes), np.concatenate(lengths)
    own = np.concatenate(interfaces)
    places = np.pad(mesh.nodes_mm[chosen], ((0, 0), (0, 1)))
    return SurfaceObservation(
        nodes=chosen,
        points=InterfacePoints(places, np.zeros_like(places), own, length, own),
        compare=SurfaceResidual(target),
        weight=1e3 / noise.sd_um * np.sqrt(length / noise.correlation_mm),
        noise=noise.name,
    )


def fit_surfaces(
    candidate_at: CandidateOf,
    constants: Mapping[str, float],
    free: Sequence[FreeParameter],
    observation: SurfaceObservation,
) -> FittedCornea:
    """Deform a cornea and differentiate its residuals; see `Organ.fit`.

    Parameters
    ----------
    candidate_at : callable
        Maps all parameters, in internal names and units, to a candidate.
    constants : mapping of str to float
        All parameters.
    free : sequence of FreeParameter
    observation : SurfaceObservation

    Raises
    ------
    InputError
        If constants or load are inconsistent.
    """
    candidate = candidate_at(constants)
    solved = equilibrium(candidate.prepared, candidate.constants, candidate.load)
    outcome = CorneaOutcome(solved.solution)
    if not outcome.converged:
        return FittedCornea(outcome, None)
    derivatives = np.empty((len(free), *outcome.displacement_mm.shape))
    changes: dict[int, CandidateChange] = {}
    for i, p in enumerate(free):
        name, value = p["name"], constants[p["name"]]
        ahead, behind, apart = either_side(p, value, DERIVATIVE_STEP)
        if behind is None:
            step = ONE_SIDED * p["upper"]
            farther = candidate_at({**constants, name: value + step})
            derivatives[i] = _by_solving(farther, outcome.displacement_mm, step)
        else:
            plus, minus = (candidate_at({**constants, name: side}) for side in (ahead, behind))
            changes[i] = CandidateChange(plus, minus, apart / 2)
    smooth = sensitivity(candidate, [*changes.values()], solved)
    derivatives[[*changes]] = smooth.derivatives
    moved = observation.points.points[:, :2] + outcome.displacement_mm[observation.nodes]
    distances, normals = observation.compare(moved, observation.points)
    shifts = np.einsum("kni,ni->nk", derivatives[:, observation.nodes], normals[:, :2])
    weight = observation.weight
    none_in_common = np.zeros((len(distances), 0))
    equations = normal_equations(
        weight * distances, weight[:, None] * shifts, none_in_common, robust=False
    )
    return FittedCornea(outcome, Residuals(distances, equations, observation.noise))


def _by_solving(ahead: Candidate, displacement_mm: FloatArray, step: float) -> FloatArray:
    """Return a forward difference with respect to a parameter at zero; zero if it fails."""
    solution = equilibrium(ahead.prepared, ahead.constants, ahead.load).solution
    if not solution.converged:
        return np.zeros_like(displacement_mm)
    return (solution.displacement_mm - displacement_mm) / step
