"""The two surfaces of a cornea in a tonometer's image.

A surface is first the left-to-right path through the image with the largest gain, then refined to
the steepest slope at each point and smoothed robustly, because values are uncertain and have gaps.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates, uniform_filter1d
from skimage.filters import threshold_otsu

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray
from palpate.workers.organs.cornea.section_outline import Section
from palpate.workers.organs.cornea.tonometer_frames import Frame

# Residuals beyond this many robust standard deviations have no weight (Tukey's biweight).
TUKEY = 4.685


def robust_smooth(
    values: FloatArray, weights: FloatArray, wavelength: float, rounds: int = 8
) -> FloatArray:
    r"""Return a smooth curve through values, ignoring outliers.

    Minimises :math:`\sum w_i (z_i - v_i)^2 + \lambda \sum (\Delta^3 z_i)^2` (E. Whittaker,
    1923; P. Eilers, Anal. Chem. 75, 2003), reweighted by Tukey's biweight of the residuals.
    A wave of the given length is halved: :math:`\lambda = (2 \sin(\pi / l))^{-6}`; a wave three
    times as long loses 0.1 %. Gaps are bridged by parabolas.

    Parameters
    ----------
    values : ndarray, shape (n,)
        At equal steps; values that are not finite have weight zero.
    weights : ndarray, shape (n,)
        >= 0.
    wavelength : float
        In steps; > 2.
    rounds : int
        Number of reweightings.

    Returns
    -------
    ndarray, shape (n,)
    """
    n = len(values)
    usable = np.isfinite(values) & (weights > 0)
    values = np.where(usable, values, 0.0)
    base = np.where(usable, weights, 0.0)
    penalty = (2 * np.sin(np.pi / wavelength)) ** -6 * _third_differences(n)
    weight = base
    smooth = values
    for _ in range(rounds):
        banded = penalty.copy()
        # A small weight keeps the matrix positive definite even if nearly everything is a gap.
        banded[-1] += weight + 1e-12
        smooth = solveh_banded(banded, weight * values)
        residual = values - smooth
        scale = 1.4826 * float(np.median(np.abs(residual[usable]))) + 1e-9
        fall = np.clip(1 - (residual / (TUKEY * scale)) ** 2, 0.0, None) ** 2
        weight = base * fall
    return np.asarray(smooth)


def _third_differences(n: int) -> FloatArray:
    """Return D^T D of the third differences of n values, upper banded form, shape (4, n)."""
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    banded = np.zeros((4, n))
    for i in range(4):
        for j in range(i, 4):
            banded[3 - (j - i), j : n - 3 + j] += stencil[i] * stencil[j]
    return banded


def best_path(gain: FloatArray, steepest: int, bend: float) -> IntArray:
    """Return the row in each column of the path with the largest sum of gains.

    The solution by dynamic programming is exact.

    Parameters
    ----------
    gain : ndarray, shape (rows, columns)
        ``-inf`` where the path is not allowed.
    steepest : int
        Largest difference of rows between neighbouring columns; >= 1.
    bend : float
        Penalty per row of difference.

    Returns
    -------
    ndarray of int32, shape (columns,)
    """
    path: IntArray = _best_path(np.ascontiguousarray(gain), steepest, bend)
    return path


@njit(cache=True, nogil=True)
def _best_path(gain: FloatArray, steepest: int, bend: float) -> IntArray:
    """Return the row of the path in every column; see `best_path`."""
    rows, columns = gain.shape
    total = gain[:, 0].copy()
    previous = np.zeros((rows, columns), dtype=np.int32)
    for c in range(1, columns):
        following = np.empty(rows)
        for r in range(rows):
            best = -np.inf
            where = r
            for s in range(max(0, r - steepest), min(rows, r + steepest + 1)):
                value = total[s] - bend * abs(s - r)
                if value > best:
                    best = value
                    where = s
            following[r] = best + gain[r, c]
            previous[r, c] = where
        total = following
    path = np.empty(columns, dtype=np.int32)
    path[columns - 1] = np.argmax(total)
    for c in range(columns - 1, 0, -1):
        path[c - 1] = previous[path[c], c]
    return path


# Standard deviation of the derivative filter across a surface, and of the average along it.
EDGE_MM = 0.016
ALONG_MM = 0.06
# Shorter waves of a surface are damped by half or more; the dent of an air puff is 4 mm wide. The
# posterior edge is fainter.
ANTERIOR_WAVE_MM = 0.5
POSTERIOR_WAVE_MM = 0.8
# Vertical distance between the surfaces, not corrected for refraction and slope.
THICKNESS_MM = (0.15, 1.3)
# Distance from its first path within which a surface is searched again.
REFINE_MM = 0.06
# Half width over which the flank of an edge is averaged, in standard deviations of the filter.
FLANK_SIGMA = 3.0
# A column counts if the tissue exceeds the background by this many standard deviations of the
# pixel noise and by this fraction of the typical contrast.
MIN_CONTRAST_NOISE = 2.0
MIN_CONTRAST_PART = 0.25
# Fraction of the columns in which both surfaces must be visible.
MIN_SEEN = 0.6


@dataclass(frozen=True, eq=False)
class SegmentedFrame:
    """Surfaces of a cornea in pixels of its image.

    Parameters
    ----------
    frame : Frame
    columns : ndarray, shape (k,)
        Contiguous columns from the first to the last one in which both surfaces are visible.
    anterior_row, posterior_row : ndarray, shape (k,)
        Row of the surface, with fractions.
    anterior_confidence, posterior_confidence : ndarray, shape (k,)
        0 where the surface is bridged over a gap or a reflex, 1 where it is as sharp as
        typical in this image.
    anterior_rms_px, posterior_rms_px : float
        Scatter of the edges of single columns about the smooth surface.
    """

    frame: Frame
    columns: FloatArray
    anterior_row: FloatArray
    posterior_row: FloatArray
    anterior_confidence: FloatArray
    posterior_confidence: FloatArray
    anterior_rms_px: float
    posterior_rms_px: float

    @property
    def anterior_mm(self) -> FloatArray:
        """Return the anterior surface in the coordinates of the frame, shape (k, 2)."""
        return self.frame.to_mm(self.columns, self.anterior_row)

    @property
    def posterior_mm(self) -> FloatArray:
        """Return the apparent posterior surface in the frame's coordinates, shape (k, 2)."""
        return self.frame.to_mm(self.columns, self.posterior_row)

    @property
    def section(self) -> Section:
        """Return both surfaces as a section in the coordinates of the frame."""
        return Section(anterior_mm=self.anterior_mm, posterior_mm=self.posterior_mm)

    @property
    def labels(self) -> NDArray[np.uint8]:
        """Return the label image [row, column]: 1 where the centre of a pixel is cornea."""
        labels = np.zeros(self.frame.grey.shape, dtype=np.uint8)
        row = np.arange(len(labels))[:, None]
        inside = (row >= self.anterior_row) & (row <= self.posterior_row)
        labels[:, self.columns.astype(np.int64)] = inside
        return labels


