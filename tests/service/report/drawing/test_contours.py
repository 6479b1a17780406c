"""Contours of hand-drawn masks."""

import numpy as np

from palpate.service.report.drawing.svg import contours, path_of


def mask(*lines: str) -> np.ndarray:
    """Return a mask; the first line is the top row."""
    return np.array([[c == "#" for c in line] for line in lines[::-1]])


def area(line: np.ndarray) -> float:
    """Return the area in pixels, positive if the inside is on the left."""
    (x, y), (nx, ny) = line[:-1].T, line[1:].T
    return float((x * ny - nx * y).sum()) / 8


def test_one_pixel_is_a_diamond_around_its_centre() -> None:
    """Coordinates in half pixels; the centre of the pixel is (2, 2)::

    ...
    .#.
    ...
    """
    (line,) = contours(mask("...", ".#.", "..."))
    assert line[0].tolist() == line[-1].tolist()
    assert sorted(line[:-1].tolist()) == [[1, 2], [2, 1], [2, 3], [3, 2]]
    assert area(line) == 0.5


def test_straight_lines_have_no_points_between_their_ends() -> None:
    """Four pixels in a row are a hexagon."""
    (line,) = contours(mask("......", ".####.", "......"))
    assert len(line) == 6 + 1
    assert area(line) == 3.5


def test_a_hole_is_on_the_right_of_its_line() -> None:
    """Seven by seven pixels without one; each corner is cut by an eighth."""
    lines = contours(
        mask(".......", ".#####.", ".#####.", ".##.##.", ".#####.", ".#####.", ".......")
    )
    assert sorted(area(line) for line in lines) == [-0.5, 25 - 4 / 8]


def test_pixels_that_touch_at_a_corner_have_their_own_lines() -> None:
    """::

    ....
    .#..
    ..#.
    ....
    """
    lines = contours(mask("....", ".#..", "..#.", "...."))
    assert [area(line) for line in lines] == [0.5, 0.5]


def test_a_line_ends_where_the_mask_ends() -> None:
    """The body continues below: one line from right to left, and none at the cut."""
    (line,) = contours(mask("....", "....", "####", "####"))
    assert line.tolist() == [[6, 3], [0, 3]]


def test_empty_and_full_masks_have_no_contour() -> None:
    for inside in (mask("..", ".."), mask("##", "##"), mask("#."), mask("#")):
        assert contours(inside) == []


def test_random_masks_have_the_area_of_their_pixels() -> None:
    """Marching squares add and remove equal areas at corners, except single ones."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        inside = np.pad(rng.random((9, 12)) < 0.5, 1)
        lines = contours(inside)
        assert all((line[0] == line[-1]).all() for line in lines)
        corners = np.stack([inside[:-1, :-1], inside[:-1, 1:], inside[1:, :-1], inside[1:, 1:]])
        count = corners.sum(axis=0)
        diagonal = (corners[0] == corners[3]) & (count == 2)
        # Of a cell between four pixels: an eighth for one of them, a quarter for two across a
        # corner, a half for two side by side, seven eighths for three.
        share = np.array([0.0, 1 / 8, 1 / 2, 7 / 8, 1.0])[count]
        expected = np.where(diagonal, 1 / 4, share).sum()
        assert sum(area(line) for line in lines) == expected


def test_path_uses_relative_steps() -> None:
    (line,) = contours(mask("...", ".#.", "..."))
    steps = path_of([line])
    x, y = line[0].tolist()
    numbers = [int(number) for number in steps.removeprefix(f"M{x} {y}l").split()]
    np.testing.assert_array_equal(
        np.cumsum(np.reshape(numbers, (-1, 2)), axis=0) + line[0], line[1:]
    )
