"""The mesh of a section: area, surfaces, quality, and refusals of invalid sections."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import FloatArray
from palpate.workers.organs.cornea.section_mesh import T6Mesh, mesh_section, t6_quality
from palpate.workers.organs.cornea.section_outline import Section, generated_section

JET = (-1.5, 1.5)


def area_of(mesh: T6Mesh) -> float:
    """Return the area by the divergence theorem on the quadratic sides of all elements (exact)."""
    corner, middle = mesh.nodes_mm[mesh.triangles[:, :3]], mesh.nodes_mm[mesh.triangles[:, 3:]]
    following = np.roll(corner, -1, axis=1)

    def cross(a: FloatArray, b: FloatArray) -> FloatArray:
        return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]

    # 1/2 times the integral of x dy - y dx over the parabola through a, m and b.
    sides = (
        4 * cross(corner, middle) + 4 * cross(middle, following) - cross(corner, following)
    ) / 6
    return float(sides.sum())


def test_area_converges_to_the_arcs_with_order_four() -> None:
    section = generated_section(points=20001)
    outline = section.outline_mm
    following = np.roll(outline, -1, axis=0)
    exact = -0.5 * np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0])
    errors = [abs(area_of(mesh_section(section, n)) - exact) for n in (8, 32, 128)]
    # Sides of half the length: the error of a parabola through three points of an arc is O(h^4).
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 3.5)


def test_nodes_are_on_the_surfaces_and_at_the_edges_of_the_jet() -> None:
    section = generated_section()
    mesh = mesh_section(section, 960, JET)
    assert len(mesh.triangles) == 960
    for nodes, surface in (
        (mesh.anterior, section.anterior_mm),
        (mesh.posterior, section.posterior_mm),
    ):
        x, y = mesh.nodes_mm[nodes].T
        assert np.allclose(np.interp(x, *surface.T), y, atol=1e-12)
        assert np.all(np.diff(x) > 0)
    corners = mesh.nodes_mm[mesh.anterior[::2], 0]
    for x in JET:
        assert np.abs(corners - x).min() < 1e-12
    assert np.allclose(mesh.nodes_mm[mesh.left[-1]], section.anterior_mm[0])
    assert np.allclose(mesh.nodes_mm[mesh.right[0]], section.posterior_mm[-1])


def test_mesh_topology_is_consistent() -> None:
    mesh = mesh_section(generated_section(), 240, JET)
    sides: dict[tuple[int, int], list[int]] = {}
    for triangle in mesh.triangles.tolist():
        for k in range(3):
            a, b = triangle[k], triangle[(k + 1) % 3]
            sides.setdefault((min(a, b), max(a, b)), []).append(triangle[3 + k])
    assert all(len(set(middles)) == 1 for middles in sides.values())
    outline = {pair: middles[0] for pair, middles in sides.items() if len(middles) == 1}
    expected = {}
    for nodes in (mesh.anterior, mesh.posterior, mesh.left, mesh.right):
        for a, middle, b in zip(nodes[:-2:2], nodes[1::2], nodes[2::2], strict=True):
            expected[(int(min(a, b)), int(max(a, b)))] = int(middle)
    assert outline == expected
    assert np.array_equal(np.unique(mesh.triangles), np.arange(len(mesh.nodes_mm)))


def test_a_symmetric_section_has_a_symmetric_mesh() -> None:
    mesh = mesh_section(generated_section(), 960, JET)
    mirror = {tuple(p): i for i, p in enumerate(np.round(mesh.nodes_mm * [-1, 1], 9).tolist())}
    number = np.array([mirror[tuple(p)] for p in np.round(mesh.nodes_mm, 9).tolist()])
    own = {frozenset(t) for t in mesh.triangles[:, :3].tolist()}
    assert {frozenset(t) for t in number[mesh.triangles[:, :3]].tolist()} == own


def test_neighbouring_nodes_have_close_numbers() -> None:
    mesh = mesh_section(generated_section(), 960, JET)
    assert np.ptp(mesh.triangles, axis=1).max() <= 4 * 4 + 4


@pytest.mark.parametrize("elements", [30, 240, 960, 2880])
def test_mesh_has_good_quality_and_about_the_requested_elements(elements: int) -> None:
    mesh = mesh_section(generated_section(), elements, JET)
    quality = t6_quality(mesh)
    assert quality.smallest_shape > 0.7
    assert quality.smallest_jacobian > 0.9
    assert abs(len(mesh.triangles) - elements) <= max(8, 0.05 * elements)


def test_jacobian_bound_detects_a_folded_element() -> None:
    straight = T6Mesh(
        nodes_mm=np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]], dtype=float),
        triangles=np.array([[0, 1, 2, 3, 4, 5]], dtype=np.int32),
        anterior=np.array([0], dtype=np.int32),
        posterior=np.array([0], dtype=np.int32),
        left=np.array([0], dtype=np.int32),
        right=np.array([0], dtype=np.int32),
    )
    assert t6_quality(straight).smallest_jacobian == pytest.approx(1.0)
    # A midside node at a quarter of its side makes the map singular at the near corner.
    nodes = straight.nodes_mm.copy()
    nodes[3, 0] = 0.25
    assert t6_quality(replace(straight, nodes_mm=nodes)).smallest_jacobian == pytest.approx(0.0)
    nodes[3, 0] = 0.2
    assert t6_quality(replace(straight, nodes_mm=nodes)).smallest_jacobian < 0


def test_rejects_invalid_sections() -> None:
    good = generated_section(points=101)
    anterior, posterior = good.anterior_mm, good.posterior_mm
    crossing = posterior.copy()
    crossing[60:70, 1] += 0.8
    thin = posterior.copy()
    thin[40:50, 1] = np.interp(thin[40:50, 0], *anterior.T) - 1e-3
    back = anterior.copy()
    back[[20, 21]] = back[[21, 20]]
    for section, message in (
        (Section(anterior, crossing), "cross at x = "),
        (Section(anterior, thin), "um thick"),
        (Section(back, posterior), "runs back"),
        (Section(posterior, anterior), "Exchange the two contours"),
    ):
        with pytest.raises(InputError, match=message):
            mesh_section(section)


def test_rejects_impossible_requests() -> None:
    section = generated_section()
    with pytest.raises(InputError, match="wider than the cornea"):
        mesh_section(section, 960, (-6.0, 6.0))
    with pytest.raises(InputError, match="one position"):
        mesh_section(section, 960, (1.0, 1.0))
    with pytest.raises(InputError, match="at least 8 triangles"):
        mesh_section(section, 4)
