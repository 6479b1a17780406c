"""Export of a body moving from rest to load as an animation (GIF)."""

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.animation import PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from palpate.service.export.solved_mesh_files import SERIES_NOTE, SolvedBody, rest_of
from palpate.storage.backends.atomic_files import explained, replacing
from palpate.storage.values import FloatArray
from palpate.workers.body.mesh.mesh_geometry import boundary_triangles

FRAMES, HELD, PER_SECOND = 16, 6, 8
SIZE_IN, DPI = (5.6, 4.4), 100
# As on the pages, which exports do not depend on: `palpate.service.report.drawing.colours`.
COLOURS = ("#d9d4c7", "#e5b567", "#cf6f3a", "#9b2f58", "#43155e")
PLATE = "#4d7fa8"
# The view used on the pages: plates press along y, which points up.
AZIMUTH, ELEVATION = np.radians(-50.0), np.radians(18.0)
AMBIENT = 0.55


def export_movie(path: Path, body: SolvedBody) -> None:
    """Write an animation (GIF) of the surface between its plates, coloured by displacement.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    writer = PillowWriter(fps=PER_SECOND)
    plain = rc_context({"text.usetex": False})
    with explained(path), replacing(path) as temporary, plain:
        scene = _Scene(body)
        writer.setup(scene.figure, temporary, DPI)
        for frame in range(FRAMES + HELD):
            scene.show(min(1.0, frame / FRAMES))
            writer.grab_frame()
        writer.finish()


class _Scene:
    """The surface of a body seen from one side, drawn from back to front."""

    def __init__(self, body: SolvedBody) -> None:
        self.rest, self.displacement_mm = rest_of(body), body.displacement_mm
        self.triangles = boundary_triangles(body.level.model.elements.tets)
        stage = body.solved.stage
        plates = stage.plates(body.solved.states[-1].travel_mm)
        self.axis = np.asarray(plates[0].normal) if plates else None
        a, e = AZIMUTH, ELEVATION
        near = np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
        across = np.array([np.cos(a), 0.0, -np.sin(a)])
        self.camera = np.stack([across, np.cross(near, across), near], axis=1)
        length = np.linalg.norm(self.displacement_mm, axis=1)
        self.norm = Normalize(0.0, max(float(length.max()), 1e-9))
        self.colours = LinearSegmentedColormap.from_list("displacement", COLOURS)
        self.figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
        FigureCanvasAgg(self.figure)
        self.axes = self.figure.add_subplot()
        bar = ScalarMappable(self.norm, self.colours)
        self.figure.colorbar(bar, ax=self.axes, label="displacement, mm", shrink=0.8)
        self.figure.supxlabel(f"{body.title}\n{SERIES_NOTE}", fontsize=8)
        seen = np.concatenate([self._at(share)[0] for share in (0.0, 1.0)])
        if self.axis is not None:
            ends = [self._plates(self.rest + s * self.displacement_mm) for s in (0.0, 1.0)]
            seen = np.concatenate([seen, *(plate @ self.camera for end in ends for plate in end)])
        (self.left, self.low), (self.right, self.high) = seen[:, :2].min(0), seen[:, :2].max(0)

    def show(self, share: float) -> None:
        """Draw the body at a fraction of its displacement."""
        seen, light = self._at(share)
        corners = seen[self.triangles]
        order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
        length = share * np.linalg.norm(self.displacement_mm, axis=1)[self.triangles].mean(axis=1)
        colours = self.colours(self.norm(length))
        colours[:, :3] *= light[:, None]
        self.axes.clear()
        plates = self._plates(self.rest + share * self.displacement_mm)
        for plate, in_front in zip(plates, (False, True), strict=False):
            self._sheet(plate @ self.camera, in_front)
        self.axes.add_collection(
            PolyCollection(
                list(corners[order][:, :, :2]),
                facecolors=colours[order],
                edgecolors=colours[order],
                linewidths=0.3,
                zorder=2,
            )
        )
        self.axes.set(
            xlim=(self.left, self.right),
            ylim=(self.low, self.high),
            aspect="equal",
            title=f"share of the displacement: {share:.2f}",
        )
        self.axes.set_axis_off()

    def _at(self, share: float) -> tuple[FloatArray, FloatArray]:
        """Return the nodes in camera coordinates and the brightness of the triangles."""
        x = self.rest + share * self.displacement_mm
        a, b, c = (x[self.triangles[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        lamp = self.camera @ np.array([-0.5, 0.5, 1.0]) / np.sqrt(1.5)
        return x @ self.camera, AMBIENT + (1 - AMBIENT) * np.abs(normal @ lamp)

    def _plates(self, x: FloatArray) -> list[FloatArray]:
        """Return the corners of the lower and the upper plate at the ends of the body."""
        if self.axis is None:
            return []
        deep = np.array([0.0, 0.0, 1.0])
        axis = self.axis * (1 if self.axis @ self.camera[:, 1] > 0 else -1)
        wide = np.cross(axis, deep)
        along, across, depth = x @ axis, x @ wide, x @ deep
        return [
            np.stack(
                [
                    height * axis + a * wide + d * deep
                    for a, d in (
                        (across.min(), depth.min()),
                        (across.max(), depth.min()),
                        (across.max(), depth.max()),
                        (across.min(), depth.max()),
                    )
                ]
            )
            for height in (along.min(), along.max())
        ]

    def _sheet(self, corners: FloatArray, in_front: bool) -> None:
        self.axes.add_collection(
            PolyCollection(
                [corners[:, :2]],
                facecolors=[(*_rgb(PLATE), 0.2)],
                edgecolors=PLATE,
                zorder=3 if in_front else 1,
            )
        )


def _rgb(colour: str) -> tuple[float, float, float]:
    r, g, b = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return r, g, b
