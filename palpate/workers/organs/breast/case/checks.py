"""Plausibility checks of a case, from its file and its scans."""

from collections.abc import Iterator

from palpate.storage.values import Tissue
from palpate.workers.body.images.labels import resample_labels
from palpate.workers.comparison.similarity.overlap import jaccard
from palpate.workers.organs.breast.case.alignment import case_load
from palpate.workers.organs.breast.case.scanned_case import ScannedCase
from palpate.workers.organs.breast.case.spec import ALONG_Y, CaseFile
from palpate.workers.organs.breast.plausibility.checks import findings_of
from palpate.workers.organs.breast.plausibility.extents import unit_axis
from palpate.workers.organs.breast.plausibility.scan_facts import BreastFacts, Scan
from palpate.workers.organs.study_checks import Finding, accept
from palpate.workers.units import KPA

# Minimum Jaccard coefficient of the glandular tissue in two segmentations of one scan.
SAME_GLAND = 0.5
# Swelling is a cause that a diagnosis can find: 12 % of gland that fills a third of a body.
SWELLING = 0.04


def check_case(case: ScannedCase, *, anyway: bool = False) -> list[Finding]:
    """Reject scans that cannot show one body under these loads.

    Parameters
    ----------
    case : ScannedCase
    anyway : bool
        Accept implausible scans.

    Raises
    ------
    InputError
        If the scans are rejected; the message lists every reason.
    """
    return accept(case_findings(case), f"The case {case.file.name}", anyway=anyway)


def case_findings(case: ScannedCase) -> Iterator[Finding]:
    """Yield the findings about a case: first whether it can be diagnosed, then the rest."""
    facts = facts_of(case)
    missing = [finding for scan in facts.scans for finding in _tissues(scan)]
    yield from missing
    if missing:
        return
    yield from _repeat(case)
    yield from findings_of(facts)


def facts_of(case: ScannedCase) -> BreastFacts:
    """Return the facts to check; a planned case has only the scan at rest."""
    loads = [case_load(case, number) for number in range(len(case.loads))]
    scanned = case.deformed if case.is_scanned else []
    scans = [
        Scan(load.volume, load.force_n, unit_axis(load.axis), case.above_wall(labels), labels)
        for load, labels in zip(case.loads, scanned, strict=False)
    ]
    young = [KPA.to_inside(value) for value in _values(case.file, "E_fat_kpa")]
    return BreastFacts(
        rest=Scan(case.file.scans.reference, 0.0, ALONG_Y, case.reference),
        pressed=list(zip(scans, loads, strict=False)),
        loads=loads,
        least_nu=case.file.nu,
        E_mpa=(min(young), max(young)),
        align_key="scans.align",
        aligned=case.file.scans.align is not None,
        swelling=SWELLING,
        rigid_is_refused=False,
    )


def _values(file: CaseFile, name: str) -> tuple[float, ...]:
    value = file.constants[name]
    if isinstance(value, str):
        return ()
    return value if isinstance(value, tuple) else (value,)


def _tissues(scan: Scan) -> Iterator[Finding]:
    for tissue in (Tissue.FAT, Tissue.GLANDULAR):
        if not (scan.labels.values == tissue).any():
            yield Finding(
                "impossible",
                f"{scan.file} has no voxel labelled {tissue.name.lower()} ({int(tissue)}) above "
                "the chest wall, expected both fat (1) and glandular tissue (2). Segment them, or "
                "write an origin into its header that puts the chest wall at the z of the case.",
            )


def _repeat(case: ScannedCase) -> Iterator[Finding]:
    if case.repeat is None:
        return
    here = case.reference.values == Tissue.GLANDULAR
    there = resample_labels(case.repeat, case.reference).values == Tissue.GLANDULAR
    found = jaccard(int((here & there).sum()), int(here.sum()), int(there.sum()))
    if found < SAME_GLAND:
        yield Finding(
            "implausible",
            f"The glandular tissue in {case.file.scans.reference_repeat} overlaps that of the "
            f"reference scan with a Jaccard of {found:.2f}; two segmentations of the same scan "
            f"reach {SAME_GLAND} or more. Segment the reference scan again, or omit "
            "scans.reference_repeat.",
        )
