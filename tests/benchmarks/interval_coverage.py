"""Coverage of the 90 % intervals reported as quotable, over simulated studies.

    python -m tests.benchmarks.interval_coverage OUT [--seeds 1 2 3] [--kinds clean shift-4 ...]

A breast of known constants is compressed on a finer mesh than those of the studies. Its label
volume is the target, or is shifted, turned, scaled or mirrored first; or the body is compressed
with another law, with friction, or with another force than the study states. One least-squares
study of each is run in this process. OUT receives `coverage.md` and `coverage.json`; studies
already in it are read, not run again.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

# One thread for every library; read when it is loaded.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

from palpate.service.cluster.task_dispatch import SingleProcess  # noqa: E402
from palpate.service.export import export_volume  # noqa: E402
from palpate.service.results.results_as_json import study_json  # noqa: E402
from palpate.service.results.results_from_journal import study_results  # noqa: E402
from palpate.service.study.loop import Study  # noqa: E402
from palpate.service.study.study_keys import StudySpec  # noqa: E402
from palpate.storage.store import open_store  # noqa: E402
from palpate.storage.stored_arrays import load_volume  # noqa: E402
from palpate.storage.values import Tissue, Volume  # noqa: E402
from palpate.workers.common_keys import validated  # noqa: E402
from palpate.workers.tasks.study_tasks import simulate_once  # noqa: E402

SPACING_MM, NODES, TARGET_NODES, FORCE_N = 2.0, 2_000, 14_000, 60.0
SEARCHED = {"E_fat_kpa": [4.0, 30.0], "eta_fat_kpa": [20.0, 400.0], "E_glandular_kpa": [8.0, 160.0]}
HELD = {"eta_glandular_kpa": 150.0}
LEVEL = 0.9


@dataclass(frozen=True)
class Kind:
    """A way to make targets.

    Parameters
    ----------
    target : mapping
        Parameters of the model for its compression, other than the constants.
    model : mapping
        Settings of the law for its compression.
    force : float
        Ratio of the compressing force to the one stated in the study.
    shift_mm, turn_deg : tuple of float
        Shift along and rotation about x, y and z of its labels.
    scale : float
        Scale of its labels.
    mirrored : bool
        Whether its labels are upside down.
    imaged : bool
        Whether the study treats it as an image.
    """

    target: Mapping[str, float] = field(default_factory=dict)
    model: Mapping[str, str] = field(default_factory=dict)
    force: float = 1.0
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    mirrored: bool = False
    imaged: bool = True


KINDS: Mapping[str, Kind] = {
    "clean": Kind(imaged=False),
    "clean image": Kind(),
    "shift 4 mm along z": Kind(shift_mm=(0.0, 0.0, 4.0)),
    "shift 4 mm along x": Kind(shift_mm=(4.0, 0.0, 0.0)),
    "shift 8 mm along x": Kind(shift_mm=(8.0, 0.0, 0.0)),
    "turn 3 degrees": Kind(turn_deg=(0.0, 3.0, 0.0)),
    "scale 3 %": Kind(scale=1.03),
    "scale 5 %": Kind(scale=1.05),
    "mirrored": Kind(mirrored=True),
    "isochoric law": Kind(model={"fibre_invariant": "isochoric"}),
    "literal fibres": Kind(model={"fibres": "literal"}),
    "friction 0.3": Kind(target={"friction": 0.3}),
    "force 10 % higher": Kind(force=1.1),
    "force 10 % lower": Kind(force=0.9),
}


@dataclass(frozen=True)
class Interval:
    """One constant of one study."""

    kind: str
    seed: int
    constant: str
    truth: float
    estimate: float
    lower: float | None
    upper: float | None
    quotable: bool
    reasons: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Return True if the interval covers the truth."""
        shown = self.lower is not None and self.upper is not None
        return shown and self.lower <= self.truth <= self.upper  # type: ignore[operator]


def true_constants(seed: int) -> dict[str, float]:
    """Return the constants of a body."""
    rng = np.random.default_rng([seed, 0xC0])
    fat = float(np.exp(rng.uniform(np.log(7), np.log(14))))
    gland = fat * float(np.exp(rng.uniform(np.log(2), np.log(5))))
    return {
        "E_fat_kpa": round(fat, 2),
        "eta_fat_kpa": round(float(np.exp(rng.uniform(np.log(60), np.log(180)))), 1),
        "E_glandular_kpa": round(gland, 2),
    }


def case_of(seed: int, nodes: int, kind: Kind | None = None) -> dict[str, Any]:
    """Return the case of a study, or of the target of a given kind."""
    phantom = {"preset": "250ml", "spacing_mm": SPACING_MM, "seed": seed}
    fraction = 0.15 + 0.05 * (seed % 3)
    return {
        "organ": "breast",
        "reference": {"phantom": phantom | {"glandular_fraction": fraction}},
        "mesh": {"nodes": nodes},
        "model": {} if kind is None else dict(kind.model),
        "load": {"force_n": FORCE_N * (1.0 if kind is None else kind.force)},
        "constants": dict(HELD),
    }


