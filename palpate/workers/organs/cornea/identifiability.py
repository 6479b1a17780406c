r"""Identifiability of the constants from the image of a deformed cornea.

A small change in the constants displaces every point of the two surfaces along its normal by
:math:`\sum_k a_k(s)\,d\ln\theta_k`. For errors of a contour with standard deviation
:math:`\sigma` that are correlated over a length c, the information is

.. math:: F_{kl} = \frac{1}{c\,\sigma^2} \int a_k a_l\,ds

and its inverse is the Cramer-Rao bound of the relative errors. The information of several
pressures, imaged one after another, adds up.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.cornea_problem import Candidate, changed, scale_of
from palpate.workers.organs.cornea.corneal_model import CorneaConstants
from palpate.workers.organs.cornea.prestressed_equilibrium import Sensitivity, sensitivity
from palpate.workers.organs.cornea.section_outline import arclength_mm

# A direction of the constants that moves nothing has no bound; this keeps it finite.
SMALLEST_INFORMATION = 1e-12


@dataclass(frozen=True)
class ContourNoise:
    """Errors of a segmented contour along its normal.

    Parameters
    ----------
    name : str
    sd_um : float
    correlation_mm : float
        Length over which they are correlated.
    """

    name: str
    sd_um: float
    correlation_mm: float


def pixel_rounding(pixel_um: float) -> ContourNoise:
    """Return the errors of a contour drawn in pixels and otherwise perfect."""
    return ContourNoise(
        f"pixels of {pixel_um:g} µm", float(pixel_um / np.sqrt(12)), pixel_um / 1000
    )


# Error of the segmentation of one frame, or of a model.
MODEL_ERROR = ContourNoise("20 µm, correlated over 0.5 mm", 20.0, 0.5)


@dataclass(frozen=True, eq=False)
class Information:
    """Information from one or several contours about the logarithms of the constants.

    Parameters
    ----------
    names : tuple of str
        mu1_mpa, alpha1, ...
    values : ndarray, shape (k,)
    gram_um2_mm : ndarray, shape (k, k)
        Integral of the products of the shifts along both surfaces.
    length_mm : float
        Length of the contour.
    """

    names: tuple[str, ...]
    values: FloatArray
    gram_um2_mm: FloatArray
    length_mm: float

    @property
    def singular_values_um(self) -> FloatArray:
        """Return the RMS shifts of the contour by unit steps, largest first."""
        values = np.linalg.eigvalsh(self.gram_um2_mm / self.length_mm)[::-1]
        return np.sqrt(np.maximum(values, 0.0))

    @property
    def directions(self) -> FloatArray:
        """Return the corresponding steps in the logarithms of the constants, by row."""
        return np.asarray(np.linalg.eigh(self.gram_um2_mm)[1].T[::-1])

    def fisher(self, noise: ContourNoise) -> FloatArray:
        """Return the Fisher information about the logarithms."""
        return np.asarray(self.gram_um2_mm / (noise.correlation_mm * noise.sd_um**2))

    def covariance(self, noise: ContourNoise) -> FloatArray:
        """Return the Cramer-Rao bound of the covariance of the logarithms."""
        values, vectors = np.linalg.eigh(self.fisher(noise))
        values = np.maximum(values, SMALLEST_INFORMATION * values[-1])
        return np.asarray((vectors / values) @ vectors.T)

    def bounds(self, noise: ContourNoise) -> FloatArray:
        """Return the Cramer-Rao bounds of the relative errors, one standard deviation."""
        return np.sqrt(np.diag(self.covariance(noise)))

    def __add__(self, other: "Information") -> "Information":
        """Return the combined information of two images."""
        gram = self.gram_um2_mm + other.gram_um2_mm
        return replace(self, gram_um2_mm=gram, length_mm=self.length_mm + other.length_mm)


@dataclass(frozen=True, eq=False)
class FittedContour:
    """The two surfaces of a fitted cornea, and their derivatives in the constants.

    Parameters
    ----------
    names : tuple of str
    normal : ndarray, shape (n, 2)
        At the deformed nodes on both surfaces.
    length_mm : ndarray, shape (n,)
        Length of contour represented by each node; zero outside the window.
    shift_um : ndarray, shape (n, k)
        Shift along the normal by unit steps of the logarithms.
    """

    names: tuple[str, ...]
    normal: FloatArray
    length_mm: FloatArray
    shift_um: FloatArray

    def gram(self) -> FloatArray:
        """Return the integral of the products of the shifts, shape (k, k)."""
        return np.asarray(self.shift_um.T @ (self.length_mm[:, None] * self.shift_um))


def plain_name(name: str) -> str:
    """Return the internal name of a constant of `law_names`: mu1 of mu1_mpa."""
    return name.removesuffix("_mpa")


def law_names(constants: CorneaConstants) -> tuple[str, ...]:
    """Return the names of the constants of the Ogden terms."""
    terms = range(1, len(constants.mu_mpa) + 1)
    return tuple(name for i in terms for name in (f"mu{i}_mpa", f"alpha{i}"))


def fitted_contour(
    candidate: Candidate, window_mm: tuple[float, float] | None = None
) -> FittedContour | None:
    """Solve a candidate and differentiate its contour; None if it does not converge."""
    names = law_names(candidate.constants)
    result = sensitivity(candidate, names)
    return contour_of(candidate, result, names, window_mm) if result.solution.converged else None


def contour_of(
    candidate: Candidate,
    result: Sensitivity,
    names: tuple[str, ...],
    window_mm: tuple[float, float] | None,
) -> FittedContour:
    """Return the contour of a solution with its derivatives in the constants of the law."""
    mesh = candidate.prepared.mesh
    scale = np.array([scale_of(candidate, name) for name in names])
    x = mesh.nodes_mm + result.solution.displacement_mm
    normals, lengths, shifts = [], [], []
    for surface in (mesh.anterior, mesh.posterior):
        points = x[surface]
        tangent = np.gradient(points, axis=0)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        length = np.gradient(arclength_mm(points))
        if window_mm is not None:
            length = length * ((points[:, 0] > window_mm[0]) & (points[:, 0] < window_mm[1]))
        along = np.einsum("kni,ni->nk", result.derivatives[:, surface], normal)
        normals.append(normal)
        lengths.append(length)
        shifts.append(1e3 * along * scale)
    return FittedContour(
        names, np.concatenate(normals), np.concatenate(lengths), np.concatenate(shifts)
    )


def information_of(candidate: Candidate, contour: FittedContour) -> Information:
    """Return the information from the contour about the constants."""
    values = np.array([scale_of(candidate, name) for name in contour.names])
    return Information(contour.names, values, contour.gram(), float(contour.length_mm.sum()))


def information_of_pressures(
    candidate: Candidate, fractions: Sequence[float], window_mm: tuple[float, float] | None = None
) -> Information | None:
    """Return the joint information of images at several jet pressures; None if one diverges."""
    total: Information | None = None
    for fraction in fractions:
        jet = fraction * candidate.load.jet_pressure_mpa
        under = replace(candidate, load=replace(candidate.load, jet_pressure_mpa=jet))
        contour = fitted_contour(under, window_mm)
        if contour is None:
            return None
        information = information_of(under, contour)
        total = information if total is None else total + information
    return total


def shear_modulus_bound(
    constants: CorneaConstants, information: Information, noise: ContourNoise
) -> float:
    """Return the Cramer-Rao bound of the relative error of G0 = 1/2 sum mu alpha.

    The bound uses the gradient of ln G0 with respect to the logarithms of the constants.
    """
    gradient = shear_modulus_slope(constants)
    return float(np.sqrt(gradient @ information.covariance(noise) @ gradient))


def shear_modulus_slope(constants: CorneaConstants) -> FloatArray:
    """Return the gradient of ln G0 with respect to the logarithms of the constants."""
    return _gradient(constants, lambda c: np.array([np.log(c.shear_modulus_mpa)]))[0]


def stress_slope(constants: CorneaConstants, stretch: float) -> FloatArray:
    """Return the gradient of ln stress at a stretch with respect to the logarithms."""
    at = np.array([stretch])
    return _gradient(constants, lambda c: np.log(uniaxial_stress_mpa(c, at)))[0]


@dataclass(frozen=True, eq=False)
class StressCurve:
    """The uniaxial law of a fitted cornea with its interval.

    Parameters
    ----------
    stretch : ndarray, shape (n,)
    stress_mpa : ndarray, shape (n,)
        Cauchy stress of an incompressible strip.
    sd_mpa : ndarray, shape (n,)
        Cramer-Rao bound.
    """

    stretch: FloatArray
    stress_mpa: FloatArray
    sd_mpa: FloatArray


def stress_curve(
    constants: CorneaConstants, information: Information, noise: ContourNoise, stretch: FloatArray
) -> StressCurve:
    """Return the stress-stretch curve with its interval from the image."""

    def stress(c: CorneaConstants) -> FloatArray:
        return uniaxial_stress_mpa(c, stretch)

    gradient = _gradient(constants, stress)
    covariance = information.covariance(noise)
    variance = np.einsum("nk,kl,nl->n", gradient, covariance, gradient)
    return StressCurve(stretch, stress(constants), np.sqrt(np.maximum(variance, 0.0)))


def uniaxial_stress_mpa(constants: CorneaConstants, stretch: FloatArray) -> FloatArray:
    r"""Return :math:`\sigma = \sum_i m_i (\lambda^{\alpha_i} - \lambda^{-\alpha_i / 2})`."""
    total = np.zeros_like(stretch)
    for modulus, alpha in zip(constants.moduli_mpa, constants.alpha, strict=True):
        total += modulus * (stretch**alpha - stretch ** (-alpha / 2))
    return total


def attained_stretches(candidate: Candidate, displacement_mm: FloatArray) -> tuple[float, float]:
    """Return the smallest and the largest stretch along the two surfaces."""
    mesh = candidate.prepared.mesh
    ratios = []
    for surface in (mesh.anterior[::2], mesh.posterior[::2]):
        before = np.diff(arclength_mm(mesh.nodes_mm[surface]))
        after = np.diff(arclength_mm((mesh.nodes_mm + displacement_mm)[surface]))
        ratios.append(after / before)
    return float(np.min(ratios)), float(np.max(ratios))


def _gradient(
    constants: CorneaConstants, of: Callable[[CorneaConstants], FloatArray], step: float = 1e-5
) -> FloatArray:
    """Return the derivatives with respect to the logarithms of the constants, shape (n, k)."""
    columns = []
    for k in range(len(constants.mu_mpa)):
        for field in ("mu_mpa", "alpha"):
            sides = []
            for sign in (1, -1):
                values = list(getattr(constants, field))
                values[k] *= np.exp(sign * step)
                changes: dict[str, Any] = {field: tuple(values)}
                sides.append(of(replace(constants, **changes)))
            columns.append((sides[0] - sides[1]) / (2 * step))
    return np.stack(columns, axis=1)


def stepped(candidate: Candidate, steps: dict[str, float]) -> Candidate:
    """Return a candidate with the logarithms of its constants increased by steps."""
    for name, step in steps.items():
        candidate = changed(candidate, name, scale_of(candidate, name) * (np.exp(step) - 1))
    return candidate
