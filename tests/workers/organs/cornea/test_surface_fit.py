"""The least-squares problem of a cornea: derivatives, optimum, and information."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from palpate.service.search.least_squares_search import (
    FittedNames,
    LeastSquaresSearch,
    LeastSquaresSettings,
    places_in_fit,
)
from palpate.service.search.search_interface import FloatArray, Generation, Proposal, Space
from palpate.storage.values import FitJson, FreeParameter
from palpate.workers.common_keys import validated
from palpate.workers.organs.cornea.cornea_keys import CorneaCase
from palpate.workers.organs.cornea.cornea_organ import ORGAN
from palpate.workers.organs.cornea.identifiability import contour_of, information_of, law_names
from palpate.workers.organs.cornea.prestressed_equilibrium import sensitivity
from palpate.workers.organs.cornea.section_comparison import SIMULATED
from palpate.workers.organs.normal_equations import NormalEquations
from palpate.workers.tasks.pipeline import _normal_equations

X1 = {"mu1_pa": 11000.0, "alpha1": 30.0, "mu2_pa": 35000.0, "alpha2": 80.0}
NEAR = {"mu1_pa": 13000.0, "alpha1": 33.0, "mu2_pa": 33000.0, "alpha2": 78.0}
BOUNDS = {"mu1_pa": (1, 40e3), "alpha1": (0.1, 100), "mu2_pa": (1, 40e3), "alpha2": (0.1, 100)}


class Eye:
    """A mesh of 160 triangles and a target simulated with X1."""

    def __init__(self) -> None:
        case = {"organ": "cornea", "mesh": {"elements": 160}}
        self.case = validated(CorneaCase, case)
        self.body = ORGAN.make_body(self.case.reference)
        self.mesh = ORGAN.make_mesh(self.body, self.case)
        self.model = ORGAN.prepare(self.mesh)
        self.middle = ORGAN.landmarks(self.body, self.case)
        u = ORGAN.solve(self.model, self.problem(X1)).displacement_mm
        self.target = ORGAN.deform(self.body, self.mesh, u)
        self.observation = ORGAN.observation(self.body, self.mesh, self.target, False)

    def problem(self, constants: Mapping[str, float]) -> Any:
        return ORGAN.problem(self.model, self.case, self.values(constants), self.middle)

    def values(self, constants: Mapping[str, float]) -> dict[str, float]:
        return self.case.complete(self.case.parameters.from_door(constants))

    def free(self, bounds: Mapping[str, Any]) -> list[FreeParameter]:
        inside = self.case.parameters.bounds_from_door(bounds)
        return [{"name": n, "lower": lo, "upper": hi} for n, (lo, hi) in inside.items()]

    def fitted(self, constants: Mapping[str, float], bounds: Mapping[str, Any] = BOUNDS) -> Any:
        values, free = self.values(constants), self.free(bounds)
        return ORGAN.fit(self.model, self.case, values, free, self.middle, None, self.observation)

    def equations(
        self, constants: Mapping[str, float], bounds: Mapping[str, Any] = BOUNDS
    ) -> NormalEquations:
        residuals = self.fitted(constants, bounds).residuals
        assert residuals is not None
        return residuals.equations

    def fit_json(self, constants: Mapping[str, float]) -> FitJson | None:
        residuals = self.fitted(constants).residuals
        if residuals is None:
            return None
        return _normal_equations(residuals, self.values(constants), self.free(BOUNDS))


@pytest.fixture(scope="module")
def eye() -> Eye:
    return Eye()


def test_displacement_matches_the_solver(eye: Eye) -> None:
    solved = ORGAN.solve(eye.model, eye.problem(NEAR)).displacement_mm
    np.testing.assert_array_equal(eye.fitted(NEAR).solution.displacement_mm, solved)


@pytest.mark.parametrize("name", list(NEAR))
def test_gradient_matches_the_sum_of_squares(eye: Eye, name: str) -> None:
    """Except across the target's vertices, where the nearest point jumps."""
    h = 1e-4
    costs = [eye.equations(NEAR | {name: NEAR[name] * np.exp(s * h)}).cost for s in (1, -1)]
    gradient = eye.equations(NEAR).gradient[list(NEAR).index(name)]
    assert (costs[0] - costs[1]) / (4 * h) == pytest.approx(gradient, rel=1e-3)


