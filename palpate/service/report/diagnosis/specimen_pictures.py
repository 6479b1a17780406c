"""Pictures of the points of a bench experiment, measured and predicted, from all sides.

Arrows point from measured to predicted points; the specimen itself is drawn with its points at
rest and as moved. Both are enlarged by 1, 2 or 5 times a power of ten, and show the states with the
largest misfit.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from palpate.service.diagnosis.magnitude_words import length
from palpate.service.report.drawing.svg import ABOVE_PX, BELOW_PX, LEFT_PX, Mark, Panel, Svg, legend
from palpate.service.report.page.page_elements import Picture, TableRow, chart
from palpate.storage.stored_arrays import Arrays
from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.diagnosis.problem.inverse_problem import FORCE

# Below this width views are stacked.
NARROW = 600.0
HIGHEST_PX, APART_PX, RIGHT_PX = 340.0, 24.0, 8.0
# Margin around the points beyond the longest arrow, relative to the longest side of the body.
POINTS_MARGIN = 0.03
# The longest arrow, relative to the longest side of the body.
LONGEST_ARROW = 0.12
# With fewer points a table is enough.
LEAST_POINTS = 12
# Maximum number of states drawn, those with the largest misfit, and of their points.
ARROW_STATES, ARROW_POINTS = 6, 400
HEAD_OF_ARROW_PX, HEAD_ANGLE = 4.5, 0.45


@dataclass(frozen=True, eq=False)
class Misfits:
    """Residuals of the models at the points of all states.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Points at rest, in mm.
    before, after : ndarray, shape (s, k, 3)
        Vectors from measured to predicted points, for the nominal model and the one with the
        effect; `after` is None if no effect is named.
    """

    points: FloatArray
    before: FloatArray
    after: FloatArray | None


def misfits_of(maps: Arrays) -> Misfits:
    """Return the residuals from the maps of a diagnosis, whose rows are components of points."""
    place = maps["interface"] != FORCE
    axis, points = maps["interface"][place].astype(int), maps["points"][place]
    first = np.ones(len(axis), bool)
    first[1:] = (axis[1:] <= axis[:-1]) | (points[1:] != points[:-1]).any(axis=1)
    point = np.cumsum(first) - 1

    def at_points(rows: FloatArray) -> FloatArray:
        """Return components as arrows; unmeasured components are 0."""
        found = np.zeros((len(rows), int(first.sum()), 3))
        found[:, point, axis] = rows[:, place]
        return found

    after = maps.get("after")
    return Misfits(
        points[first], at_points(maps["before"]), None if after is None else at_points(after)
    )


def arrow_pictures(
    maps: Arrays, states: Sequence[str], named: str, noise_mm: float
) -> Iterator[Picture]:
    """Yield pictures of at most `ARROW_STATES` states, those with the largest misfit.

    Parameters
    ----------
    maps : dict of str to ndarray
        See `service.diagnosis.diagnosis_run.FinishedDiagnosis`; for a bench experiment.
    states : sequence of str
    named : str
        Name of the effect in ``after``.
    noise_mm : float
        Noise of a component; arrows are not enlarged beyond it.
    """
    misfits = misfits_of(maps)
    if len(misfits.points) < LEAST_POINTS:
        return
    size = np.sqrt((misfits.before**2).sum(axis=2).mean(axis=1))
    shown = sorted(np.argsort(-size)[:ARROW_STATES].tolist())
    times = arrow_magnification(misfits, noise_mm)
    for number in shown:
        longest = float(np.linalg.norm(misfits.before[number], axis=1).max())
        caption = (
            f"{states[number]}: arrows from the measured to the predicted points, drawn "
            f"{times:g} times as long. With the nominal model the longest is {length(longest)} mm; "
            f"noise is {length(noise_mm)} mm."
        )
        yield chart(partial(_arrows_of_state, misfits, number, times, named), caption, caption)


def arrow_magnification(misfits: Misfits, noise_mm: float) -> float:
    """Return the magnification of arrows: 1, 2 or 5 times a power of ten."""
    extent = float(np.ptp(misfits.points, axis=0).max())
    both = [misfits.before] if misfits.after is None else [misfits.before, misfits.after]
    longest = max(noise_mm, *(float(np.linalg.norm(one, axis=2).max()) for one in both))
    if not longest > 0 or not extent > 0:
        return 1.0
    most = LONGEST_ARROW * extent / longest
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most)


def _arrows_of_state(misfits: Misfits, number: int, times: float, named: str, width: float) -> Svg:
    """Draw one state from all sides; see `views_of`."""
    views = views_of(misfits.points, misfits.points)
    svg = Svg(width, 0.0)
    marks: list[tuple[Mark, str, str]] = [("line", "left-before", "nominal model")]
    if misfits.after is not None:
        marks.append(("line", "left-after", f"with {named}"))
    top = legend(svg, marks, LEFT_PX, 12.0, width)
    every = np.arange(0, len(misfits.points), -(-len(misfits.points) // ARROW_POINTS))
    for view, panel in zip(views, view_panels(misfits.points, views, width, top), strict=True):
        panel.axes(svg, *(f"{'xyz'[axis]}, mm" for axis in view))
        points = misfits.points[every][:, list(view)]
        places = [(panel.across.at(x), panel.up.at(y)) for x, y in points.tolist()]
        svg.dots(places, "cloud", stroke_width=4)
        for left, class_ in ((misfits.before, "left-before"), (misfits.after, "left-after")):
            if left is not None:
                _arrows(svg, panel, points, times * left[number][every][:, list(view)], class_)
        svg.height = max(svg.height, panel.up.start + BELOW_PX)
    return svg


def views_of(rest: FloatArray, drawn: FloatArray) -> tuple[tuple[int, int], ...]:
    """Return the axes of views along the two shortest sides of a body, or the shortest of a sheet.

    Parameters
    ----------
    rest, drawn : ndarray, shape (k, 3)
        Points at rest, and all points of the drawing, in mm.
    """
    longest, middle, shortest = np.argsort(-np.ptp(rest, axis=0), kind="stable").tolist()
    if not np.ptp(drawn[:, shortest]) > 0:
        return ((longest, middle),)
    return (longest, middle), (longest, shortest)


def view_panels(
    points: FloatArray, views: Sequence[tuple[int, int]], width: float, top: float
) -> Iterator[Panel]:
    """Yield the panels of views at one scale, side by side or stacked."""
    beside = width > NARROW and len(views) > 1
    frames = [_view_frame(points, view) for view in views]
    room = (width - APART_PX) / 2 - LEFT_PX if beside else width - LEFT_PX - RIGHT_PX
    per_mm = min(min(room / (f[1] - f[0]), HIGHEST_PX / (f[3] - f[2])) for f in frames)
    x, y = LEFT_PX, top + ABOVE_PX
    for frame in frames:
        yield Panel(frame, x, y, per_mm)
        if beside:
            x += per_mm * (frame[1] - frame[0]) + APART_PX + LEFT_PX
        else:
            y += per_mm * (frame[3] - frame[2]) + BELOW_PX + ABOVE_PX


def _view_frame(points: FloatArray, view: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return the frame of a view in mm, with room for arrows."""
    extent = np.ptp(points, axis=0)
    room = (LONGEST_ARROW + POINTS_MARGIN) * float(extent.max())
    across, up = (points[:, axis] for axis in view)
    return (
        float(across.min() - room),
        float(across.max() + room),
        float(up.min() - room),
        float(up.max() + room),
    )