def target_labels(seed: int, kind: Kind, store: Path) -> Volume:
    """Compress a body and return its labels as in the study's image."""
    case = case_of(seed, TARGET_NODES, kind)
    case["constants"] |= true_constants(seed) | dict(kind.target)
    made = simulate_once(case, {}, str(store))
    volume = made.get("volume")
    if volume is None:
        raise RuntimeError(f"the target cannot be simulated: {made['reason']}")
    return moved(load_volume(open_store(str(store)), volume), kind)


def moved(labels: Volume, kind: Kind) -> Volume:
    """Return labels mirrored, turned and scaled about their middle, then shifted."""
    values = labels.values[::-1] if kind.mirrored else labels.values
    spacing = np.asarray(labels.spacing_mm)
    count = np.asarray(values.shape[::-1])
    middle = np.asarray(labels.origin_mm) + spacing * (count - 1) / 2
    if any(kind.turn_deg):
        margin = 10
        z, y, x = np.indices(tuple(n + 2 * margin for n in values.shape)) - margin
        at = np.stack([x, y, z], axis=-1) * spacing - spacing * (count - 1) / 2
        back = Rotation.from_euler("xyz", kind.turn_deg, degrees=True).inv()
        index = back.apply(at.reshape(-1, 3)) / spacing + (count - 1) / 2
        nearest = np.floor(index + 0.5).astype(int)
        inside = ((nearest >= 0) & (nearest < count)).all(axis=1)
        turned = np.full(len(nearest), Tissue.AIR, values.dtype)
        i, j, k = nearest[inside].T
        turned[inside] = values[k, j, i]
        values = turned.reshape(x.shape)
        count = count + 2 * margin
    spacing = spacing * kind.scale
    origin = middle - spacing * (count - 1) / 2 + kind.shift_mm
    return Volume(
        np.ascontiguousarray(values), tuple(map(float, spacing)), tuple(map(float, origin))
    )


def study_of(name: str, seed: int, kind: Kind, folder: Path) -> StudySpec:
    """Return the study of one target; an image is created for it."""
    case = case_of(seed, NODES)
    target: dict[str, Any]
    if kind.imaged:
        path = folder / "target.nrrd"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            export_volume(path, target_labels(seed, kind, folder.parent / "store"))
        target = {"volume": str(path.resolve())}
    else:
        target = {"constants": true_constants(seed) | HELD, "mesh": {"nodes": TARGET_NODES}}
    spec = {
        "name": name,
        "case": case,
        "target": target,
        "search": {"strategy": "least-squares", "parameters": SEARCHED},
        "seed": seed,
    }
    return validated(StudySpec, spec, name)


def intervals_of(kind_name: str, seed: int, out: Path) -> list[Interval]:
    """Run one study unless it exists, and return its intervals."""
    name = f"{kind_name.replace(' ', '-').replace('%', 'percent')}-{seed}"
    folder = out / name
    if not _has_ended(folder / "study"):
        spec = study_of(name, seed, KINDS[kind_name], folder)
        Study(spec, folder / "study", out / "store").run(SingleProcess())
    record = study_json(study_results(folder / "study"))
    return [
        _interval(kind_name, seed, true_constants(seed)[f"{constant}_kpa"], constant, record)
        for constant in record["estimates"]
    ]


def _has_ended(folder: Path) -> bool:
    return folder.exists() and study_results(folder).state == "stopped"


def _interval(
    kind: str, seed: int, truth: float, constant: str, record: Mapping[str, Any]
) -> Interval:
    estimate = record["estimates"][constant]
    ends = estimate.get("interval")
    lower, upper = (None, None) if ends is None else (ends["lower"], ends["upper"])
    return Interval(
        kind,
        seed,
        constant,
        truth,
        estimate["estimate"],
        lower,
        upper,
        estimate["quotable"],
        tuple(estimate["reasons"]),
    )


def table(found: Sequence[Interval]) -> str:
    """Return coverage by kind as a Markdown table."""
    rows = ["| kind | intervals | quotable | of these with the truth | reasons against |"]
    rows.append("|---|---|---|---|---|")
    for kind in dict.fromkeys(one.kind for one in found):
        own = [one for one in found if one.kind == kind]
        shown = [one for one in own if one.quotable]
        share = f"{100 * np.mean([one.holds for one in shown]):.0f} %" if shown else "-"
        held = f"{sum(one.holds for one in shown)} ({share})"
        why = sorted({reason.split(" (")[0] for one in own for reason in one.reasons})
        rows.append(f"| {kind} | {len(own)} | {len(shown)} | {held} | {'; '.join(why)} |")
    return "\n".join(rows) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run studies and write their coverage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    found: list[Interval] = []
    for seed in options.seeds:
        for kind in options.kinds:
            began = time.perf_counter()
            found += intervals_of(kind, seed, options.out)
            sys.stderr.write(f"{kind}, seed {seed}: {time.perf_counter() - began:.0f} s\n")
    (options.out / "coverage.md").write_text(table(found))
    (options.out / "coverage.json").write_text(json.dumps([asdict(one) for one in found], indent=1))
    sys.stdout.write(table(found))


if __name__ == "__main__":
    main()