def test_gradient_in_a_tilt_is_not_logarithmic(eye: Eye) -> None:
    h, bounds = 1e-3, {"eye_tilt_deg": (-2, 2)}
    at = [eye.equations(NEAR | {"eye_tilt_deg": 1 + s * h}, bounds) for s in (1, 0, -1)]
    per_degree = (at[0].cost - at[2].cost) / (4 * h)
    assert at[1].gradient[0] == pytest.approx(per_degree, rel=1e-3)


def test_gradient_in_the_compliance_of_a_held_limbus_matches_a_difference(eye: Eye) -> None:
    """By a forward difference, as the parameter cannot be negative."""
    name = "limbus_compliance_mm_per_kpa"
    bounds = {name: (0, 0.01)}
    h = 1e-6
    costs = [eye.equations(NEAR | {name: value}, bounds).cost for value in (h, 0.0)]
    per_mm_per_mpa = (costs[0] - costs[1]) / (2 * h) / 1000
    assert eye.equations(NEAR, bounds).gradient[0] == pytest.approx(per_mm_per_mpa, rel=0.05)


def test_information_matches_the_bounds(eye: Eye) -> None:
    """For a whole contour; the residuals exclude its clamped ends, which do not move."""
    candidate = eye.problem(X1)
    names = law_names(candidate.constants)
    contour = contour_of(candidate, sensitivity(candidate, names), names, None)
    gram = information_of(candidate, contour).gram_um2_mm
    fisher = gram / (SIMULATED.correlation_mm * SIMULATED.sd_um**2)
    np.testing.assert_allclose(eye.equations(X1).hessian, fisher, rtol=0.05)


def test_sum_of_squares_vanishes_at_the_truth(eye: Eye) -> None:
    """Up to the polygonal target surface: less than a hundredth of a micrometre."""
    residuals = eye.fitted(X1).residuals
    assert residuals is not None
    assert 1e3 * np.abs(residuals.mm).max() < 0.01


def test_swapped_terms_are_found_by_their_values() -> None:
    fit: Any = {"parameters": ["mu1", "alpha1", "mu2", "alpha2"], "values": [0.01, 30, 0.03, 80]}
    names = ("mu1", "alpha1", "mu2", "alpha2")
    assert places_in_fit(fit, names, np.array([0.01, 30, 0.03, 80])) == [0, 1, 2, 3]
    assert places_in_fit(fit, names, np.array([0.03, 80, 0.01, 30])) == [2, 3, 0, 1]
    alike = fit | {"values": [0.02, 30, 0.02, 80]}
    assert places_in_fit(alike, names, np.array([0.02, 30, 0.02, 80])) == [0, 1, 2, 3]


@pytest.fixture
def search() -> LeastSquaresSearch:
    names = FittedNames(("mu1", "alpha1", "mu2", "alpha2"), (1e6, 1.0, 1e6, 1.0))
    settings = LeastSquaresSettings(starts=1, evaluations=30)
    return LeastSquaresSearch(Space.from_bounds(BOUNDS), names, settings, seed=1)


def test_a_descent_over_crossing_terms_finds_the_shear_modulus(
    eye: Eye, search: LeastSquaresSearch
) -> None:
    """From terms in reverse order, and from a start that cannot be simulated."""
    for start in ([26e3, 75.0, 23e3, 64.0], [20.0, 2.0, 20.0, 2.0]):
        best = _descended(search, np.array([start]), eye.fit_json)
        shear_modulus_mpa = 0.5e-6 * (best[0] * best[1] + best[2] * best[3])
        assert shear_modulus_mpa == pytest.approx(1.565, rel=0.01)


def _descended(
    search: LeastSquaresSearch, starts: FloatArray, fit: Callable[..., FitJson | None]
) -> FloatArray:
    """Return the genes with the smallest sum of squares of a whole search."""
    history: list[Generation] = []
    best, least = starts[0], np.inf
    while isinstance(proposal := search.propose_from(starts, history), Proposal):
        fits = [fit(dict(zip(BOUNDS, map(float, genes), strict=True))) for genes in proposal.genes]
        for genes, found in zip(proposal.genes, fits, strict=True):
            if found is not None and found["cost"] < least:
                best, least = genes, found["cost"]
        scores = np.array([0.0 if found else np.inf for found in fits])
        history.append(Generation(proposal.genes, scores, tuple(fits)))
    return best
