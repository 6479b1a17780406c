"""Pictures of a specimen with its measured and predicted points."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from palpate.service.diagnosis.words import length
from palpate.service.report.diagnosis.arrows import panels, views_of
from palpate.service.report.drawing.panel import BELOW_PX, LEFT_PX, Panel
from palpate.service.report.drawing.pictures import Picture, Row, chart
from palpate.service.report.drawing.svg import Mark, Svg, legend
from palpate.storage.stores.arrays import Arrays
from palpate.storage.values import FloatArray
from palpate.workers.diagnosis.schema.summary import Summary

# Maximum number of states drawn, those with the largest misfit, and of their points.
STATES, POINTS = 3, 200
# Movements smaller than this fraction of the body are enlarged, up to this fraction.
LARGEST = 0.12
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
    """Yield pictures of at most `STATES` states, those with the largest misfit.

    Parameters
    ----------
    maps : dict of str to ndarray
        See `service.diagnosis.run.FinishedDiagnosis`; for a bench experiment.
    summary : Summary
    named : str
        Name of the effect in ``after``.
    """
    found = movements(maps, summary)
    for one in sorted(found, key=lambda m: -m.misfit_mm)[:STATES]:
        times = enlarged(one)
        farthest = float(np.linalg.norm(one.moved["measured"], axis=1).max())
        drawn = "to scale" if times == 1 else f"drawn {times:g} times as large"
        caption = (
            f"{one.state}: measured and predicted points. "
            f"Movements are {drawn}; the largest is {length(farthest)} mm."
        )
        yield chart(partial(_state, one, times, named), caption, caption, list(_rows(one)))


def movements(maps: Arrays, summary: Summary) -> list[Movement]:
    """Return all states; none if the positions of the points are unknown."""
    places = maps.get("marker_points")
    if places is None or not summary.markers:
        return []
    rest_edges = maps.get("edges_rest", np.zeros((0, 2, 3)))
    found = []
    for number, state in enumerate(summary.markers):
        if len(state.points) != len(places):
            return []
        moved = np.array([p.displacement_mm for p in state.points])
        seen = np.isfinite(moved).any(axis=1)
        models = {"measured": moved}
        for when in MODELS:
            left = [getattr(p, f"{when}_mm") for p in state.points]
            if all(one is not None for one in left):
                models[when] = moved + np.array(left)
        found.append(
            Movement(
                state.state,
                places[seen],
                # Unmeasured components are drawn without movement.
                {name: np.nan_to_num(u[seen]) for name, u in models.items()},
                rest_edges,
                {w: maps[f"edges_{w}"][number] for w in MODELS if f"edges_{w}" in maps},
            )
        )
    return found


def enlarged(one: Movement) -> float:
    """Return the magnification of movements: 1, 2 or 5 times a power of ten, at least 1."""
    extent = float(np.ptp(_at_rest(one), axis=0).max())
    farthest = max(float(np.linalg.norm(u, axis=1).max()) for u in one.moved.values())
    if not farthest > 0 or not extent > 0:
        return 1.0
    most = LARGEST * extent / farthest
    power = 10.0 ** math.floor(math.log10(most))
    return max(1.0, *(step * power for step in (1.0, 2.0, 5.0) if step * power <= most))


def _at_rest(one: Movement) -> FloatArray:
    return np.concatenate([one.rest, one.edges_rest.reshape(-1, 3)])


def _state(one: Movement, times: float, named: str, width: float) -> Svg:
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
    every = np.arange(0, len(one.rest), -(-len(one.rest) // POINTS))
    for view, panel in zip(views, panels(everything, views, width, top), strict=True):
        panel.axes(svg, *(f"{'xyz'[axis]}, mm" for axis in view))
        _lines(svg, panel, one.edges_rest, view, "at-rest")
        for when in MODELS:
            if when in edges:
                _lines(svg, panel, edges[when], view, f"left-{when}")
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


def _lines(svg: Svg, panel: Panel, edges: FloatArray, view: Sequence[int], class_: str) -> None:
    path = "".join(
        f"M{panel.across.at(x1):.1f} {panel.up.at(y1):.1f}L{panel.across.at(x2):.1f} "
        f"{panel.up.at(y2):.1f}"
        for (x1, y1), (x2, y2) in edges[:, :, list(view)].tolist()
    )
    if path:
        svg.add("path", d=path, class_=f"{class_} edge")


def _rows(one: Movement) -> Iterator[Row]:
    yield ("x_mm", "y_mm", "z_mm", *(f"{m}_{a}_mm" for m in one.moved for a in "xyz"))
    for k, place in enumerate(one.rest.tolist()):
        yield (*place, *(v for u in one.moved.values() for v in u[k].tolist()))