def _arrows(svg: Svg, panel: Panel, points: FloatArray, moved: FloatArray, class_: str) -> None:
    """Draw arrows from points, both (n, 2) in a view, as one path."""
    path = []
    for start, along in zip(points.tolist(), moved.tolist(), strict=True):
        x, y = panel.across.at(start[0]), panel.up.at(start[1])
        dx, dy = panel.per_mm * along[0], -panel.per_mm * along[1]
        path.append(f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}{_arrowhead(dx, dy)}")
    svg.add("path", d="".join(path), class_=class_)


def _arrowhead(dx: float, dy: float) -> str:
    """Return the strokes of an arrowhead, or none if the arrow is too short."""
    if math.hypot(dx, dy) < HEAD_OF_ARROW_PX:
        return ""
    back = math.atan2(-dy, -dx)
    ends = [
        (HEAD_OF_ARROW_PX * math.cos(back + turn), HEAD_OF_ARROW_PX * math.sin(back + turn))
        for turn in (HEAD_ANGLE, -HEAD_ANGLE)
    ]
    (ax, ay), (bx, by) = ends
    return f"l{ax:.1f} {ay:.1f}m{-ax:.1f} {-ay:.1f}l{bx:.1f} {by:.1f}"


# Maximum number of states drawn, those with the largest misfit, and of their points.
MOVEMENT_STATES, MOVEMENT_POINTS = 3, 200
# Movements smaller than this fraction of the body are enlarged, up to this fraction.
LARGEST_MOVEMENT = 0.12
MODELS = ("before", "after")


