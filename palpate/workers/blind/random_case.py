"""Random cases: a fixed table of kinds, with everything else drawn from a seed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import reduce
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from palpate.storage.errors import InputError
from palpate.workers.blind.breast_scene import Anatomy, Cause, Constants, Scene, log_uniform
from palpate.workers.blind.case_deviations import Deviations, World, draw_deviations
from palpate.workers.blind.setup_causes import (
    Adhesion,
    BentPlate,
    Friction,
    Gravity,
    ImageScale,
    PlateForce,
    Segmentation,
    ShortPlate,
    Tether,
    Tilt,
    WallCompliance,
    WallRise,
)
from palpate.workers.blind.tissue_causes import (
    FibreContrast,
    Fibres,
    Gradient,
    Inclusion,
    Ligament,
    Oedema,
    SkinSheet,
    Stiffening,
    Swelling,
)

SINGLES: Final[tuple[type[Cause], ...]] = (
    Gravity,
    Friction,
    Tilt,
    ShortPlate,
    WallCompliance,
    Adhesion,
    Tether,
    Gradient,
    Inclusion,
    Fibres,
    FibreContrast,
    Stiffening,
    SkinSheet,
    Swelling,
    Segmentation,
    ImageScale,
)
OTHERS: Final[Mapping[type[Cause], float]] = MappingProxyType(
    {PlateForce: 0.05, WallRise: 0.06, BentPlate: 0.03, Ligament: 0.02, Oedema: 0.02}
)
CONTROL, PAIR, TRIPLE = "control", "pair", "triple"
TOGETHER: Final[Mapping[str, int]] = MappingProxyType({PAIR: 2, TRIPLE: 3})
"""Number of causes of the kinds with several; no two causes have the same effect."""

KINDS: Final[Mapping[str, float]] = MappingProxyType(
    {CONTROL: 0.18, PAIR: 0.10, TRIPLE: 0.04}
    | {cause.kind: 0.5 / len(SINGLES) for cause in SINGLES}
    | {cause.kind: share for cause, share in OTHERS.items()}
)
"""Every kind and its share of the cases; shares sum to 1."""

BY_KIND: Final = {cause.kind: cause for cause in (*SINGLES, *OTHERS)}
AXES: Final = ("y", "x")
# Forces in N that compress a body of 20 mm mean half section by some 15 and 25 %. Under larger
# forces along its longer axis, a breast slips sideways out of smooth plates.
FORCES_N: Final = MappingProxyType({"y": (15.0, 32.0), "x": (10.0, 20.0)})


@dataclass(frozen=True, slots=True)
class Load:
    """Compression by plates normal to an axis, ``x`` or ``y``, with the reported force."""

    axis: str
    force_n: float


@dataclass(frozen=True)
class Truth:
    """Description of a case before it is made, including the correct diagnosis.

    Parameters
    ----------
    seed : int
    kind : str
        One of `KINDS`.
    causes : tuple of Cause
        Empty for a control, two for a pair, three for a triple.
    anatomy : Anatomy
    constants : Constants
    loads : tuple of Load
        Loads of the loaded scans, in order.
    noise_sd_mm : float
        Given segmentation noise of every scan.
    deviations : Deviations
        Deviations other than the causes.
    """

    seed: int
    kind: str
    causes: tuple[Cause, ...]
    anatomy: Anatomy
    constants: Constants
    loads: tuple[Load, ...]
    noise_sd_mm: float
    deviations: Deviations = field(default_factory=Deviations)

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the catalogue names of the causes' effects; causes without one are omitted."""
        return tuple(c.effect for c in self.causes if c.effect is not None)

    @property
    def families(self) -> tuple[str, ...]:
        """Return the families of the causes that have one."""
        return tuple(c.family for c in self.causes if c.family is not None)

    @property
    def catalogued(self) -> bool:
        """Return True if every cause is in the catalogue of a diagnosis."""
        return all(c.effect is not None for c in self.causes)

    @property
    def scene(self) -> Scene:
        """Return the physics of the case."""
        nominal = Scene(self.anatomy, self.constants)
        caused = reduce(lambda scene, cause: cause.apply_to(scene), self.causes, nominal)
        return self.deviations.apply_to(caused)

    def record(self) -> dict[str, Any]:
        """Return all fields, ready for JSON."""
        return {
            "seed": self.seed,
            "kind": self.kind,
            "causes": [
                {"kind": c.kind, "effect": c.effect, "family": c.family, "parameters": asdict(c)}  # type: ignore[call-overload]
                for c in self.causes
            ],
            "effects": list(self.effects),
            "families": list(self.families),
            "catalogued": self.catalogued,
            "anatomy": asdict(self.anatomy),
            "constants": asdict(self.constants),
            "loads": [asdict(load) for load in self.loads],
            "noise_sd_mm": self.noise_sd_mm,
            "deviations": asdict(self.deviations),
        }


