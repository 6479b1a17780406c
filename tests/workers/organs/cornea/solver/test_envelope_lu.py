"""Factors within the envelope against dense linear algebra."""

import numpy as np
import pytest

from palpate.workers.organs.cornea.envelope_lu import envelope_of, factorise, new_values, node_order
from tests.workers.organs.cornea.solver.structured_t6 import corneal_arc


def random_band(n, reach, seed):
    """Return a matrix of overlapping groups of unknowns, unsymmetric, with a strong diagonal."""
    rng = np.random.default_rng(seed)
    groups = np.array([rng.permutation(np.arange(k, k + reach)) for k in range(n - reach + 1)])
    A = np.zeros((n, n))
    for group in groups:
        A[np.ix_(group, group)] += rng.normal(size=(reach, reach))
    return groups.astype(np.int32), A + 3 * reach * np.diag(np.sign(rng.normal(size=n) + 0.8))


def stored(envelope, A):
    values = new_values(envelope)
    for i, j in np.argwhere(A):
        values[envelope.row_starts[i] + j] = A[i, j]
    return values


@pytest.mark.parametrize(("n", "reach"), [(1, 1), (8, 3), (37, 5), (64, 20), (200, 31)])
def test_solution_matches_dense_algebra(n, reach):
    groups, A = random_band(n, reach, seed=n)
    envelope = envelope_of(groups, n)
    factors = factorise(envelope, stored(envelope, A), n)
    b = np.random.default_rng(1).normal(size=(3, n))
    np.testing.assert_allclose(factors.solve(b), np.linalg.solve(A, b.T).T, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(factors.solve(b[0]), np.linalg.solve(A, b[0]), rtol=1e-9, atol=1e-12)
    assert not factors.singular


def test_counts_negative_eigenvalues_of_a_symmetric_matrix():
    groups, A = random_band(90, 9, seed=3)
    A = A + A.T
    envelope = envelope_of(groups, 90)
    factors = factorise(envelope, stored(envelope, A), 90)
    expected = int((np.linalg.eigvalsh(A) < 0).sum())
    assert expected > 0
    assert factors.negative_pivots == expected


def test_reports_a_singular_matrix():
    groups, A = random_band(30, 6, seed=4)
    A[17] = A[16] = 0
    A[:, 17] = A[:, 16] = 0
    envelope = envelope_of(groups, 30)
    assert factorise(envelope, stored(envelope, A), 30).singular


def test_groups_without_unknowns_are_skipped():
    groups = np.array([[-1, -1, -1], [0, 1, -1], [1, 2, 3]], dtype=np.int32)
    envelope = envelope_of(groups, 4)
    A = np.array([[2.0, 1, 0, 0], [0, 3, 1, 1], [0, 1, 4, 1], [0, 2, 1, 5]])
    factors = factorise(envelope, stored(envelope, A), 4)
    b = np.arange(4.0)
    np.testing.assert_allclose(factors.solve(b), np.linalg.solve(A, b))


def test_ordering_keeps_neighbours_close():
    mesh = corneal_arc(120, 4)
    place = np.empty(len(mesh.nodes_mm), dtype=int)
    place[node_order(mesh.triangles, len(mesh.nodes_mm))] = np.arange(len(mesh.nodes_mm))
    # A triangle spans three columns of nine nodes; one more where the ordering starts.
    assert np.ptp(place[mesh.triangles], axis=1).max() <= 36
