"""Draw the figures of the explanation pages from a finished run of the demo.

::

    palpate run examples/demo.yaml
    python docs/pictures/figures.py runs/demo docs/pictures
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot as plt
from scipy.spatial import cKDTree

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from palpate.service.export.solved_mesh_files import SolvedBody, solve_body  # noqa: E402
from palpate.service.study.study_folder import read_study  # noqa: E402
from palpate.service.study.study_keys import read_spec  # noqa: E402
from palpate.storage.backends.store_paths import StudyLayout  # noqa: E402
from palpate.storage.values import Volume  # noqa: E402

INK, BLUE, ORANGE = "#333333", "#0072b2", "#c44e00"


def draw_search(folder: Path, out: Path) -> None:
    """Draw the score of every candidate over the number of evaluations."""
    _, log = read_study(folder)
    done = [r for r in log.endings.values() if r.score is not None and r.level is None]
    done.sort(key=lambda record: record.candidate)
    score = np.array([record.score["gsf"] for record in done])
    fitted = np.array([record.fit is not None for record in done])
    number = np.arange(1, len(done) + 1)
    figure, axes = plt.subplots(figsize=(7.2, 3.2), layout="constrained")
    axes.plot(number[~fitted], score[~fitted], ".", ms=3, color=BLUE, label="genetic search")
    axes.plot(number[fitted], score[fitted], "o", ms=5, color=ORANGE, label="least squares")
    axes.step(number, np.minimum.accumulate(score), where="post", color=INK, lw=1, label="best")
    axes.set(xlabel="evaluations", ylabel="GSF (lower is better)")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    figure.savefig(out, dpi=110, metadata={"Software": None})
    plt.close(figure)


def draw_strain(folder: Path, out: Path) -> None:
    """Draw the largest and the least principal stretch in two sections of the deformed body."""
    spec, (_, log) = read_spec(StudyLayout(folder).study), read_study(folder)
    case = spec.case.model_dump(mode="json")
    body = solve_body(case, spec.constants_of(spec.target.constants), log.sessions[-1].store, "")
    stretches = _stretches(body)
    tets = body.setup.mesh.finest.mesh.tets
    nearest = cKDTree(body.positions_mm[tets].mean(axis=1))
    labels = body.deformed_labels()
    sections = [_section(labels, axis) for axis in ("z", "x")]
    sizes = [width / height for _, (width, height), _ in sections]
    figure, rows = plt.subplots(
        2, 2, figsize=(9, 3.6), layout="constrained", width_ratios=sizes, squeeze=False
    )
    shown = (("least stretch", (0.4, 1.0)), ("largest stretch", (1.0, 2.0)))
    for row, values, (name, limits) in zip(rows, stretches, shown, strict=True):
        for axes, (points, (width, height), names) in zip(row, sections, strict=True):
            inside = np.isfinite(points).all(axis=-1)
            picture = np.full(inside.shape, np.nan)
            _, elements = nearest.query(points[inside], k=4)
            picture[inside] = values[elements].mean(axis=-1)
            extent = (0, width, 0, height)
            drawn = axes.imshow(
                picture, origin="lower", extent=extent, vmin=limits[0], vmax=limits[1]
            )
            axes.set(xlabel=f"{names[0]} (mm)", ylabel=f"{names[1]} (mm)")
        figure.colorbar(drawn, ax=row[-1], label=name)
    figure.savefig(out, dpi=110, metadata={"Software": None})
    plt.close(figure)


def _section(labels: Volume, across: str) -> tuple[np.ndarray, tuple[float, float], str]:
    """Return the points of the middle section, nan outside the body, its size and axes in mm."""
    z, y, x = np.nonzero(labels.values)
    middle = {"z": int(np.median(z)), "x": int(np.median(x))}[across]
    low = [int(index.min()) for index in (x, y, z)]
    high = [int(index.max()) + 1 for index in (x, y, z)]
    if across == "z":
        along, names = (np.arange(low[0], high[0]), np.arange(low[1], high[1])), "xy"
        column, row = np.meshgrid(*along)
        index = np.stack([column, row, np.full_like(column, middle)], axis=-1)
    else:
        along, names = (np.arange(low[2], high[2]), np.arange(low[1], high[1])), "zy"
        column, row = np.meshgrid(*along)
        index = np.stack([np.full_like(column, middle), row, column], axis=-1)
    inside = labels.values[index[..., 2], index[..., 1], index[..., 0]] != 0
    points = np.asarray(labels.origin_mm) + np.asarray(labels.spacing_mm) * index
    size = (len(along[0]) * labels.spacing_mm[0], len(along[1]) * labels.spacing_mm[1])
    return np.where(inside[..., None], points, np.nan), size, names


def _stretches(body: SolvedBody) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest principal stretch of each tetrahedron."""
    mesh = body.setup.mesh.finest.mesh
    rest = mesh.nodes[mesh.tets[:, 1:]] - mesh.nodes[mesh.tets[:, :1]]
    moved = body.positions_mm[mesh.tets[:, 1:]] - body.positions_mm[mesh.tets[:, :1]]
    gradient = np.linalg.solve(rest, moved)
    stretches = np.linalg.svd(gradient, compute_uv=False)
    return stretches[:, -1], stretches[:, 0]


if __name__ == "__main__":
    study, pictures = Path(sys.argv[1]), Path(sys.argv[2])
    draw_search(study, pictures / "search.png")
    draw_strain(study, pictures / "strain.png")