@dataclass(frozen=True)
class _Levels:
    """Grey values of an image: background, contrast of the tissue, noise; pixels per mm."""

    background: float
    contrast: float
    noise: float
    pixels: tuple[float, float]  # per millimetre along x and y

    def down(self, mm: float, least: int = 1) -> int:
        return max(least, round(mm * self.pixels[1]))


def segment_frame(frame: Frame) -> SegmentedFrame:
    """Return the two surfaces of the cornea in an image, to a fraction of a pixel.

    1. The anterior surface is the path from left to right along which the image changes from
       dark to bright downwards, with darkness above and tissue below; the posterior one is the
       path below it with the change from bright to dark. Both are found by dynamic programming,
       which crosses gaps and reflexes.
    2. Each is refined in an image straightened along its path and averaged along it: the
       anterior one at the steepest grey value, the posterior one at the centre of its flank.
    3. A robust smooth curve is fitted through the columns, weighted by the clarity of the edge.

    Parameters
    ----------
    frame : Frame
        The cornea should extend over the whole width of the image; gaps near the sides are
        allowed.

    Returns
    -------
    SegmentedFrame

    Raises
    ------
    InputError
        If there is no bright band with two edges across the image.
    """
    levels = _levels(frame)
    grey = frame.grey
    anterior = _refined(
        grey, _anterior_path(grey, levels), levels, sign=1.0, wave_mm=ANTERIOR_WAVE_MM
    )
    seen = anterior.confidence > 0
    _demand(seen, "anterior")
    first, last = np.flatnonzero(seen)[[0, -1]]
    columns = np.arange(first, last + 1)
    anterior = anterior.between(first, last + 1)
    grey = grey[:, first : last + 1]
    posterior = _refined(
        grey,
        _posterior_path(grey, anterior.row, levels),
        levels,
        sign=-1.0,
        wave_mm=POSTERIOR_WAVE_MM,
    )
    both = (posterior.confidence > 0) & (posterior.row < grey.shape[0] - 1)
    _demand(both, "posterior")
    first, last = np.flatnonzero(both)[[0, -1]]
    anterior = anterior.between(first, last + 1)
    posterior = posterior.between(first, last + 1)
    thickness = (posterior.row - anterior.row) * frame.spacing_mm[1]
    if not (np.all(thickness > 0) and np.median(thickness) < THICKNESS_MM[1]):
        raise InputError(
            "The bright band in the image is not a cornea: its two edges meet or are "
            f"{np.median(thickness):.2f} mm apart. {_ADVICE}"
        )
    return SegmentedFrame(
        frame=frame,
        columns=columns[first : last + 1].astype(np.float64),
        anterior_row=anterior.row,
        posterior_row=posterior.row,
        anterior_confidence=anterior.confidence,
        posterior_confidence=posterior.confidence,
        anterior_rms_px=anterior.rms,
        posterior_rms_px=posterior.rms,
    )


