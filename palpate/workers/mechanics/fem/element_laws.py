r"""Laws of the elements: constants averaged over tissues, growth, barrier against collapse.

Constants of an element are averaged over the tissues in it. Tissue that has grown to g times its
volume, with :math:`F = F_e F_g`, :math:`F_g = g^{1/3} 1` (E. K. Rodriguez, A. Hoger,
A. D. McCulloch, J. Biomech. 27 (1994) 455), stores g times the energy of :math:`F_e`. Isochoric
invariants do not change, so its moduli grow by g, its nodes are at rest at v / V = g with a bulk
modulus of 1 / g, and fibres are shorter by :math:`g^{-1/3}` as measured by F.

Elements may have any law of `workers.mechanics.materials` (`LawElements`); that is slower than the
compiled kernels of `tangent_assembly`.

A barrier prevents the collapse of elements, which the nodal average alone would permit. Below
:math:`J_b`, half of the volume at rest, each element stores

.. math:: W_b = 100 \mu \, (1 - J / J_b)^3 ,

with mu the shear modulus at rest, whatever the law. It is twice continuously differentiable, and
zero where no element loses half of its volume. With :math:`C_a = \mathrm{cof}(F) \, g_a`, the
gradient of J in the position of node a, its force is :math:`V W_b' C_a` and its tangent
:math:`V (W_b'' C_a \otimes C_b - W_b' [F (g_a \times g_b)]_\times)`.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray, IntArray, Tissue
from palpate.workers.kernels_and_threads import CONTRACTED, Float32Array
from palpate.workers.mechanics.fem.boundary_value_problem import (
    Constants,
    Inclusion,
    Problem,
    elements_reached,
    stiffness_factors,
)
from palpate.workers.mechanics.fem.discretisation import LevelModel
from palpate.workers.mechanics.fem.element_energy import (
    ElementMaterial,
    Elements,
    deformation_gradients,
    volume_ratios,
)
from palpate.workers.mechanics.materials.elastic_law import Isochoric


@dataclass(frozen=True, eq=False)
class LawElements:
    """Elements, shape (k,), whose matrix follows `law`, with factors on it, shape (k,)."""

    law: Isochoric
    elements: IntArray
    weight: FloatArray


@dataclass(frozen=True, eq=False)
class ElementConstants:
    """Material constants of the elements.

    Parameters
    ----------
    problem : Problem
        The problem they were computed for.
    material : ElementMaterial
    laws : tuple of LawElements
        Elements whose matrix follows another law.
    density : ndarray, shape (m,)
        In t/mm^3 of the undeformed body.
    nodal_growth : ndarray, shape (n,)
        Volume ratio v_n / V_n at which each node has no pressure.
    """

    problem: Problem
    material: ElementMaterial
    laws: tuple[LawElements, ...]
    density: FloatArray
    nodal_growth: FloatArray


def element_constants(
    model: LevelModel, problem: Problem, similar: ElementConstants | None = None
) -> ElementConstants:
    """Average the constants of the tissues over each element, by volume.

    Constants shared with `similar`, of another problem on the same mesh, are reused.

    Raises
    ------
    InputError
        If the mesh contains a tissue that has no constants.
    """
    if similar is not None and _material_parts(problem) == _material_parts(similar.problem):
        return similar
    _check_tissues(model, problem)
    if similar is not None and _differ_in_places(problem, similar.problem):
        return _changed_in_places(model, problem, similar)
    part = model.fractions
    if similar is not None and _fibre_parts(problem) == _fibre_parts(similar.problem):
        fibre = similar.material.fibre
    else:
        fibre = _directions(model, problem)
    stiff = _stiffnesses(model, problem)
    growth = growth_of(problem, part)
    material = ElementMaterial(
        **_moduli(problem, stiff, growth),
        fibre=fibre,
        tension_only=not problem.literal_fibre,
        isochoric_fibre=problem.isochoric_fibre,
        plain=problem.plain_elements,
    )
    density = part @ _column(problem, part, "density_t_per_mm3")
    laws = tuple(_laws(problem, stiff * growth))
    return ElementConstants(problem, material, laws, density, _at_nodes(model, part @ (growth - 1)))


def _changed_in_places(
    model: LevelModel, problem: Problem, similar: ElementConstants
) -> ElementConstants:
    """Return `similar` with the stiffness updated where the variations differ."""
    now, before = _inclusions(problem), _inclusions(similar.problem)
    differ = (now - before) + (before - now)
    reached = elements_reached(differ, model.nodes, model.elements.tets, model.centroids)
    there = np.flatnonzero(reached).astype(np.int32)
    stiff = _stiffnesses(model, problem, there)
    growth = growth_of(problem, model.fractions)
    moduli = {}
    for name, values in _moduli(problem, stiff, growth).items():
        moduli[name] = getattr(similar.material, name).copy()
        moduli[name][there] = values
    return replace(similar, problem=problem, material=similar.material._replace(**moduli))


def _stiffnesses(
    model: LevelModel, problem: Problem, elements: IntArray | None = None
) -> FloatArray:
    """Return the stiffness-weighted share of each tissue in all or some of the elements."""
    part, tets = model.fractions, model.elements.tets
    if elements is not None:
        part, tets = part[elements], tets[elements]
    if not problem.variations:
        return part
    factors = stiffness_factors(problem.variations, model.nodes, tets, part.shape[1])
    return np.asarray(part * factors)


def shear_moduli_mpa(model: LevelModel, problem: Problem) -> FloatArray:
    """Return the shear modulus at rest of each element in MPa, whatever its law."""
    part = model.fractions
    values = np.zeros(part.shape[1])
    for tissue, c in _known(problem, part):
        values[tissue] = c.mu_mpa if c.law is None else c.law.shear_modulus_mpa
    return np.asarray((_stiffnesses(model, problem) * growth_of(problem, part)) @ values)


def _moduli(problem: Problem, part: FloatArray, growth: FloatArray) -> dict[str, FloatArray]:
    """Return the moduli of elements with these shares of tissues, shape (m, tissues)."""
    soft, stiff = part / growth, part * growth
    eta = [_column(problem, part, "fibre_mpa"), _column(problem, part, "second_fibre_mpa")]
    return {
        "mu": stiff @ _column(problem, part, "mu_mpa", matrix=True),
        "c2": stiff @ _yeoh(problem, part),
        "kappa": soft @ _column(problem, part, "kappa_mpa"),
        "eta": np.stack([stiff @ e for e in eta[: _fibre_families(problem)]], axis=1),
    }


def _differ_in_places(p: Problem, q: Problem) -> bool:
    """Test whether only inclusions differ, and no law keeps its own weights."""
    balls = all(_inclusions(x).total() == len(x.variations) for x in (p, q))
    laws = any(c.law is not None for c in p.constants.values())
    alike = _material_parts(replace(p, variations=())) == _material_parts(replace(q, variations=()))
    return balls and alike and not laws


def _inclusions(p: Problem) -> Counter[Inclusion]:
    """Return the inclusions among the variations of the stiffness."""
    return Counter(v for v in p.variations if isinstance(v, Inclusion))


def _material_parts(p: Problem) -> tuple[object, ...]:
    """Return the parts of a problem that determine the constants of the elements."""
    kinds = p.literal_fibre, p.isochoric_fibre, p.plain_elements
    return dict(p.constants), p.variations, p.fibres, kinds


def _fibre_parts(p: Problem) -> tuple[object, ...]:
    """Return the parts of a problem that determine the fibre directions."""
    growth = {tissue: c.growth for tissue, c in p.constants.items()}
    return p.fibres, _fibre_families(p), p.isochoric_fibre, growth


def growth_of(problem: Problem, part: FloatArray) -> FloatArray:
    """Return the growth V / V0 of each tissue that a mesh with these shares may have."""
    values = np.ones(part.shape[1])
    for tissue, c in _known(problem, part):
        values[tissue] = c.growth
    return values


def _at_nodes(model: LevelModel, more: FloatArray) -> FloatArray:
    """Return the volume ratio at rest of each node; elements grow by the fraction `more`, (m,)."""
    if not more.any():
        return np.ones(len(model.nodes))
    share = np.repeat(model.elements.volumes * more / 4, 4)
    total = np.bincount(model.elements.tets.ravel(), share, len(model.nodes))
    return np.asarray(1 + total / model.nodal_volumes)


def _fibre_families(p: Problem) -> int:
    """Return the number of fibre families."""
    return 2 if any(c.second_fibre_mpa for c in p.constants.values()) else 1


def _directions(model: LevelModel, problem: Problem) -> FloatArray:
    """Return vectors along the fibres, of length 1 where nothing grows, (m, families, 3)."""
    centroids = model.centroids
    directions = [problem.fibres.directions(centroids)]
    if _fibre_families(problem) == 2:
        directions.append(problem.fibres.second_directions(centroids))
    along = np.ascontiguousarray(np.stack(directions, axis=1))
    growth = growth_of(problem, model.fractions)
    if not problem.isochoric_fibre and (growth != 1).any():
        along *= (1 + model.fractions @ (growth - 1))[:, None, None] ** (-1 / 3)
    return along


def _laws(problem: Problem, stiff: FloatArray) -> Iterator[LawElements]:
    """Yield the elements of each tissue that has a law of its own."""
    for tissue, c in problem.constants.items():
        if c.law is not None and tissue < stiff.shape[1]:
            inside = np.flatnonzero(stiff[:, tissue] > 0).astype(np.int32)
            if len(inside):
                yield LawElements(c.law, inside, np.ascontiguousarray(stiff[inside, tissue]))


def _column(problem: Problem, part: FloatArray, name: str, *, matrix: bool = False) -> FloatArray:
    """Return one constant of each tissue; for the matrix, zero where another law replaces it."""
    values = np.zeros(part.shape[1])
    for tissue, c in _known(problem, part):
        values[tissue] = 0.0 if matrix and c.law is not None else getattr(c, name)
    return values


def _yeoh(problem: Problem, part: FloatArray) -> FloatArray:
    """Return c2 of each tissue, zero where another law replaces it."""
    values = np.zeros(part.shape[1])
    for tissue, c in _known(problem, part):
        values[tissue] = 0.0 if c.law is not None else c.stiffening * c.mu_mpa
    return values


def _known(problem: Problem, part: FloatArray) -> Iterator[tuple[Tissue, Constants]]:
    """Yield the tissues that this mesh may have, with their constants."""
    for tissue, c in problem.constants.items():
        if tissue < part.shape[1]:
            yield tissue, c


def _check_tissues(model: LevelModel, problem: Problem) -> None:
    """Raise InputError if a tissue in the mesh has no constants."""
    present = np.flatnonzero(model.fractions.sum(axis=0) > 0)
    tissues = [Tissue(int(t)) for t in present]
    missing = [t.name.lower() for t in tissues if t not in problem.constants]
    if missing:
        raise InputError(f"The mesh contains {', '.join(missing)}, but no constants were given.")


def law_energy(x: FloatArray, elements: Elements, part: LawElements) -> float:
    """Return the energy of the matrix of these elements in mJ; nan where one is inverted."""
    chosen = _restricted(elements, part)
    density = part.law.energy(deformation_gradients(x, chosen))
    return float((chosen.volumes * part.weight) @ density)


def law_assemble(
    x: FloatArray,
    elements: Elements,
    part: LawElements,
    edge: IntArray,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add force, (n, 3) in N, and tangent to K, (edges, 9), unless it is empty."""
    chosen = _restricted(elements, part)
    F = deformation_gradients(x, chosen)
    weight = chosen.volumes * part.weight
    P = part.law.stress(F) * weight[:, None, None]
    A = np.empty((0, 3, 3, 3, 3))
    if len(K):
        A = part.law.tangent(F) * weight[:, None, None, None, None]
    _integrate(chosen.tets, chosen.gradients, P, A, edge[part.elements], force, K)


