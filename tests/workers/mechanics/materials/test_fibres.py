"""Stress and slackness of fibres."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from tests.workers.mechanics.materials.fibre_laws import Fibres
from tests.workers.mechanics.materials.laws_at_hand import ALONG, FIBRES, deformations

Z = np.array([0.0, 0.0, 1.0])
A = ALONG / np.linalg.norm(ALONG)


def test_stress_along_the_fibre_matches_the_closed_form():
    """W = eta/2 (l^2 - 1)^2, P = 2 eta (l^2 - 1) l, dP/dl = 2 eta (3 l^2 - 1)."""
    l, eta = 1.3, 0.02
    law, F = Fibres(eta, 5 * Z), np.diag([0.9, 0.8, l])
    assert law.energy(F) == pytest.approx(eta / 2 * (l**2 - 1) ** 2, rel=1e-14)
    expected = np.zeros((3, 3))
    expected[2, 2] = 2 * eta * (l**2 - 1) * l
    np.testing.assert_allclose(law.stress(F), expected, rtol=1e-14, atol=1e-18)
    assert law.tangent(F)[2, 2, 2, 2] == pytest.approx(2 * eta * (3 * l**2 - 1), rel=1e-14)


@pytest.mark.parametrize("isochoric", [False, True])
def test_stiffness_at_small_strains_is_four_eta(isochoric):
    """P = 4 eta (a.e.a) a a; of the deviators of e and a a when isochoric."""
    law = Fibres(0.02, ALONG, tension_only=False, isochoric=isochoric)
    dyad = np.outer(A, A) - (np.eye(3) / 3 if isochoric else 0)
    expected = 4 * 0.02 * np.einsum("iJ,kL->iJkL", dyad, dyad)
    np.testing.assert_allclose(law.tangent(np.eye(3)), expected, atol=1e-16)


@pytest.mark.parametrize("isochoric", [False, True])
def test_short_fibres_are_slack_in_tension_only(isochoric):
    F = deformations()
    law = Fibres(0.02, ALONG, isochoric=isochoric)
    literal = Fibres(0.02, ALONG, tension_only=False, isochoric=isochoric)
    J = np.linalg.det(F) if isochoric else 1.0
    I4 = J ** (-2 / 3) * np.square(F @ A).sum(axis=1)
    short, long = I4 < 1 - 1e-9, I4 > 1 + 1e-9
    assert short.sum() > 5
    assert long.sum() > 5
    for f, g in (
        (law.energy, literal.energy),
        (law.stress, literal.stress),
        (law.tangent, literal.tangent),
    ):
        assert not f(F[short]).any()
        np.testing.assert_array_equal(f(F[long]), g(F[long]))
    np.testing.assert_allclose(literal.energy(F), 0.01 * (I4 - 1) ** 2, rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize("name", FIBRES)
def test_accepts_one_direction_per_point(name):
    F = deformations()
    directions = np.random.default_rng(5).standard_normal((len(F), 3))
    kind = {"tension_only": FIBRES[name].tension_only, "isochoric": FIBRES[name].isochoric}
    law = Fibres(0.02, directions, **kind)
    for i in range(0, len(F), 7):
        alone = Fibres(0.02, directions[i], **kind)
        np.testing.assert_allclose(law.energy(F)[i], alone.energy(F[i]), rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(law.stress(F)[i], alone.stress(F[i]), rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(law.tangent(F)[i], alone.tangent(F[i]), rtol=1e-12, atol=1e-17)


@pytest.mark.parametrize("name", FIBRES)
def test_accepts_many_directions_with_one_deformation(name):
    kind = {"tension_only": FIBRES[name].tension_only, "isochoric": FIBRES[name].isochoric}
    F, directions = deformations()[20], np.eye(3)
    law = Fibres(0.02, directions, **kind)
    assert law.energy(F).shape == (3,)
    assert law.tangent(F).shape == (3, 3, 3, 3, 3)
    alone = Fibres(0.02, directions[1], **kind)
    np.testing.assert_allclose(law.tangent(F)[1], alone.tangent(F), rtol=1e-12, atol=1e-17)


def test_directions_are_copied_and_read_only():
    given = 2 * Z
    law = Fibres(0.02, given)
    given[:] = 0
    np.testing.assert_array_equal(law.directions, Z)
    with pytest.raises(ValueError, match="read-only"):
        law.directions[0] = 1


@pytest.mark.parametrize(
    ("eta", "directions", "words"),
    [
        (-0.1, Z, "eta >= 0 MPa, got -0.1"),
        (0.1, np.zeros(4), r"shape \(..., 3\), got \(4,\)"),
        (0.1, np.array(1.0), r"got \(\)"),
        (0.1, np.array([Z, 0 * Z, np.nan * Z]), "2 of 3 fibre directions have zero length"),
    ],
)
def test_rejects_invalid_fibres(eta, directions, words):
    with pytest.raises(InputError, match=words):
        Fibres(eta, directions)