def draw(
    seed: int, kind: str | None = None, *, one_direction: bool = False, world: World = World.plain
) -> Truth:
    """Draw the case for a seed.

    Parameters
    ----------
    seed : int
        A number >= 0. Equal seeds give equal cases; the body, the constants and the forces do not
        depend on the kind.
    kind : str, optional
        One of `KINDS`; drawn according to their shares by default.
    one_direction : bool
        Use only plates normal to y.
    world : World
        Level of deviations other than the causes; everything else is the same in both worlds.

    Raises
    ------
    InputError
        If the seed is negative or the kind is unknown.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"The seed of a case must be a whole number >= 0, got {seed!r}.")
    if kind is not None and kind not in KINDS:
        raise InputError(f"There are no cases of the kind {kind!r}; use one of {', '.join(KINDS)}.")
    streams = np.random.SeedSequence(seed).spawn(4)
    body, choice, size, off = (np.random.default_rng(stream) for stream in streams)
    anatomy = _anatomy(body)
    constants = Constants(
        log_uniform(body, 7, 14), log_uniform(body, 20, 50), log_uniform(body, 50, 120)
    )
    loads = tuple(load for load in _loads(body, anatomy) if load.axis == "y" or not one_direction)
    noise = round(body.uniform(0.25, 0.3), 2)
    drawn = str(choice.choice(list(KINDS), p=list(KINDS.values())))
    chosen = kind or drawn
    causes = tuple(cause.draw(size, anatomy) for cause in _classes(chosen, choice))
    deviations = draw_deviations(world, off, len(loads))
    return Truth(seed, chosen, causes, anatomy, constants, loads, noise, deviations)


def _classes(kind: str, rng: np.random.Generator) -> tuple[type[Cause], ...]:
    if kind == CONTROL:
        return ()
    return _different(TOGETHER[kind], rng) if kind in TOGETHER else (BY_KIND[kind],)


def _different(count: int, rng: np.random.Generator) -> tuple[type[Cause], ...]:
    """Draw causes from the catalogue whose effects all differ."""
    while True:
        causes = tuple(SINGLES[n] for n in rng.choice(len(SINGLES), count, replace=False))
        if len({cause.effect for cause in causes}) == count:
            return causes


def _anatomy(rng: np.random.Generator) -> Anatomy:
    return Anatomy(
        seed=int(rng.integers(2**31)),
        lower_mm=round(rng.uniform(55, 75), 1),
        upper_mm=round(rng.uniform(65, 95), 1),
        half_width_mm=round(rng.uniform(40, 50), 1),
        depth_mm=round(rng.uniform(46, 60), 1),
        compartments=int(rng.integers(40, 80)),
        glandular_fraction=round(rng.uniform(0.15, 0.28), 3),
    )


def _loads(rng: np.random.Generator, anatomy: Anatomy) -> list[Load]:
    """Return two forces for each axis, proportional to the compressed section."""
    length, width, depth = (2 * h for h in anatomy.half_mm)
    section = {"y": length * depth / (160 * 53), "x": width * depth / (90 * 53)}
    return [
        Load(axis, round(force * section[axis] * rng.uniform(0.9, 1.1), 2))
        for axis in AXES
        for force in FORCES_N[axis]
    ]
