"""Triangles as pixels, checked point by point."""

import numpy as np

from palpate.service.report.drawing.raster import NO_TRIANGLE, front_triangles


def test_triangle_covers_pixels_with_centres_inside() -> None:
    """The lower left half of four by four pixels, a little less than its diagonal::

    #...
    ##..
    ###.
    ####
    """
    corners = np.array([[[0.0, 0.0], [4.1, 0.0], [0.0, 4.1]]])
    seen = front_triangles(corners, np.zeros(1), 5, 5)
    expected = np.full((5, 5), NO_TRIANGLE)
    for row in range(4):
        expected[row, : 4 - row] = 0
    np.testing.assert_array_equal(seen, expected)


def test_nearest_triangle_is_visible_in_any_order() -> None:
    """Compare with a brute-force test of every pixel; some triangles extend beyond the picture."""
    rng = np.random.default_rng(5)
    rows, columns = 17, 23
    corners = rng.uniform(-4, 28, (40, 3, 2))
    nearness = rng.normal(size=40)
    expected = np.full((rows, columns), NO_TRIANGLE)
    up, across = (a + 0.5 for a in np.mgrid[:rows, :columns])
    for number in np.argsort(nearness):
        expected[inside(corners[number], across, up)] = number
    np.testing.assert_array_equal(front_triangles(corners, nearness, rows, columns), expected)


def inside(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    signs = []
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        signs.append((bx - ax) * (y - ay) - (by - ay) * (x - ax))
    return np.asarray((np.array(signs) >= 0).all(axis=0) | (np.array(signs) <= 0).all(axis=0))


def test_a_surface_has_no_cracks() -> None:
    """A disc of 200 triangles around its centre covers a picture inside it completely."""
    turn = np.linspace(0, 2 * np.pi, 201)
    rim = 40 * np.stack([np.cos(turn), np.sin(turn)], axis=1) + 10
    middle = np.full((200, 2), 10.3)
    corners = np.stack([middle, rim[:-1], rim[1:]], axis=1)
    assert (front_triangles(corners, np.zeros(200), 20, 20) >= 0).all()


def test_triangles_without_an_area_and_pictures_without_triangles_are_empty() -> None:
    flat = np.array([[[0.0, 1.0], [3.0, 1.0], [2.0, 1.0]]])
    assert (front_triangles(flat, np.zeros(1), 3, 3) == NO_TRIANGLE).all()
    assert (front_triangles(np.zeros((0, 3, 2)), np.zeros(0), 2, 3) == NO_TRIANGLE).all()
