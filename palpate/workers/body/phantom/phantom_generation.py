"""Breast phantoms generated from settings and a seed.

The glandular compartments are chosen at random, to meet a volume fraction.
"""

import time
from dataclasses import dataclass
from numbers import Integral
from typing import Final, TypedDict

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, Tissue, Volume
from palpate.workers.body.phantom.compartments import (
    AIR_ID,
    FIRST_ID,
    LIGAMENT_ID,
    SKIN_ID,
    Ids,
    draw_compartments,
    vertical_semi_axis,
)
from palpate.workers.body.phantom.octree import partition
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.kernels_and_threads import EXACT

Labels = NDArray[np.uint8]
Counts = NDArray[np.int64]

TOLERANCE: Final = 0.005  # of the wanted volume; a compartment is split beyond it
LOOK_AHEAD: Final = 10  # candidates for the last place in the race
GLAND_WIDTH: Final = 0.4  # of the distance from the nipple axis to the skin
GLAND_HEIGHT: Final = 0.6  # vertical size relative to that: fat above and below


@dataclass(frozen=True, eq=False)
class GlandularChoice:
    """The compartments of glandular tissue.

    Parameters
    ----------
    whole : ndarray of int
        Compartments that are glandular throughout.
    split : int or None
        A compartment that is glandular in part, if whole ones do not fit.
    split_voxels : int
        Its number of glandular voxels.
    """

    whole: NDArray[np.int64]
    split: int | None = None
    split_voxels: int = 0


def gland_weight(settings: BreastPhantom, points_mm: FloatArray) -> FloatArray:
    r"""Return relative odds, in (0, 1], that tissue at points inside the outline is glandular.

    .. math:: w = e^{-(\rho/0.4)^2} \sqrt{z/a}, \qquad
              \rho^2 = \frac{(y/b)^2 + (x/0.6c)^2}{1 - (z/a)^2}

    The distance rho from the axis of the nipple is relative to the distance of the
    skin: gland fills a cone-like body behind the nipple, with fat around it and
    in front of the chest wall.

    Parameters
    ----------
    points_mm : ndarray, shape (n, 3)

    Returns
    -------
    ndarray, shape (n,)
    """
    x, y, z = points_mm.T
    height = GLAND_HEIGHT * vertical_semi_axis(settings, x)
    depth = np.clip(z / settings.depth_mm, 0.0, 1.0)
    free = np.maximum(1 - depth**2, 1e-3)
    rho2 = ((y / settings.half_width_mm) ** 2 + (x / height) ** 2) / free
    # Far from the axis the exponential vanishes; the race needs positive odds.
    return np.maximum(np.exp(-rho2 / GLAND_WIDTH**2) * np.sqrt(depth), 1e-12)


def choose_compartments(
    voxels: Counts, weights: FloatArray, wanted: int, rng: np.random.Generator
) -> GlandularChoice:
    """Choose compartments whose voxels add up to `wanted`.

    An exponential race: compartment i arrives at a time drawn with rate w_i,
    which is weighted drawing without replacement [1]_. Compartments are chosen
    in order of arrival while they fit. For the last place, the one of the next ten
    that brings the sum closest to `wanted` is chosen, or none if that is closer.
    If the sum is still off by more than half a percent (few or large
    compartments), the first that did not fit is split instead, and the sum is exact.

    Parameters
    ----------
    voxels : ndarray of int, shape (n,)
        Size of each compartment; 0 for those without volume.
    weights : ndarray, shape (n,)
        Odds, > 0.
    wanted : int
        Number of glandular voxels, less than the sum of `voxels`.

    References
    ----------
    .. [1] P. S. Efraimidis, P. G. Spirakis, Inform. Process. Lett. 97(5), 181-185, 2006.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> choice = choose_compartments(np.array([5, 5, 0, 5]), np.ones(4), 7, rng)
    >>> len(choice.whole), choice.split_voxels
    (1, 2)
    """
    arrival = rng.exponential(size=len(weights)) / weights
    order = np.argsort(arrival, kind="stable")
    order = order[voxels[order] > 0]
    total = np.cumsum(voxels[order])
    taken = int(np.searchsorted(total, wanted, side="right"))
    missing = wanted - (int(total[taken - 1]) if taken else 0)
    whole, waiting = order[:taken], order[taken : taken + LOOK_AHEAD]
    if missing <= TOLERANCE * wanted and not np.any(np.abs(voxels[waiting] - missing) < missing):
        return GlandularChoice(whole)
    last = waiting[np.argmin(np.abs(voxels[waiting] - missing))]
    if abs(int(voxels[last]) - missing) <= TOLERANCE * wanted:
        return GlandularChoice(np.append(whole, last))
    return GlandularChoice(whole, int(waiting[0]), missing)