@dataclass(frozen=True, eq=False)
class Movement:
    """The points of a specimen in one state, all in mm.

    Parameters
    ----------
    state : str
    rest : ndarray, shape (k, 3)
    moved : mapping of str to ndarray, shape (k, 3)
        Displacements: ``measured``, ``before`` and, if an effect is named, ``after``.
    edges_rest : ndarray, shape (e, 2, 3)
        Sharp edges of the body.
    edges : mapping of str to ndarray, shape (e, 2, 3)
        The edges as moved by the models.
    """

    state: str
    rest: FloatArray
    moved: Mapping[str, FloatArray]
    edges_rest: FloatArray
    edges: Mapping[str, FloatArray]

    @property
    def misfit_mm(self) -> float:
        """Root mean square residual of the nominal model."""
        left = self.moved["before"] - self.moved["measured"]
        return float(np.sqrt(np.mean(left**2)))


def specimen_pictures(maps: Arrays, summary: Summary, named: str) -> Iterator[Picture]:
    """Yield pictures of at most `MOVEMENT_STATES` states, those with the largest misfit.

    Parameters
    ----------
    maps : dict of str to ndarray
        See `service.diagnosis.diagnosis_run.FinishedDiagnosis`; for a bench experiment.
    summary : Summary
    named : str
        Name of the effect in ``after``.
    """
    states = movements(maps, summary)
    for movement in sorted(states, key=lambda m: -m.misfit_mm)[:MOVEMENT_STATES]:
        times = movement_magnification(movement)
        farthest = float(np.linalg.norm(movement.moved["measured"], axis=1).max())
        drawn = "to scale" if times == 1 else f"drawn {times:g} times as large"
        caption = (
            f"{movement.state}: measured and predicted points. "
            f"Movements are {drawn}; the largest is {length(farthest)} mm."
        )
        yield chart(
            partial(_movements_of_state, movement, times, named),
            caption,
            caption,
            list(_movement_rows(movement)),
        )


def movements(maps: Arrays, summary: Summary) -> list[Movement]:
    """Return all states; none if the positions of the points are unknown."""
    places = maps.get("marker_points")
    if places is None or not summary.markers:
        return []
    rest_edges = maps.get("edges_rest", np.zeros((0, 2, 3)))
    states = []
    for number, state in enumerate(summary.markers):
        if len(state.points) != len(places):
            return []
        moved = np.array([p.displacement_mm for p in state.points])
        seen = np.isfinite(moved).any(axis=1)
        models = {"measured": moved}
        for when in MODELS:
            left = [getattr(p, f"{when}_mm") for p in state.points]
            if all(residual is not None for residual in left):
                models[when] = moved + np.array(left)
        states.append(
            Movement(
                state.state,
                places[seen],
                # Unmeasured components are drawn without movement.
                {name: np.nan_to_num(u[seen]) for name, u in models.items()},
                rest_edges,
                {w: maps[f"edges_{w}"][number] for w in MODELS if f"edges_{w}" in maps},
            )
        )
    return states


