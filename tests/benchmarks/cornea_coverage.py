"""Coverage of the 90 % intervals of a cornea's G0 and stress, over simulated studies.

    python -m tests.benchmarks.cornea_coverage OUT [--eyes 0 1 2 ...] [--kinds clean frames ...]

Eyes of Table 5.2 of the thesis, with their IOP, pachymetry and constants, are deformed on a finer
mesh than that of the studies. The target is the deformed section, or both sections are drawn as
frames and segmented; the eye may move between the frames, or the target may be scaled. One study
of each is run in this process. OUT receives `coverage.md` and `coverage.json`; studies already in
it are read, not run again.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

# One thread for every library; read when it is loaded.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402
from PIL import Image  # noqa: E402

from palpate.service.cluster.task_dispatch import SingleProcess  # noqa: E402
from palpate.service.results.results_as_json import study_json  # noqa: E402
from palpate.service.results.results_from_journal import study_results  # noqa: E402
from palpate.service.study.loop import Study  # noqa: E402
from palpate.service.study.study_keys import StudySpec  # noqa: E402
from palpate.workers.common_keys import validated  # noqa: E402
from palpate.workers.organs.cornea.cornea_keys import CorneaCase  # noqa: E402
from palpate.workers.organs.cornea.cornea_organ import ORGAN  # noqa: E402
from palpate.workers.organs.cornea.corneal_model import CorneaConstants  # noqa: E402
from palpate.workers.organs.cornea.identifiability import uniaxial_stress_mpa  # noqa: E402
from palpate.workers.organs.cornea.section_outline import RigidMotion, Section  # noqa: E402
from palpate.workers.thesis.thesis_eyes import TABLE_5_2, CohortEye  # noqa: E402
from tests.workers.organs.cornea.frames.generated_frame import generated_frame  # noqa: E402

ELEMENTS, TARGET_ELEMENTS, JET_KPA = 960, 5760, 15.0
PIXEL_MM, SHAPE = (0.015625, 0.0165), (300, 800)
SEARCHED = {
    "mu1_pa": [1, 40_000],
    "alpha1": [0.1, 100],
    "mu2_pa": [1, 40_000],
    "alpha2": [0.1, 100],
}


@dataclass(frozen=True)
class Kind:
    """A way to make targets.

    Parameters
    ----------
    frames : bool
        Whether both sections are drawn as frames and segmented.
    shift_mm, tilt_deg : float
        Motion of the whole eye, outwards and counter-clockwise, before the second frame.
    scale : float
        Scale of the second frame.
    iop_mmhg : float
        Excess of the IOP stated in the study.
    """

    frames: bool = True
    shift_mm: float = 0.0
    tilt_deg: float = 0.0
    scale: float = 1.0
    iop_mmhg: float = 0.0


KINDS: Mapping[str, Kind] = {
    "clean": Kind(frames=False),
    "frames": Kind(),
    "shift -0.2 mm": Kind(shift_mm=-0.2),
    "turn 2 degrees": Kind(tilt_deg=2.0),
    "scale 2 %": Kind(scale=1.02),
    "IOP 2 mmHg too high": Kind(iop_mmhg=2.0),
}


@dataclass(frozen=True)
class Interval:
    """One derived value of one study."""

    kind: str
    eye: int
    value: str
    truth: float
    estimate: float
    lower: float | None
    upper: float | None
    quotable: bool
    reasons: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Return True if the interval covers the truth."""
        return self.lower is not None and self.lower <= self.truth <= (self.upper or 0.0)


def constants_of(eye: CohortEye) -> dict[str, float]:
    """Return the constants of an eye as in a study file."""
    one = eye.constants
    names = ("mu1_pa", "alpha1", "mu2_pa", "alpha2")
    return dict(zip(names, (one.mu1_pa, one.alpha1, one.mu2_pa, one.alpha2), strict=True))


def case_of(eye: CohortEye, elements: int, more_iop_mmhg: float = 0.0) -> dict[str, Any]:
    """Return the case of an eye on a mesh."""
    central_mm = eye.pachymetry_um / 1000
    return {
        "organ": "cornea",
        "reference": {"section": {"central_mm": central_mm, "peripheral_mm": central_mm + 0.1}},
        "mesh": {"elements": elements},
        "load": {"iop_mmhg": eye.iop_mmhg + more_iop_mmhg, "jet": {"pressure_kpa": JET_KPA}},
    }


def sections_of(eye: CohortEye) -> tuple[Section, Section]:
    """Return an eye at rest and under the jet."""
    case = validated(CorneaCase, case_of(eye, TARGET_ELEMENTS) | {"constants": constants_of(eye)})
    body = ORGAN.make_body(case.reference)
    mesh = ORGAN.make_mesh(body, case)
    model = ORGAN.prepare(mesh)
    outcome = ORGAN.solve(model, ORGAN.problem(model, case, case.complete(), 0.0))
    if not outcome.converged:
        raise RuntimeError(f"the eye {eye} cannot be simulated: {outcome.reason}")
    return body, ORGAN.deform(body, mesh, outcome.displacement_mm)


