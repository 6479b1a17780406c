"""Breast phantoms generated from settings and a seed."""

import time
from dataclasses import dataclass
from numbers import Integral
from typing import TypedDict

import numpy as np

from palpate.storage.errors import InputError
from palpate.storage.values import Volume
from palpate.workers.body.phantom.compartments import draw_compartments
from palpate.workers.body.phantom.glandular import (
    choose_compartments,
    count_ids,
    gland_weight,
    label_tissue,
)
from palpate.workers.body.phantom.octree import partition
from palpate.workers.body.phantom.settings import PRESETS, BreastPhantom
from palpate.workers.body.phantom.voxel_classification import FIRST_ID

__all__ = ["PRESETS", "BreastPhantom", "Phantom", "generate_breast"]


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
