"""Estimate of the force that presses a breast to a thickness, without solving its equilibrium.

The body is cut into columns along the compression. A column of length L between plates that are t
apart is pressed to the stretch t / L and carries its section times the nominal stress of its
tissue, which keeps its volume (J = 1). Shorter columns carry nothing. Two stresses are bounds:

- free: the column widens such that its energy W is least, ``P = dW/dt`` with W minimised over the
  stretch along z, where the fibres resist;
- held: it widens across alone, as between fibres that cannot stretch (plane strain).

For neo-Hookean tissue of shear modulus mu and the stretch s, the free stress without fibres is
``mu (1/s^2 - s)``, the held one ``mu (1/s^3 - s)``.

Columns do not drag their neighbours along, and may lean, so neither sum is a strict bound. In 32
simulated pairs (phantoms of 250 and 445 ml in voxels of 2 mm, 5 to 150 N, straight and oblique,
constants at both ends of the usual intervals, with and without fibres), the force was 0.76 to 2.4
times the free sum of the softest tissue and 0.37 to 1.39 times the held sum of the mean tissue in
median slices. `LEAST_SHARE` and `MOST_SHARE` were chosen from these pairs, with room to both.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from palpate.storage.values import FloatArray, Tissue
from palpate.workers.mechanics.fem.boundary_value_problem import Constants
from palpate.workers.organs.breast.scan_facts import BreastFacts, PlateLoad, Scan, plate_frame
from palpate.workers.organs.plausibility_rule import Finding

# Share of the free force of the softest tissues below which, and of the held force of the stiffest
# ones above which, a stated force is refused.
LEAST_SHARE, MOST_SHARE = 0.5, 1.6
# The same where the model may lack what resists: springs at the chest wall, skin, friction. In 18
# cases with hidden causes, the force is 1.0 to 3.6 times the held sum.
MOST_SHARE_WITH_EFFECTS = 5.0
# Error of a thickness, or a voxel.
SLACK_MM = 2.0
# Stretches at which stresses are tabulated, and the stretches along z that are compared.
STRETCHES = np.linspace(0.15, 1.0, 171)
WIDENINGS = 81


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of a body along the compression.

    Parameters
    ----------
    length_mm : ndarray, shape (n,)
    section_mm2 : float
        Section of each column.
    """

    length_mm: FloatArray
    section_mm2: float

    def force_n(self, distance_mm: float, stress_mpa: FloatArray) -> float:
        """Return the force at a distance of the plates for stresses at `STRETCHES`."""
        stretch = np.minimum(distance_mm / self.length_mm, 1.0)
        return float(self.section_mm2 * np.interp(stretch, STRETCHES, stress_mpa).sum())

    def distance_mm(self, force_n: float, stress_mpa: FloatArray) -> float:
        """Return the distance to which a force presses the plates, by bisection."""
        low, high = 0.0, float(self.length_mm.max())
        while high - low > 0.05:
            middle = (low + high) / 2
            if self.force_n(middle, stress_mpa) > force_n:
                low = middle
            else:
                high = middle
        return (low + high) / 2


def columns_of(scan: Scan) -> Columns:
    """Return the columns of a body along the compression of its scan."""
    points, _, step = scan.sample
    frame = plate_frame(scan.axis)
    u, along, z = (points @ frame.T).T
    width_u, width_along, _ = np.abs(frame) @ step
    across = np.rint((u - u.min()) / width_u).astype(np.intp)
    depth = np.rint((z - z.min()) / step[2]).astype(np.intp)
    number = across * (int(depth.max()) + 1) + depth
    low, high = np.full(int(number.max()) + 1, np.inf), np.full(int(number.max()) + 1, -np.inf)
    np.minimum.at(low, number, along)
    np.maximum.at(high, number, along)
    there = np.isfinite(low)
    return Columns((high - low)[there] + width_along, float(width_u * step[2]))


def free_stress_mpa(tissue: Constants) -> FloatArray:
    """Return the nominal pressure at `STRETCHES` of a column that widens freely."""
    share = np.linspace(0.0, 0.5, WIDENINGS)[:, None]
    along_z = STRETCHES**-share
    energy = (_energy(tissue, along_z) + _fibre_energy(tissue, along_z)).min(axis=0)
    return _pressure(energy)