def frame_specs(eye: CohortEye, kind: Kind, folder: Path) -> list[dict[str, Any]]:
    """Draw both sections as frames, and return their keys in a study file."""
    rest, jet = sections_of(eye)
    top = float(rest.anterior_mm[:, 1].max())
    place = RigidMotion((SHAPE[1] * PIXEL_MM[0] / 2, -top - 0.6))
    motion = RigidMotion((0.0, kind.shift_mm), float(np.radians(kind.tilt_deg)), (0.0, top - 7.8))
    folder.mkdir(parents=True, exist_ok=True)
    specs = []
    for seed, section in enumerate((rest, motion.of_section(jet))):
        size = (PIXEL_MM[0] / kind.scale, PIXEL_MM[1] / kind.scale) if seed else PIXEL_MM
        shape = tuple(round(n * PIXEL_MM[0] / size[0]) for n in SHAPE)
        frame = generated_frame(place.of_section(section), size, (shape[0], shape[1]), seed=seed)
        file = folder / f"{seed}.png"
        Image.fromarray(frame.grey.astype(np.uint8)).save(file)
        specs.append({"file": str(file.resolve()), "pixel_mm": PIXEL_MM, "refraction": None})
    return specs


def study_of(name: str, number: int, kind: Kind, folder: Path) -> StudySpec:
    """Return the study of one eye."""
    eye = TABLE_5_2[number]
    case, target = case_of(eye, ELEMENTS, kind.iop_mmhg), {}
    if kind.frames:
        rest, jet = frame_specs(eye, kind, folder)
        case["reference"], target = {"frame": rest}, {"frame": jet}
    else:
        target = {"constants": constants_of(eye), "mesh": {"elements": TARGET_ELEMENTS}}
    search = {
        "parameters": SEARCHED,
        "strategy": "genetic+least-squares",
        "population": 16,
        "generations": 2,
        "stall": None,
        "starts": 2,
        "fit_evaluations": 40,
    }
    spec = {"name": name, "case": case, "target": target, "search": search, "seed": number}
    return validated(StudySpec, spec, name)


def intervals_of(kind_name: str, number: int, out: Path) -> list[Interval]:
    """Run one study unless it exists, and return its intervals."""
    name = f"{kind_name.replace(' ', '-').replace('%', 'percent')}-{number}"
    folder = out / name
    if not (folder / "study").exists() or study_results(folder / "study").state != "stopped":
        spec = study_of(name, number, KINDS[kind_name], folder)
        Study(spec, folder / "study", out / "store").run(SingleProcess())
    results = study_results(folder / "study")
    record, truth = study_json(results), _law(TABLE_5_2[number])
    found = []
    for one in results.findings.get("derived", ()):
        shown, stretch = record["derived"][one["name"]], one.get("stretch")
        true_mpa = (
            truth.shear_modulus_mpa
            if stretch is None
            else float(uniaxial_stress_mpa(truth, np.array([stretch]))[0])
        )
        ends = shown["interval"] or {"lower": None, "upper": None}
        found.append(
            Interval(
                kind_name,
                number,
                one["name"],
                1000 * true_mpa,
                shown["value"],
                ends["lower"],
                ends["upper"],
                shown["quotable"],
                tuple(shown["reasons"]),
            )
        )
    return found


def _law(eye: CohortEye) -> CorneaConstants:
    one = eye.constants
    return CorneaConstants((one.mu1_pa / 1e6, one.mu2_pa / 1e6), (one.alpha1, one.alpha2))


def table(found: Sequence[Interval]) -> str:
    """Return coverage by kind as a Markdown table."""
    rows = ["| kind | value | shown | with the truth | error, median (largest) | half width |"]
    rows.append("|---|---|---|---|---|---|")
    for kind in dict.fromkeys(one.kind for one in found):
        for value in ("G0", "stress"):
            own = [o for o in found if o.kind == kind and o.value.startswith(value)]
            shown = [o for o in own if o.quotable]
            errors = [100 * abs(o.estimate / o.truth - 1) for o in own] or [np.nan]
            width = [50 * (o.upper - o.lower) / o.estimate for o in own if o.upper and o.lower]
            held = f"{sum(o.holds for o in shown)} of {len(shown)}"
            rows.append(
                f"| {kind} | {value} | {len(shown)} of {len(own)} | {held} | "
                f"{np.median(errors):.2g} % ({max(errors):.2g} %) | "
                f"{np.median(width or [np.nan]):.2g} % |"
            )
    return "\n".join(rows) + "\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run studies and write their coverage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--eyes", type=int, nargs="+", default=list(range(1, 20, 2)))
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    found: list[Interval] = []
    for eye in options.eyes:
        for kind in options.kinds:
            began = time.perf_counter()
            found += intervals_of(kind, eye, options.out)
            sys.stderr.write(f"{kind}, eye {eye}: {time.perf_counter() - began:.0f} s\n")
    (options.out / "coverage.md").write_text(table(found))
    (options.out / "coverage.json").write_text(json.dumps([asdict(one) for one in found], indent=1))
    sys.stdout.write(table(found))


if __name__ == "__main__":
    main()
