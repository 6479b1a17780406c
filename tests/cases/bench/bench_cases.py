"""Tables of the exact motion of four markers on a 30 x 30 x 60 mm block pulled with 18 N."""

from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import fsolve

SIZE = (30.0, 30.0, 60.0)
FORCE_N, YOUNG_MPA, NU = 18.0, 0.2, 0.45
MARKERS = {
    "M1": (15.0, 30.0, 20.0),
    "M2": (30.0, 15.0, 25.0),
    "M3": (15.0, 30.0, 35.0),
    "M4": (30.0, 10.0, 40.0),
}
TIMES_S = np.arange(13) / 4
LOADED = np.clip((TIMES_S - 0.75) / 1.25, 0, 1)
HEAD = ["t_s", *(f"{name}_{axis}_mm" for name in MARKERS for axis in "xyz")]


def stretches(force_n=FORCE_N, young_mpa=YOUNG_MPA):
    """Return the stretches across and along a bar with mu/2 (I1 J^-2/3 - 3) + K/2 (J - 1)^2."""
    mu, bulk = young_mpa / (2 * (1 + NU)), young_mpa / (3 * (1 - 2 * NU))
    stress = force_n / (SIZE[0] * SIZE[1])

    def balance(both):
        across, along = both
        J = across**2 * along
        first = 2 * across**2 + along**2

        def nominal(own):
            return mu * J ** (-2 / 3) * (own - first / (3 * own)) + bulk * (J - 1) * J / own

        return nominal(across), nominal(along) - stress

    across, along = fsolve(balance, (1 - NU * stress / young_mpa, 1 + stress / young_mpa))
    return float(across), float(along)


def motion(points, force_n=FORCE_N):
    """Return the displacements of points of the block, shape (k, 3)."""
    across, along = stretches(force_n)
    return np.asarray(points) * (np.array([across, across, along]) - 1)


def rows(loaded=LOADED):
    """Return time and positions of all markers in each frame, shape (13, 13)."""
    points = np.array(list(MARKERS.values()))
    places = points + loaded[:, None, None] * motion(points)
    return np.column_stack([TIMES_S, places.reshape(len(TIMES_S), -1)])


def text_of(values, head=HEAD, mark=",", decimal="."):
    """Return a table as text."""
    lines = [[f"{v:.6f}".replace(".", decimal) for v in row] for row in np.asarray(values)]
    return "\n".join(mark.join(line) for line in [list(head), *lines]) + "\n"


def described(**changes):
    """Return the file of the experiment as plain data."""
    data = {
        "organ": "specimen",
        "name": "block",
        "body": {"box_mm": list(SIZE)},
        "regions": {
            "bottom": {"plane": {"axis": "z", "at_mm": 0}},
            "left": {"plane": {"axis": "x", "at_mm": 0}},
            "front": {"plane": {"axis": "y", "at_mm": 0}},
            "top": {"plane": {"axis": "z", "at_mm": SIZE[2]}},
        },
        "materials": {"gel": {"E_kpa": [50, 800], "nu": NU, "density_kg_per_m3": 1000}},
        "holds": [
            {"region": "bottom", "axes": ["z"]},
            {"region": "left", "axes": ["x"]},
            {"region": "front", "axes": ["y"]},
        ],
        "down": [0, 0, -1],
        "markers": {
            "rest_s": [0, 0.75],
            "loaded_s": [-1, 0],
            "sd_mm": 0.05,
            "markers": {name: {"at_mm": list(at)} for name, at in MARKERS.items()},
        },
        "states": [
            {
                "name": "pulled",
                "forces": [{"region": "top", "force_n": [0, 0, FORCE_N]}],
                "files": ["a.csv", "b.csv"],
            }
        ],
    }
    return data | changes


def write(folder: Path, data=None, a=None, b=None) -> Path:
    """Write the experiment with two repeats."""
    path = folder / "experiment.yaml"
    path.write_text(yaml.safe_dump(data or described(), sort_keys=False))
    for name, text in (("a.csv", a), ("b.csv", b)):
        content = text_of(rows()) if text is None else text
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        else:
            (folder / name).write_text(content, encoding="utf-8")
    return path
