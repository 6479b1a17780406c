"""Small experiments on disk, with recordings of a body of known stiffness."""

from pathlib import Path

import numpy as np
import yaml

SIZE = (12.0, 12.0, 48.0)
MARKERS = {
    "top": ((6.0, 12.0, 48.0), (0.0, 1.0, 0.0)),
    "left": ((0.0, 6.0, 46.0), (-1.0, 0.0, 0.0)),
    "middle": ((6.0, 12.0, 24.0), (0.0, 1.0, 0.0)),
}
BASE = {"b1": [0, 0, 0], "b2": [12, 0, 0], "b3": [0, 12, 0]}
LOADS_N = {"bare": 0.0, "loaded": 0.03}


def described(**changes):
    """Return the content of the file as plain data."""
    data = {
        "organ": "specimen",
        "name": "beam",
        "body": {"box_mm": list(SIZE)},
        "regions": {
            "clamp": {"plane": {"axis": "z", "at_mm": 0}},
            "tip": {"plane": {"axis": "z", "at_mm": SIZE[2]}},
        },
        "materials": {"rubber": {"E_kpa": [40, 400], "nu": 0.45, "density_kg_per_m3": 1200}},
        "holds": [{"region": "clamp"}],
        "down": [0, -2, 0],
        "markers": {
            "column": "{marker}_{axis}",
            "rest_s": [0, 0.5],
            "loaded_s": [-0.5, 0],
            "markers": {
                name: {"at_mm": list(at), "outward": list(out)}
                for name, (at, out) in MARKERS.items()
            },
            "frame": {"at_rest_mm": BASE},
            "sd_mm": 0.02,
        },
        "states": [
            {"name": "bare", "files": ["bare.csv"]},
            {
                "name": "loaded",
                "files": ["loaded.csv"],
                "forces": [{"region": "tip", "force_n": [0, -LOADS_N["loaded"], 0]}],
            },
        ],
        "predict": [{"name": "heavier", "forces": [{"region": "tip", "force_n": [0, -0.05, 0]}]}],
    }
    return data | changes


def write(folder: Path, data) -> Path:
    """Write the file of an experiment."""
    path = folder / "experiment.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def record(path: Path, moved, turn, rng=None, sd=0.0):
    """Write a recording of markers displaced by `moved`, (k, 3), in cameras rotated by `turn`."""
    rest = {name: np.array(at) for name, (at, _) in MARKERS.items()}
    rest |= {name: np.array(at, float) for name, at in BASE.items()}
    shifts = dict(zip(MARKERS, moved, strict=True))
    times = np.arange(0, 2.001, 0.1)
    lines = ["t_s," + ",".join(f"{name}_{a}" for name in rest for a in "xyz")]
    noise = {n: sd * rng.standard_normal(3) if rng is not None else np.zeros(3) for n in MARKERS}
    for t in times:
        row = [f"{t:.3f}"]
        for name, at in rest.items():
            here = at + (t > 1) * (shifts.get(name, np.zeros(3)) + noise.get(name, np.zeros(3)))
            row += [f"{v:.9f}" for v in here @ turn + [5.0, 6.0, 7.0]]
        lines.append(",".join(row))
    path.write_text("\n".join(lines) + "\n")