def label_tissue(
    ids: Ids, settings: BreastPhantom, choice: GlandularChoice, compartments: int
) -> Labels:
    """Convert compartment ids to tissue labels, shape (nz, ny, nx).

    In a split compartment the voxels with the largest `gland_weight` are glandular, so
    the cut follows the surface of the gland.
    """
    table = np.full(FIRST_ID + compartments, int(Tissue.FAT), dtype=np.uint8)
    table[AIR_ID] = Tissue.AIR
    table[SKIN_ID] = Tissue.SKIN
    table[LIGAMENT_ID] = Tissue.LIGAMENT
    table[FIRST_ID + choice.whole] = Tissue.GLANDULAR
    labels = np.empty(ids.shape, dtype=np.uint8)
    _look_up(ids.reshape(-1), table, labels.reshape(-1))
    if choice.split is not None:
        voxels = np.flatnonzero(ids == FIRST_ID + choice.split)
        zyx = np.column_stack(np.unravel_index(voxels, ids.shape))
        points = zyx[:, ::-1] * settings.spacing_mm + np.asarray(settings.origin_mm)
        order = np.argsort(-gland_weight(settings, points), kind="stable")
        labels.reshape(-1)[voxels[order[: choice.split_voxels]]] = Tissue.GLANDULAR
    return labels


@njit(**EXACT)
def count_ids(ids: NDArray[np.uint16], n: int) -> Counts:
    """Count the voxels of each id below `n`, from a flat array."""
    counts = np.zeros(n, dtype=np.int64)
    for v in ids:
        counts[v] += 1
    return counts


@njit(**EXACT)
def _look_up(ids: NDArray[np.uint16], table: Labels, labels: Labels) -> None:
    # numpy's table[ids] would first turn 2-byte ids into 8-byte indices.
    for v in range(ids.shape[0]):
        labels[v] = table[ids[v]]


class PhantomFacts(TypedDict):
    """Measured sizes of a generated breast, see `Phantom`."""

    volume_ml: float
    interior_ml: float
    skin_ml: float
    glandular_fraction: float
    ligament_fraction: float
    compartments: int
    glandular_compartments: int
    split_compartment: bool
    voxels: int
    seconds: float


@dataclass(frozen=True, eq=False)
class Phantom:
    """A generated breast.

    Parameters
    ----------
    compartments : Volume of uint16
        0 air, 1 skin, 2 ligament, 3 + i compartment i.
    labels : Volume of uint8
        Tissue of each voxel, see `storage.values.Tissue`.
    facts : PhantomFacts
        Measured values, ready for JSON: ``volume_ml`` of the body, ``interior_ml``
        inside the skin, ``glandular_fraction`` and ``ligament_fraction`` of that
        interior, ``skin_ml``, ``compartments`` (with at least one voxel),
        ``glandular_compartments``, ``split_compartment`` (True if one of them is
        glandular in part), ``voxels`` of the body and ``seconds``.
    """

    compartments: Volume
    labels: Volume
    facts: PhantomFacts


def generate_breast(settings: BreastPhantom, seed: int) -> Phantom:
    """Generate the labelled voxels of a breast.

    Coordinates: x vertical (upwards, 0 at the height of the nipple), y the
    direction of compression, z from the chest wall (the voxel faces at z = 0) to
    the nipple. Equal settings and seed give equal voxels, bit for bit. The
    same seed gives the same compartments at every voxel size and glandular
    fraction.

    Parameters
    ----------
    settings : BreastPhantom
    seed : int
        Not negative.

    Raises
    ------
    InputError
        If the seed is not a whole number >= 0, or if the compartments have too
        little tissue for the glandular fraction.

    References
    ----------
    .. [1] D. D. Pokrajac, A. D. A. Maidment, P. R. Bakic, "Optimized generation
       of high resolution breast anthropomorphic software phantoms", Med. Phys.
       39(4), 2290-2302, 2012.
    """
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise InputError(f"The seed of a phantom must be a whole number >= 0, got {seed!r}.")
    started = time.perf_counter()
    anatomy, race = (np.random.default_rng(s) for s in np.random.SeedSequence(int(seed)).spawn(2))
    compartments = draw_compartments(settings, anatomy)
    n = len(compartments.offset)
    ids, _ = partition(settings, compartments)
    counts = count_ids(ids.reshape(-1), FIRST_ID + n)
    _, skin, ligament = (int(v) for v in counts[:FIRST_ID])
    tissue = int(counts[FIRST_ID:].sum())
    interior = ligament + tissue
    wanted = round(settings.glandular_fraction * interior)
    if not 0 < wanted < tissue:
        raise InputError(
            f"A glandular fraction of {settings.glandular_fraction:g} cannot be reached: "
            f"ligaments take "
            f"{ligament / max(interior, 1):.0%} of the {interior:,} voxels inside the skin. "
            "Use thinner ligaments (ligament_mm), fewer compartments or a smaller spacing_mm."
        )
    weights = gland_weight(settings, compartments.seeds_mm)
    choice = choose_compartments(counts[FIRST_ID:], weights, wanted, race)
    labels = label_tissue(ids, settings, choice, n)
    gland = int(counts[FIRST_ID + choice.whole].sum()) + choice.split_voxels
    h = settings.spacing_mm
    voxel_ml = h**3 / 1000
    facts: PhantomFacts = {
        "volume_ml": (interior + skin) * voxel_ml,
        "interior_ml": interior * voxel_ml,
        "skin_ml": skin * voxel_ml,
        "glandular_fraction": gland / interior,
        "ligament_fraction": ligament / interior,
        "compartments": int(np.count_nonzero(counts[FIRST_ID:])),
        "glandular_compartments": len(choice.whole) + (choice.split is not None),
        "split_compartment": choice.split is not None,
        "voxels": interior + skin,
        "seconds": time.perf_counter() - started,
    }
    place = (h, h, h), settings.origin_mm
    return Phantom(Volume(ids, *place), Volume(labels, *place), facts)