def movement_magnification(one: Movement) -> float:
    """Return the magnification of movements: 1, 2 or 5 times a power of ten, at least 1."""
    extent = float(np.ptp(_at_rest(one), axis=0).max())
    farthest = max(float(np.linalg.norm(u, axis=1).max()) for u in one.moved.values())
    if not farthest > 0 or not extent > 0:
        return 1.0
    most = LARGEST_MOVEMENT * extent / farthest
    power = 10.0 ** math.floor(math.log10(most))
    return max(1.0, *(step * power for step in (1.0, 2.0, 5.0) if step * power <= most))


def _at_rest(one: Movement) -> FloatArray:
    return np.concatenate([one.rest, one.edges_rest.reshape(-1, 3)])


def _movements_of_state(one: Movement, times: float, named: str, width: float) -> Svg:
    """Draw one state from all sides; see `views_of`."""
    drawn = {name: one.rest + times * u for name, u in one.moved.items()}
    edges = {w: one.edges_rest + times * (e - one.edges_rest) for w, e in one.edges.items()}
    everything = np.concatenate(
        [_at_rest(one), *drawn.values(), *(e.reshape(-1, 3) for e in edges.values())]
    )
    views = views_of(_at_rest(one), everything)
    svg = Svg(width, 0.0)
    marks: list[tuple[Mark, str, str]] = [
        ("line", "at-rest", "at rest"),
        ("ring", "target", "measured"),
        ("cross", "left-before", "nominal model"),
    ]
    if "after" in drawn:
        marks.append(("cross", "left-after", f"with {named}"))
    top = legend(svg, marks, LEFT_PX, 12.0, width)
    every = np.arange(0, len(one.rest), -(-len(one.rest) // MOVEMENT_POINTS))
    for view, panel in zip(views, view_panels(everything, views, width, top), strict=True):
        panel.axes(svg, *(f"{'xyz'[axis]}, mm" for axis in view))
        _draw_edges(svg, panel, one.edges_rest, view, "at-rest")
        for when in MODELS:
            if when in edges:
                _draw_edges(svg, panel, edges[when], view, f"left-{when}")
        signs: list[tuple[str, Mark, str, float]] = [
            ("measured", "ring", "target", 4.5),
            ("before", "cross", "left-before", 3.0),
            ("after", "cross", "left-after", 3.0),
        ]
        for name, mark, class_, size in signs:
            places = drawn[name][every][:, list(view)].tolist() if name in drawn else []
            for x, y in places:
                svg.mark(mark, panel.across.at(x), panel.up.at(y), class_, size)
        svg.height = max(svg.height, panel.up.start + BELOW_PX)
    return svg


def _draw_edges(
    svg: Svg, panel: Panel, edges: FloatArray, view: Sequence[int], class_: str
) -> None:
    path = "".join(
        f"M{panel.across.at(x1):.1f} {panel.up.at(y1):.1f}L{panel.across.at(x2):.1f} "
        f"{panel.up.at(y2):.1f}"
        for (x1, y1), (x2, y2) in edges[:, :, list(view)].tolist()
    )
    if path:
        svg.add("path", d=path, class_=f"{class_} edge")


def _movement_rows(one: Movement) -> Iterator[TableRow]:
    yield ("x_mm", "y_mm", "z_mm", *(f"{m}_{a}_mm" for m in one.moved for a in "xyz"))
    for k, place in enumerate(one.rest.tolist()):
        yield (*place, *(v for u in one.moved.values() for v in u[k].tolist()))