_ADVICE = (
    "Give an image with the cornea as a bright band from left to right on a dark background, "
    "and its pixel size in mm."
)


def _demand(seen: NDArray[np.bool_], surface: str) -> None:
    if seen.mean() < MIN_SEEN:
        raise InputError(
            f"The {surface} surface of a cornea is visible in {100 * seen.mean():.0f} % of the "
            f"columns of the image; at least {100 * MIN_SEEN:.0f} % are needed. {_ADVICE}"
        )


def _levels(frame: Frame) -> _Levels:
    grey = frame.grey
    if np.ptp(grey) == 0:
        raise InputError(f"All grey values of the image are {grey.flat[0]:g}. {_ADVICE}")
    soft = gaussian_filter(grey, 2.0)
    bright = soft > threshold_otsu(soft)
    background = float(np.median(grey[~bright]))
    # Second differences along rows are insensitive to slopes in the image: variance 6 sigma^2.
    rough = np.diff(grey, n=2, axis=1)[~bright[:, 1:-1]]
    return _Levels(
        background=background,
        contrast=float(np.median(grey[bright])) - background,
        noise=float(1.4826 * np.median(np.abs(rough)) / np.sqrt(6)),
        pixels=(1 / frame.spacing_mm[0], 1 / frame.spacing_mm[1]),
    )


def _strip(image: FloatArray, begin: int, end: int) -> FloatArray:
    """Return the mean of the rows `begin` to `end` (exclusive) below each pixel."""
    length = end - begin
    mean = uniform_filter1d(image, length, axis=0, mode="nearest", origin=0)
    shift = begin + length // 2
    index = np.clip(np.arange(image.shape[0]) + shift, 0, image.shape[0] - 1)
    return np.asarray(mean[index])


def _part(image: FloatArray, levels: _Levels) -> FloatArray:
    """Return the relative brightness: 0 for the background, 1 for typical tissue or brighter."""
    return np.clip((image - levels.background) / levels.contrast, 0.0, 1.0)


def _smoothed(grey: FloatArray, levels: _Levels) -> FloatArray:
    sigma = [max(0.8, EDGE_MM * p) for p in levels.pixels]
    return gaussian_filter(grey, (sigma[1], 2 * sigma[0]))


def _slope_gain(slope: FloatArray) -> FloatArray:
    """Return slopes relative to half the typical largest slope of a column, 0 to 1."""
    typical = 0.5 * float(np.median(slope.max(axis=0)))
    return np.clip(slope / max(typical, 1e-12), 0.0, 1.0)


def _anterior_path(grey: FloatArray, levels: _Levels) -> FloatArray:
    soft = _smoothed(grey, levels)
    slope = np.gradient(soft, axis=0)
    near, far = levels.down(0.05), levels.down(0.2, least=3)
    below = _part(_strip(soft, near, far), levels)
    above = _part(_strip(soft, -levels.down(0.4, least=5), -near), levels)
    gain = _slope_gain(slope) + below - 2 * above
    steepest = max(1, int(np.ceil(2 * levels.pixels[1] / levels.pixels[0])))
    return best_path(gain, steepest, bend=0.05).astype(np.float64)


def _posterior_path(grey: FloatArray, anterior: FloatArray, levels: _Levels) -> FloatArray:
    nearest = levels.down(THICKNESS_MM[0], least=3)
    farthest = levels.down(THICKNESS_MM[1])
    tall = _straightened(grey, anterior, 0, farthest + levels.down(0.3), levels.background)
    soft = _smoothed(tall, levels)
    # Each column is compared with its own tissue, since the light fades towards the limbus.
    tissue = np.median(soft[levels.down(0.08) : levels.down(0.2) + 2], axis=0)
    tissue = gaussian_filter1d(tissue, max(1.0, 0.2 * levels.pixels[0])) - levels.background
    soft = (soft - levels.background) / np.maximum(tissue, 0.1 * levels.contrast)
    slope = -np.gradient(soft, axis=0)
    near, far = levels.down(0.03), levels.down(0.15, least=3)
    below = np.clip(_strip(soft, near, far), 0.0, 1.0)
    above = np.clip(_strip(soft, -far, -near), 0.0, 1.0)
    gain = _slope_gain(slope) + above - 2 * below
    gain[:nearest] = -np.inf
    gain[farthest:] = -np.inf
    return anterior + best_path(gain, 1, bend=0.1)