def _restricted(elements: Elements, part: LawElements) -> Elements:
    """Return only the elements of one law."""
    e = part.elements
    return Elements(elements.tets[e], elements.gradients[e], elements.volumes[e])


@njit(**CONTRACTED)
def _integrate(
    tets: IntArray,
    gradients: FloatArray,
    P: FloatArray,
    A: FloatArray,
    edge: IntArray,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add the force of stresses P, (m, 3, 3), and the tangent of moduli A, (m, 3, 3, 3, 3)."""
    g = np.empty((4, 3))
    for e in range(tets.shape[0]):
        for j in range(3):
            g[1, j] = gradients[e, 0, j]
            g[2, j] = gradients[e, 1, j]
            g[3, j] = gradients[e, 2, j]
            g[0, j] = -(g[1, j] + g[2, j] + g[3, j])
        for a in range(4):
            for i in range(3):
                for j in range(3):
                    force[tets[e, a], i] += P[e, i, j] * g[a, j]
        if A.shape[0] == 0:
            continue
        for a in range(4):
            for b in range(4):
                for i in range(3):
                    for k in range(3):
                        value = 0.0
                        for j in range(3):
                            for m in range(3):
                                value += g[a, j] * A[e, i, j, k, m] * g[b, m]
                        K[edge[e, a, b], 3 * i + k] += value


# Volume ratio at which the barrier begins, and ratio of its stiffness to the shear modulus.
J_BARRIER = 0.5
BARRIER_STIFFNESS = 100.0


class Barrier(NamedTuple):
    """Barrier of all elements.

    Parameters
    ----------
    stiffness_mpa : ndarray, shape (m,)
        100 mu.
    j : float
        Volume ratio at which it begins.
    """

    stiffness_mpa: FloatArray
    j: float


def barrier_of(model: LevelModel, problem: Problem) -> Barrier:
    """Return the barrier of a mesh; in shrunken tissue it begins below the tissue's own volume."""
    j = J_BARRIER * min(1.0, float(growth_of(problem, model.fractions).min()))
    return Barrier(BARRIER_STIFFNESS * shear_moduli_mpa(model, problem), j)


def barrier_energy(x: FloatArray, elements: Elements, barrier: Barrier) -> float:
    """Return the energy of the barrier in mJ."""
    J = volume_ratios(x, elements)
    closed = np.maximum(1 - J / barrier.j, 0.0)
    return float((elements.volumes * barrier.stiffness_mpa) @ closed**3)


def barrier_stress_mpa(J: FloatArray, barrier: Barrier) -> FloatArray:
    """Return dW_b/dJ of each element, shape (m,): zero or negative."""
    closed = np.maximum(1 - J / barrier.j, 0.0)
    return np.asarray(-3 / barrier.j * barrier.stiffness_mpa * closed**2)


@njit(**CONTRACTED)
def barrier_assemble(
    x: FloatArray,
    elements: Elements,
    barrier: Barrier,
    edge: IntArray,
    convex: bool,
    force: FloatArray,
    K: Float32Array,
) -> None:
    """Add force, (n, 3) in N, and tangent to K, (edges, 9), unless it is empty.

    `convex` omits the geometric stiffness, which may be negative.
    """
    tets = elements.tets
    F, C = deformation_gradients(x, elements), np.empty((3, 3))
    g, c = np.empty((4, 3)), np.empty((4, 3))
    for e in range(tets.shape[0]):
        for i in range(3):
            p, q = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                r, s = (j + 1) % 3, (j + 2) % 3
                C[i, j] = F[e, p, r] * F[e, q, s] - F[e, p, s] * F[e, q, r]
        J = F[e, 0, 0] * C[0, 0] + F[e, 0, 1] * C[0, 1] + F[e, 0, 2] * C[0, 2]
        closed = 1.0 - J / barrier.j
        if closed <= 0.0:
            continue
        rate = 3.0 / barrier.j * elements.volumes[e] * barrier.stiffness_mpa[e] * closed
        first, second = -rate * closed, 2.0 / barrier.j * rate
        for j in range(3):
            g[1, j] = elements.gradients[e, 0, j]
            g[2, j] = elements.gradients[e, 1, j]
            g[3, j] = elements.gradients[e, 2, j]
            g[0, j] = -(g[1, j] + g[2, j] + g[3, j])
        for a in range(4):
            for i in range(3):
                c[a, i] = C[i, 0] * g[a, 0] + C[i, 1] * g[a, 1] + C[i, 2] * g[a, 2]
                force[tets[e, a], i] += first * c[a, i]
        if K.shape[0] == 0:
            continue
        for a in range(4):
            for b in range(4):
                for i in range(3):
                    for k in range(3):
                        K[edge[e, a, b], 3 * i + k] += second * c[a, i] * c[b, k]
                if convex or a == b:
                    continue
                for k in range(3):
                    w = 0.0
                    for j in range(3):
                        r, s = (j + 1) % 3, (j + 2) % 3
                        w += F[e, k, j] * (g[a, r] * g[b, s] - g[a, s] * g[b, r])
                    # -[w]_x has w_k at (i, j) and -w_k at (j, i), in cyclic order.
                    i, j = (k + 1) % 3, (k + 2) % 3
                    K[edge[e, a, b], 3 * i + j] += first * w
                    K[edge[e, a, b], 3 * j + i] -= first * w
