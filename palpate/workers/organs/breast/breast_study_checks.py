"""Plausibility checks of the file and the scans of a breast study."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import check_node_count, check_node_count_of
from palpate.workers.mechanics.model_parameters import BREAST, Bounds
from palpate.workers.organs.breast.breast_effects import BREAST_MODEL
from palpate.workers.organs.breast.breast_keys import (
    BreastCase,
    BreastScore,
    BreastTarget,
    PhantomSpec,
)
from palpate.workers.organs.breast.breast_problem import compression_axis, problem_of
from palpate.workers.organs.breast.scan_alignment import study_load
from palpate.workers.organs.breast.scan_border import check_cut
from palpate.workers.organs.breast.scan_facts import BreastFacts, Scan, Tissues
from palpate.workers.organs.breast.scan_plausibility import (
    FEWEST_VOXELS,
    check_empty_slices,
    check_enclosed_air,
    check_pieces,
    check_specks,
    check_volume_range,
    findings_of,
    too_few,
)
from palpate.workers.organs.plausibility_rule import Finding

# Plates of a problem of which only the constants are read.
UNIT_EXTENT = (0.0, 1.0)


@dataclass(frozen=True)
class BreastChecks:
    """Checks of a breast study; see `workers.organs.plausibility_rule.StudyChecks`.

    Parameters
    ----------
    searched : mapping of str to (float, float)
        Searched intervals, in internal names and units.
    """

    searched: Mapping[str, Bounds] = field(default_factory=dict)

    def with_search(self, searched: Mapping[str, Bounds]) -> Self:
        """Return the checks of a study that searches these intervals."""
        return type(self)(searched)

    def of_case(self, case: BreastCase) -> Iterator[Finding]:
        """Check that a phantom can be meshed with the given number of nodes."""
        phantom = case.reference.phantom
        if phantom is None or case.mesh.nodes is None:
            return
        body = phantom.settings
        shortest = min(body.width_mm, 2 * body.half_width_mm, body.depth_mm)
        try:
            check_node_count(case.mesh.nodes, 1000 * body.outline_ml, shortest)
        except InputError as error:
            yield Finding("impossible", f"case.mesh.nodes: {error}")

    def before_bodies(
        self, case: BreastCase, target: BreastTarget, score: BreastScore
    ) -> Iterator[Finding]:
        """Check that a phantom has the tissues that are compared."""
        phantom = case.reference.phantom
        if phantom is not None:
            yield from _missing(score, _tissues_of(phantom), "The phantom")

    def of_body(self, body: Volume, name: str) -> Iterator[Finding]:
        """Check a single body, with warnings for pieces, gaps and cuts."""
        scan = Scan(name, None, compression_axis(0.0), body)
        yield from check_volume_range(scan)
        yield from check_cut(scan)
        for check in (check_empty_slices, check_pieces, check_enclosed_air, check_specks):
            yield from (Finding("warning", finding.text) for finding in check(scan))

    def of_bodies(
        self,
        case: BreastCase,
        target: BreastTarget | None,
        score: BreastScore | None,
        reference: Volume | None,
        deformed: Volume | None,
    ) -> Iterator[Finding]:
        """Check sizes, tissues and loads, and that two images show one body."""
        facts = self._facts(case, target, reference, deformed)
        for scan in facts.scans if score is not None else ():
            yield from _missing(score, set(scan.voxels), scan.file)
            yield from _few(score, scan)
        if reference is not None:
            yield from _mesh(case, reference)
        yield from findings_of(facts)

    def _facts(
        self,
        case: BreastCase,
        target: BreastTarget | None,
        reference: Volume | None,
        deformed: Volume | None,
    ) -> BreastFacts:
        load = study_load(case)
        rest = scan = None
        if reference is not None:
            rest = Scan(_name(case.reference.volume), 0.0, load.axis, reference)
        if deformed is not None and target is not None:
            scan = Scan(_name(target.volume), load.force_n, load.axis, deformed)
        return BreastFacts(
            rest=rest,
            pressed=[] if scan is None else [(scan, load)],
            loads=[load],
            least_nu=self._bounds(case, "nu")[0],
            E_mpa=self._bounds(case, "E_fat"),
            align_key="target.align",
            aligned=target is not None and target.is_aligned,
            swelling=0.0,
            rigid_is_refused=not self._has_effects(case),
            softest=self._tissues(case, 0),
            stiffest={} if case.model.skin != "none" else self._tissues(case, 1),
        )

    def _tissues(self, case: BreastCase, end: int) -> Tissues:
        """Return the constants of the tissues at the lower (0) or the upper (1) bounds."""
        values = {
            name: bounds[end]
            for name, bounds in self.searched.items()
            if name.startswith(("E_", "eta_")) or name in case.model.law.constants.names
        }
        return problem_of(case.model, case.load, case.complete(values), UNIT_EXTENT).constants

    def _bounds(self, case: BreastCase, name: str) -> Bounds:
        """Return the searched interval of a constant, or its value twice."""
        value = case.complete()[name]
        return self.searched.get(name, (value, value))

    def _has_effects(self, case: BreastCase) -> bool:
        """Check whether the model has an effect, which may move or tilt the body."""
        values = case.complete()
        neutral = BREAST_MODEL.complete({}, {})
        named = [name for name in BREAST_MODEL.names if name not in BREAST]
        return any(name in self.searched or values[name] != neutral[name] for name in named)


CHECKS = BreastChecks()


def _tissues_of(phantom: PhantomSpec) -> set[Tissue]:
    settings = phantom.settings
    present = {Tissue.FAT, Tissue.GLANDULAR}
    if settings.skin_mm > 0:
        present.add(Tissue.SKIN)
    if settings.ligament_mm > 0:
        present.add(Tissue.LIGAMENT)
    return present


def _missing(score: BreastScore | None, present: set[Tissue], where: str) -> Iterator[Finding]:
    there = ", ".join(t.name.lower() for t in sorted(present) if t != Tissue.AIR)
    for tissue in () if score is None else score.tissues:
        if tissue not in present:
            yield Finding(
                "impossible",
                f"score.labels: {tissue.name.lower()} is to be compared, but {where} has none: "
                f"found {there}. Name tissues that both bodies have, or check the label map.",
            )


def _few(score: BreastScore | None, scan: Scan) -> Iterator[Finding]:
    """Reject compared tissues of a few voxels."""
    for tissue in () if score is None else score.tissues:
        if scan.voxels.get(tissue, FEWEST_VOXELS) < FEWEST_VOXELS and tissue != Tissue.GLANDULAR:
            yield Finding("implausible", f"score.labels: {too_few(scan, tissue).text}")


def _mesh(case: BreastCase, reference: Volume) -> Iterator[Finding]:
    if case.mesh.nodes is not None:
        try:
            check_node_count_of(case.mesh.nodes, reference)
        except InputError as error:
            yield Finding("impossible", f"case.mesh.nodes: {error}")


def _name(volume: str | None) -> str:
    return Path(str(volume)).name