def _straightened(
    grey: FloatArray, path: FloatArray, begin: int, end: int, outside: float
) -> FloatArray:
    """Return the rows `begin` to `end` (exclusive) below a path, shape (end - begin, k)."""
    rows = path + np.arange(begin, end)[:, None]
    columns = np.broadcast_to(np.arange(len(path)), rows.shape)
    return np.asarray(
        map_coordinates(grey, [rows, columns], order=1, mode="constant", cval=outside)
    )


@dataclass(frozen=True, eq=False)
class _Surface:
    row: FloatArray
    confidence: FloatArray
    rms: float

    def between(self, first: int, last: int) -> "_Surface":
        return _Surface(self.row[first:last], self.confidence[first:last], self.rms)


def _refined(
    grey: FloatArray, path: FloatArray, levels: _Levels, sign: float, wave_mm: float
) -> _Surface:
    """Return the surface near a path where the grey value rises (sign 1) or falls (-1)."""
    width = wave_mm * levels.pixels[0]
    weights = np.ones_like(path)
    row = robust_smooth(path, weights, width)
    for _ in range(3):
        offset, weights = _edge_offset(grey, row, levels, sign)
        if not weights.any():
            return _Surface(row=row, confidence=weights, rms=np.inf)
        edge = row + offset
        row = robust_smooth(edge, weights, width)
    residual = edge - row
    rms = float(1.4826 * np.median(np.abs(residual[weights > 0])))
    outlier = np.abs(residual) > np.maximum(5 * rms, 1.0)
    return _Surface(row=row, confidence=np.where(outlier, 0.0, weights), rms=rms)


def _steepest(slope: FloatArray) -> FloatArray:
    """Return the position of the largest slope of each column, by a parabola through three.

    The bright ridge below the anterior surface shifts it outwards by a quarter of a camera
    pixel, half as much as the centre of the flank.
    """
    peak = np.clip(np.argmax(slope, axis=0), 1, len(slope) - 2)
    before, top, after = (slope[peak + k, np.arange(slope.shape[1])] for k in (-1, 0, 1))
    curvature = np.minimum(before - 2 * top + after, -1e-12)
    return np.asarray(peak + np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))


def _flank_centre(slope: FloatArray, sigma: float) -> FloatArray:
    """Return the centre of the slopes near the largest one of each column.

    The posterior edge is faint and blurred over many pixels, so the centre scatters less than
    the steepest position.
    """
    place = np.arange(len(slope))[:, None]
    near = np.abs(place - np.argmax(slope, axis=0)) <= FLANK_SIGMA * sigma + 1
    flank = np.where(near, np.maximum(slope, 0.0), 0.0)
    return np.asarray(np.sum(place * flank, axis=0) / np.maximum(flank.sum(axis=0), 1e-12))


def _edge_offset(
    grey: FloatArray, row: FloatArray, levels: _Levels, sign: float
) -> tuple[FloatArray, FloatArray]:
    """Return the offset of the edge below a curve, in pixels, and its clarity, 0 to 1."""
    reach = levels.down(REFINE_MM, least=3)
    side = levels.down(0.15, least=4)
    tall = _straightened(grey, row, -reach - side, reach + side + 1, levels.background)
    tall = gaussian_filter1d(tall, max(1.0, ALONG_MM * levels.pixels[0]), axis=1)
    sigma = max(0.8, EDGE_MM * levels.pixels[1])
    slope = sign * gaussian_filter1d(tall, sigma, axis=0, order=1)
    window = slope[side : side + 2 * reach + 1]
    offset = (_steepest(window) if sign > 0 else _flank_centre(window, sigma)) - reach
    index = np.arange(tall.shape[0])[:, None] - (side + reach) - offset
    near = sigma + 0.5
    over = np.where((index < -near) & (index > -side), tall, np.nan)
    under = np.where((index > near) & (index < side), tall, np.nan)
    step = sign * (np.nanmean(under, axis=0) - np.nanmean(over, axis=0))
    demanded = max(MIN_CONTRAST_NOISE * levels.noise, MIN_CONTRAST_PART * levels.contrast)
    inside = (row + offset > 0.5) & (row + offset < grey.shape[0] - 1.5)
    typical = max(float(np.median(step)), demanded)
    clear = np.where((step > demanded) & inside, np.clip(step / typical, 0.0, 1.0), 0.0)
    return offset, clear
