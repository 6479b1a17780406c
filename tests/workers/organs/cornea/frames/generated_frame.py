"""A generated image of a corneal section."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section_outline import Section
from palpate.workers.organs.cornea.tonometer_frames import Frame

# Number of vertical lines per pixel; along each of them the coverage is exact.
LINES_PER_PIXEL = 8


@dataclass(frozen=True)
class FrameLook:
    """Optical properties of a generated frame; defaults are similar to Corvis frames.

    Parameters
    ----------
    background, tissue : float
        Grey value of air and aqueous humour, and of the stroma.
    ridge, ridge_depth_px : float
        Additional brightness of the anterior surface, and the depth at which it has fallen to
        1/e.
    edge_dimming : float
        Fraction of the brightness lost at the left and the right edge.
    blur_px : float
        Standard deviation of the point spread function.
    speckle : float
        Standard deviation of the multiplicative noise of the tissue.
    noise : float
        Standard deviation of the additive noise of the camera.
    reflex_px : float
        Radius of a saturated reflex at the top of the anterior surface; 0 for none.
    shadows : tuple of (float, float)
        Start and end columns that an eyelash darkens to the background.
    """

    background: float = 8.0
    tissue: float = 40.0
    ridge: float = 40.0
    ridge_depth_px: float = 4.0
    edge_dimming: float = 0.3
    blur_px: float = 1.0
    speckle: float = 0.15
    noise: float = 2.0
    reflex_px: float = 0.0
    shadows: tuple[tuple[float, float], ...] = ()


def generated_frame(
    section: Section,
    spacing_mm: tuple[float, float],
    shape: tuple[int, int],
    look: FrameLook | None = None,
    seed: int = 0,
) -> Frame:
    """Return an image of a section as seen by a tonometer's camera.

    Parameters
    ----------
    section : Section
        In the coordinates of a frame: x to the right from the first column, y upwards from the
        first row, so y is negative in the image. Both surfaces must be functions of x; parts
        outside the image are cut off.
    spacing_mm : tuple of float
        Width and height of a pixel.
    shape : tuple of int
        Rows and columns.
    look : FrameLook
    seed : int
        Seed of speckle and noise.

    Returns
    -------
    Frame
        Grey values are whole numbers from 0 to 255.
    """
    look = look or FrameLook()
    rows, columns = shape
    rng = np.random.default_rng(seed)
    fine = (np.arange(columns * LINES_PER_PIXEL) + 0.5) / LINES_PER_PIXEL - 0.5
    top = -_graph(section.anterior_mm, fine * spacing_mm[0]) / spacing_mm[1]
    bottom = -_graph(section.posterior_mm, fine * spacing_mm[0]) / spacing_mm[1]
    edges = np.arange(rows + 1)[:, None] - 0.5
    # The brightness below a row edge is integrated exactly, then differences give pixels.
    depth = np.clip(edges, top, bottom) - top
    ridge = look.ridge * look.ridge_depth_px * (1 - np.exp(-depth / look.ridge_depth_px))
    light = np.diff(look.tissue * depth + ridge, axis=0)
    cover = np.diff(depth, axis=0)
    light, cover = (
        part.reshape(rows, columns, LINES_PER_PIXEL).mean(axis=2) for part in (light, cover)
    )
    middle = (np.arange(columns) - (columns - 1) / 2) / (columns / 2)
    light *= 1 - look.edge_dimming * middle**2
    light *= 1 + look.speckle * rng.standard_normal(shape)
    for begin, end in look.shadows:
        light[:, int(begin) : int(end)] = 0.0
        cover[:, int(begin) : int(end)] = 0.0
    grey = light + look.background * (1 - cover)
    if look.reflex_px > 0:
        at = int(np.argmin(top))
        row, column = np.indices(shape)
        far = np.hypot(column - fine[at], row - top[at])
        grey[far < look.reflex_px] = 255.0
    grey = gaussian_filter(grey, look.blur_px) + look.noise * rng.standard_normal(shape)
    return Frame(grey=np.clip(np.rint(grey), 0.0, 255.0), spacing_mm=spacing_mm)


def _graph(surface: FloatArray, x: FloatArray) -> FloatArray:
    """Return y at x; beyond the ends of the surface, a position far below the image."""
    y: FloatArray = np.interp(x, surface[:, 0], surface[:, 1], left=-1e3, right=-1e3)
    return y
