"""Handmade results of all experiments, without simulations."""

import math

from palpate.service.thesis.thesis_experiments import EXPERIMENTS
from palpate.service.thesis.thesis_results import (
    CoefficientsResult,
    Cost,
    Exposed,
    FoundConstant,
    FoundSearch,
    MeanCompression,
    MeshResult,
    SearchResult,
    SolverTime,
    ThesisResults,
    Varied,
)
from palpate.workers.comparison.similarity_coefficients import Coefficients
from palpate.workers.mechanics.fem.boundary_value_problem import Outcome
from palpate.workers.thesis.coefficient_choice import (
    ANGLES_DEG,
    DEFORMATIONS,
    BarExperiment,
    BarRow,
    CylinderRow,
    bend,
    compared_bars,
    force_of,
    make_bar,
    select,
)
from palpate.workers.thesis.mesh_quality import (
    BINS,
    MEASURES,
    Agreement,
    MeshKind,
    QualityRow,
    aspect_rows,
)
from palpate.workers.thesis.phantom_compression import SEARCH_PHANTOMS, TARGETS, Scale, TargetName
from palpate.workers.thesis.thesis_eyes import TABLE_5_1, SyntheticEye


def bar_experiment(scale: Scale) -> BarExperiment:
    """Return the eight wrong deformations of the bar, compared with the gold one."""
    bar = make_bar(scale)
    bent = {number: bend(bar, force_of(number)) for number in (0, *DEFORMATIONS)}
    return compared_bars(scale, bar, bent)


OUTCOME = Outcome(True, "", (3,), (9,), 1e-9, 2.0, 1.0, 1.0, 0.0, 0.9, 1.0, 0.0, 0.0, False)


def coefficients_of(number: int) -> Coefficients:
    """Return coefficients that worsen with the deformation's number, in the thesis' groups."""
    group = {1: 1, 2: 1, 3: 2, 4: 2, 5: 3, 6: 3, 7: 3, 8: 4}[number] + number / 100
    jc = 1 - group / 5
    return Coefficients(
        jc, 2 * jc / (1 + jc), (-1) ** number * 3.0, tuple([group] * 20), 0.1 * (-1) ** number,
        group, group, group / 2, group / 2, math.log((1 - jc) * group),
    )  # fmt: skip


def coefficients_result() -> CoefficientsResult:
    rows = tuple(
        BarRow(n, DEFORMATIONS[n][0], force_of(n), (-20.0 - n, 1.0, 0.5), OUTCOME,
               coefficients_of(n))
        for n in DEFORMATIONS
    )  # fmt: skip
    bar = BarExperiment("sketch", 600, 2.0, (-20.1, 0.0, 1.0), rows)
    turned = []
    for angle in ANGLES_DEG:
        jc = max(abs(math.cos(math.radians(angle))), 0.12) ** 1.5
        distance = 5 * (1 - jc)
        gsf = math.log((1 - jc) * distance) if jc < 1 else -math.inf
        turned.append(CylinderRow(angle, jc, 2 * jc / (1 + jc), distance, gsf))
    least = {90: 0.12}
    turned = [r if r.angle_deg not in least else CylinderRow(90, 0.02, 0.04, 6.0, 1.8)
              for r in turned]  # fmt: skip
    return CoefficientsResult(bar, select(bar), tuple(turned))


def quality_row(phantom: int, kind: MeshKind, aspect: float, worst: float) -> QualityRow:
    tets = 60_000 if kind == "homogeneous" else 320_000
    histogram = tuple(tets // BINS for _ in range(BINS))
    return QualityRow(
        phantom, kind, tets, tets // 5, 12.0,
        {"M1": 0.8, "M2": 0.75, "M3": 0.85, "M4": 0.6, "aspect": aspect}, 0.01, worst, 0,
        Agreement(0.997, -0.00004, 0.0001), dict.fromkeys(MEASURES, histogram),
    )  # fmt: skip


def mesh_result() -> MeshResult:
    quality = tuple(
        quality_row(n, kind, aspect, worst)
        for n in (3, 8)
        for kind, aspect, worst in (
            ("adaptive", 1.47, 5.96), ("adaptive 1 mm", 1.5, 6.0), ("homogeneous", 1.3, 4.0),
        )
    )  # fmt: skip
    means = (
        MeanCompression("CC", "neo-Hookean", 2, 0, 0.21, 8.0, 0.822, 0.2, 0.91, 0.1),
        MeanCompression("MLO", "neo-Hookean", 2, 0, 0.5, 3.0, 0.79, 0.3, 0.9, 0.12),
        MeanCompression("CC", "Mooney-Rivlin", 2, 1, 0.23, 8.0, 0.82, 0.2, 0.91, 0.1),
    )
    times = tuple(
        SolverTime(kind, view, 0.05, 0.01, 320_000, 16.0)
        for kind in ("adaptive", "homogeneous")
        for view in ("CC", "MLO")
    )
    return MeshResult(quality, aspect_rows(quality), (), means, times)


def search_of(target: TargetName, phantom: int) -> FoundSearch:
    constants = tuple(
        FoundConstant(
            name.removesuffix("_kpa"), "kPa", value, value * (1 + 0.004 * (n + 1)), 0.004 * (n + 1),
            0.02 * (n + 1), (0.98 * value, 1.02 * value), 0.01,
        )
        for n, (name, value) in enumerate(TARGETS[target].items())
    )  # fmt: skip
    return FoundSearch(target, phantom, constants, 0.99, 0.05, 0.1, 340, 12, 150.0, 90.0,
                       "all 12 generations are done", "runs/x")  # fmt: skip


def search_result() -> SearchResult:
    every = [(t, n) for t, numbers in SEARCH_PHANTOMS.items() for n in numbers]
    searches = tuple(search_of(t, n) for t, n in every)
    return SearchResult("genetic+least-squares", 30, 12, 5000, 0.5, searches)


def sensitivity_result() -> tuple[Varied, ...]:
    found = []
    for constant, target in TARGETS["X3"].items():
        values = (0.5 * target, 0.75 * target, target, 1.5 * target)
        overlaps, distances = (0.95, 0.97, 1.0, None), (0.4, 0.2, 0.0, None)
        found.append(Varied("X3", constant, target, values, overlaps, distances, distances))
    return tuple(found)


EYE_CONSTANTS = ("mu1", "alpha1", "mu2", "alpha2")


def as_printed(eye: SyntheticEye) -> FoundSearch:
    """Return a search that has found what the thesis prints."""
    every = zip(EYE_CONSTANTS, eye.target, eye.estimate, strict=True)
    constants = tuple(
        FoundConstant(name, "", target, estimate, abs(estimate / target - 1), None, None, None)
        for name, target, estimate in every
    )
    mhd_mm = eye.mhd_um / 1000
    return FoundSearch(
        eye.name, None, constants, eye.jc, mhd_mm, None, 1232, 0, 60.0, 60.0, "done", "runs/x"
    )


def whole() -> ThesisResults:
    """Return results of all experiments."""
    cost = Cost(600.0, 60.0, 12, "a machine, 2 cores")
    return ThesisResults(
        "reduced", "a machine, 2 cores", dict.fromkeys(EXPERIMENTS, cost),
        coefficients_result(), mesh_result(),
        tuple(Exposed(n, view, 0.09, 0.03) for n in (3, 8) for view in ("CC", "MLO")),
        search_result(), sensitivity_result(), tuple(map(as_printed, TABLE_5_1)),
    )  # fmt: skip