def held_stress_mpa(tissues: Iterable[tuple[float, Constants]]) -> FloatArray:
    """Return the nominal pressure at `STRETCHES` in plane strain, the mean by shares of volume."""
    energy = sum(
        (share * _energy(tissue, np.ones_like(STRETCHES)) for share, tissue in tissues),
        np.zeros_like(STRETCHES),
    )
    return _pressure(energy)


def _pressure(energy: FloatArray) -> FloatArray:
    return np.maximum(-np.gradient(energy, STRETCHES, edge_order=2), 0.0)


def _energy(tissue: Constants, along_z: FloatArray) -> FloatArray:
    """Return the energy without fibres of a column that keeps its volume."""
    across = 1 / (STRETCHES * along_z)
    if tissue.law is None:
        return tissue.mu_mpa / 2 * (STRETCHES**2 + across**2 + along_z**2 - 3)
    F = np.zeros((*along_z.shape, 3, 3))
    F[..., 0, 0], F[..., 1, 1], F[..., 2, 2] = across, STRETCHES, along_z
    return np.asarray(tissue.law.energy(F))


def _fibre_energy(tissue: Constants, along_z: FloatArray) -> FloatArray:
    return tissue.fibre_mpa / 2 * (along_z**2 - 1) ** 2


SOLID = (Tissue.FAT, Tissue.GLANDULAR)


def check_pressed_thickness(facts: BreastFacts) -> Iterator[Finding]:
    """Reject a force that cannot press the body to the thickness that its scan shows."""
    rest = facts.rest
    if rest is None:
        return
    gland = float(np.mean(rest.labels.values[rest.body] == Tissue.GLANDULAR))
    soft = np.min([free_stress_mpa(facts.softest[tissue]) for tissue in SOLID], axis=0)
    for scan, load in facts.pressed:
        if load.force_n is None:
            continue
        body = columns_of(replace(rest, axis=scan.axis))
        slack = max(SLACK_MM, scan.voxel_mm)
        thin, thick = scan.thickness_mm + slack, scan.median_thickness_mm - slack
        if load.force_n < LEAST_SHARE * body.force_n(thin, soft):
            least = min(1000 * facts.softest[tissue].young_mpa for tissue in SOLID)
            yield Finding("implausible", _too_weak(load, scan, body, soft, least))
        elif facts.stiffest:
            shares = zip((1 - gland, gland), (facts.stiffest[t] for t in SOLID), strict=True)
            hard = held_stress_mpa(shares)
            share = MOST_SHARE if facts.rigid_is_refused else MOST_SHARE_WITH_EFFECTS
            if load.force_n > share * body.force_n(thick, hard):
                most = max(1000 * facts.stiffest[tissue].young_mpa for tissue in SOLID)
                yield Finding("implausible", _too_strong(load, scan, body, hard, most))


def _too_weak(load: PlateLoad, scan: Scan, body: Columns, soft: FloatArray, least: float) -> str:
    force, before = load.force_n or 0.0, body.length_mm.max()
    return (
        f"{load.where}: {force:g} N cannot press {before:.1f} mm to {scan.thickness_mm:.1f} mm "
        f"({scan.file}) at E >= {least:g} kPa; it would press to about "
        f"{body.distance_mm(force, soft):.1f} mm. {_remedy(scan)} Or search below that stiffness."
    )


def _too_strong(load: PlateLoad, scan: Scan, body: Columns, hard: FloatArray, most: float) -> str:
    force, before = load.force_n or 0.0, body.length_mm.max()
    return (
        f"{load.where}: {force:g} N would press {before:.1f} mm to about "
        f"{body.distance_mm(force, hard):.1f} mm or less at E <= {most:g} kPa, but {scan.file} "
        f"shows {scan.thickness_mm:.1f} mm. {_remedy(scan)} Or search above that stiffness."
    )


def _remedy(scan: Scan) -> str:
    return (
        f"Give the force at which {scan.file} was made in N (1 daN is 10 N, 1 kgf 9.81 N, "
        "1 lbf 4.45 N)."
    )
