"""What each element of a mesh is made of, from the constants of its tissues."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from storage.errors import InputError
from storage.values import FloatArray, IntArray, Tissue
from workers.fem.fields import stiffness_factors
from workers.fem.kernels import Matter
from workers.fem.model import LevelModel
from workers.fem.problem import Constants, Problem
from workers.materials.base import Isochoric


@dataclass(frozen=True, eq=False)
class LawShare:
    """Elements, shape (k,), whose matrix follows `law`, with a factor on it, shape (k,)."""

    law: Isochoric
    elements: IntArray
    weight: FloatArray


@dataclass(frozen=True, eq=False)
class Composition:
    """Constants of the elements, the laws of some, and the density of all, (m,) in t/mm^3.

    ``problem`` is the one that it was made for.
    """

    problem: Problem
    matter: Matter
    laws: tuple[LawShare, ...]
    density: FloatArray


def compose(model: LevelModel, problem: Problem, like: Composition | None = None) -> Composition:
    """Average the constants of the tissues over each element, by volume.

    What `like`, a composition of the same mesh, has in common is taken from it.

    Raises
    ------
    InputError
        If the mesh contains a tissue that has no constants.
    """
    if like is not None and _matter_of(problem) == _matter_of(like.problem):
        return like
    _check(model, problem)
    part = model.fractions
    nodes, tets = model.nodes, model.elements.tets
    if problem.variations:
        factors = stiffness_factors(problem.variations, nodes, tets, part.shape[1])
        stiff = np.asarray(part * factors)
    else:
        stiff = part
    two = _families(problem) == 2
    if like is not None and _fibres_of(problem) == _fibres_of(like.problem):
        fibre = like.matter.fibre
    else:
        fibre = _directions(model, problem)
    eta = [_column(problem, part, "fibre_mpa"), _column(problem, part, "second_fibre_mpa")]
    matter = Matter(
        mu=stiff @ _column(problem, part, "mu_mpa", matrix=True),
        c2=stiff @ _yeoh(problem, part),
        kappa=stiff @ _column(problem, part, "kappa_mpa"),
        eta=np.stack([stiff @ e for e in eta[: 1 + two]], axis=1),
        fibre=fibre,
        tension_only=not problem.literal_fibre,
        isochoric_fibre=problem.isochoric_fibre,
        plain=problem.plain_elements,
    )
    density = part @ _column(problem, part, "density_t_per_mm3")
    return Composition(problem, matter, tuple(_laws(problem, stiff)), density)


def _matter_of(p: Problem) -> tuple[object, ...]:
    """All that a composition depends on."""
    kinds = p.literal_fibre, p.isochoric_fibre, p.plain_elements
    return dict(p.constants), p.variations, p.fibres, kinds


def _fibres_of(p: Problem) -> tuple[object, ...]:
    return p.fibres, _families(p)


def _families(p: Problem) -> int:
    return 2 if any(c.second_fibre_mpa for c in p.constants.values()) else 1


def _directions(model: LevelModel, problem: Problem) -> FloatArray:
    """Unit vectors along the fibres, shape (m, families, 3)."""
    centroids = model.nodes[model.elements.tets].mean(axis=1)
    found = [problem.fibres.directions(centroids)]
    if _families(problem) == 2:
        found.append(problem.fibres.second_directions(centroids))
    return np.ascontiguousarray(np.stack(found, axis=1))


def _laws(problem: Problem, stiff: FloatArray) -> Iterator[LawShare]:
    for tissue, c in problem.constants.items():
        if c.law is not None and tissue < stiff.shape[1]:
            inside = np.flatnonzero(stiff[:, tissue] > 0).astype(np.int32)
            if len(inside):
                yield LawShare(c.law, inside, np.ascontiguousarray(stiff[inside, tissue]))


def _column(problem: Problem, part: FloatArray, name: str, *, matrix: bool = False) -> FloatArray:
    """One constant of each tissue; of the matrix, zero where another law stands for it."""
    values = np.zeros(part.shape[1])
    for tissue, c in _known(problem, part):
        values[tissue] = 0.0 if matrix and c.law is not None else getattr(c, name)
    return values


def _yeoh(problem: Problem, part: FloatArray) -> FloatArray:
    values = np.zeros(part.shape[1])
    for tissue, c in _known(problem, part):
        values[tissue] = 0.0 if c.law is not None else c.stiffening * c.mu_mpa
    return values


def _known(problem: Problem, part: FloatArray) -> Iterator[tuple[Tissue, Constants]]:
    for tissue, c in problem.constants.items():
        if tissue < part.shape[1]:
            yield tissue, c


def _check(model: LevelModel, problem: Problem) -> None:
    present = np.flatnonzero(model.fractions.sum(axis=0) > 0)
    tissues = [Tissue(int(t)) for t in present]
    missing = [t.name.lower() for t in tissues if t not in problem.constants]
    if missing:
        raise InputError(f"The mesh contains {', '.join(missing)}, but no constants say how stiff.")
