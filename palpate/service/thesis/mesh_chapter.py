"""Chapter on homogeneous and adaptive meshes."""

from collections.abc import Sequence
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from palpate.service.number_formatting import count, duration, number
from palpate.service.report.drawing.colours import TISSUE_PALETTE, colour_table
from palpate.service.report.drawing.volume_sections import VIEWS, middle_mm, section
from palpate.service.report.page.page_elements import Picture, picture, small_chart
from palpate.service.thesis import chapter_elements, printed_results
from palpate.service.thesis.chapter_elements import Chapter, Table, cost_rows, mesh_sections
from palpate.service.thesis.thesis_experiments import SHOWN_PHANTOM
from palpate.service.thesis.thesis_results import Cost, MeanCompression, MeshResult
from palpate.storage.values import Tissue
from palpate.workers.tasks.thesis_tasks import Measure, Press, coronal_section, pressed
from palpate.workers.thesis.mesh_quality import KINDS, MEASURES, MeshKind, QualityRow
from palpate.workers.thesis.phantom_compression import Scale

THESIS_TIME = (
    "7 h and 2 h for a CC compression, 2 h and 1.45 h for MLO, adaptive and homogeneous, "
    + ("FEBio on 12 cores")
)

# Traced iteration by iteration at the reduced scale.
FOLDS_OF_PHANTOM_9 = (
    "In phantom 9 a compartment reaches the skin where chest wall and moving plate meet (x 21 mm). "
    "On the adaptive mesh the soft layer of 1.5 mm between it and the plate begins to fold: its "
    "nodes oscillate by some tenths of a millimetre from one iteration to the next, the tangent "
    "is indefinite, and sixty iterations reduce the energy by only 0.04 of 178.6 mJ without "
    "convergence. The homogeneous mesh has one cell across that layer, which cannot fold."
)
# Red, green, blue and opacity of the overlap of both slices, and of the parts in only one.
THERE, DIFFERS = (138, 148, 161, 60), (196, 78, 0, 255)


def chapter(found: MeshResult, cost: Cost | None, store: str, scale: Scale) -> Chapter:
    """Return the chapter of thesis section 4.4."""
    return Chapter(
        "mesh-quality",
        "Homogeneous or adaptive meshes",
        "Thesis 4.4",
        _verdict(found),
        "Ten phantoms of 7 to 35 % dense tissue are meshed homogeneously (425 000 tetrahedra, one "
        "mesh for all) and adaptively (900 000, Simpleware), pressed to 50 % (CC) and by 25 % at "
        "45° (MLO) with neo-Hookean and Mooney-Rivlin tissue, and compared compartment by "
        "compartment.",
        "Both meshes are Palpate's own: one body-centred lattice for all, and one graded 2:1 that "
        "is cut along the glandular surface and preserves every volume. "
        + (
            "The full bodies, voxels of 0.2 mm."
            if scale == "full"
            else "Bodies of an eighth of the volume with compartments of the same size."
        ),
        tables=(_aspects(found), _sizes(found), _compartments(found), _times(found)),
        pictures=(
            picture(
                chapter_elements.quality_bars(found.quality),
                "Means of the five quality measures for each kind of mesh.",
                "M1 to M5 (thesis Fig. 4.15); lines: deviation between phantoms.",
            ),
            picture(
                chapter_elements.quality_histograms(found.quality),
                "Histograms of the quality measures and the aspect ratio.",
                "All tetrahedra of all phantoms.",
            ),
            *sections(store, scale),
            *slices(store, scale),
        ),
        differences=_differences(scale, found),
        costs=cost_rows(cost, THESIS_TIME),
    )


def _verdict(found: MeshResult) -> str:
    by_kind = {row.kind: row for row in found.aspects}
    text = (
        f"Average aspect ratio {number(by_kind['adaptive'].average, 3)} adaptive and "
        f"{number(by_kind['homogeneous'].average, 3)} homogeneous (thesis 1.70 and 1.55), at worst "
        f"{number(by_kind['adaptive'].worst, 3)} and {number(by_kind['homogeneous'].worst, 3)}."
    )
    first = next((m for m in found.means if (m.view, m.law) == ("CC", "neo-Hookean")), None)
    if first is not None:
        text += f" Pressed in CC, compartments overlap by JC {number(first.jc, 3)} (0.826)."
    return text


def _of(rows: Sequence[QualityRow], kind: MeshKind) -> list[QualityRow]:
    return [row for row in rows if row.kind == kind]


def _aspects(found: MeshResult) -> Table:
    rows = []
    for row in found.aspects:
        theirs = printed_results.ASPECTS.get(row.kind)
        bad = sum(r.bad for r in _of(found.quality, row.kind))
        printed_values = (
            ("–", "–") if theirs is None else (f"{theirs.average:.2f}", f"{theirs.worst:.2f}")
        )
        rows.append(
            [
                row.kind,
                printed_values[0],
                f"{row.average:.2f}",
                printed_values[1],
                f"{row.worst:.2f}",
                str(bad),
            ]
        )
    headings = ("Mesh", "Average, thesis", "Palpate", "Worst, thesis", "Palpate", "10 or more")
    note = "Longest edge divided by shortest altitude, 1 for a regular tetrahedron."
    return Table("Aspect ratios (Table 4.2)", headings, rows, note=note)


def _sizes(found: MeshResult) -> Table:
    rows = []
    for kind in KINDS:
        of_kind = _of(found.quality, kind)
        if not of_kind:
            continue
        tets = round(fmean(r.tets for r in of_kind))
        nodes = round(fmean(r.nodes for r in of_kind))
        means = [f"{fmean(r.mean[m] for r in of_kind):.3f}" for m in MEASURES[:4]]
        labels = min(r.agreement.labels for r in of_kind)
        gland = max((r.agreement.tissue_volume for r in of_kind), key=abs)
        rows.append(
            [
                kind,
                count(tets),
                count(nodes),
                *means,
                f"{100 * labels:.1f} %",
                f"{100 * gland:+.3f} %".replace("-", "−"),
                duration(fmean(r.seconds for r in of_kind)),
            ]
        )
    headings = (
        "Mesh",
        "Tetrahedra",
        "Nodes",
        "M1",
        "M2",
        "M3",
        "M4",
        "Voxels right, least",
        "Gland volume, worst",
        "To mesh",
    )
    note = (
        "Voxels right: share of the body in a tetrahedron of the same tissue. Processor time. The "
        "thesis has 900 000 tetrahedra adaptive and 425 000 homogeneous in a body of 250 ml."
    )
    return Table("Sizes, quality and accuracy", headings, rows, note=note)


def _compartments(found: MeshResult) -> Table:
    rows: list[list[str]] = []
    for mean in found.means:
        table = (
            printed_results.TABLE_43 if mean.law == "neo-Hookean" else printed_results.MOONEY_RIVLIN
        )
        theirs = table[mean.view]
        values = [theirs.centroid_mm, theirs.volume_mm3, theirs.jc, theirs.mhd_mm]
        rows.append(
            [f"{mean.view}, {mean.law}, thesis", *(number(v, 3) for v in values), "–", "10"]
        )
        rows.append([f"{mean.view}, {mean.law}, Palpate", *_ours(mean)])
    headings = ("", "Centroids, mm", "Volume, mm³", "JC", "MHD, mm", "JC of all", "Phantoms")
    note = (
        "Homogeneous against adaptive, mean over the glandular compartments of a phantom and over "
        "the phantoms. JC of all: of all compartments as one set."
    )
    return Table("Compartments (Table 4.3 and section 4.4.4)", headings, rows, note=note)


def _ours(mean: MeanCompression) -> list[str]:
    values = (mean.centroid_mm, mean.volume_mm3, mean.jc, mean.mhd_mm, mean.whole_jc)
    lost = f", {mean.diverged} diverged" if mean.diverged else ""
    return [*(number(v, 3) for v in values), f"{mean.phantoms}{lost}"]


def _times(found: MeshResult) -> Table:
    rows = []
    for time in found.times:
        theirs = printed_results.SECONDS_PER_1000[time.mesh] if time.view == "CC" else None
        hours = printed_results.HOURS_OF_A_COMPRESSION[time.mesh, time.view]
        rows.append(
            [
                f"{time.mesh}, {time.view}",
                number(theirs, 3),
                f"{number(time.mean_s, 2)} ± {number(time.sd_s, 2)}",
                f"{hours:g} h",
                duration(time.whole_s),
                count(time.tets),
            ]
        )
    headings = ("", "s per 1000, thesis", "Palpate", "Compression, thesis", "Palpate", "Tetrahedra")
    note = "Thesis: wall time on 12 cores. Palpate: processor time of the solver on one core."
    return Table("Time (Fig. 4.16)", headings, rows, note=note)


def _differences(scale: Scale, found: MeshResult) -> tuple[str, ...]:
    texts = [
        "The thesis holds the nodes that initially touch the fixed plate. On a round body they "
        "are few, and their choice shifts the body between the plates. Here a depth of 2 mm is "
        "held, determined from the voxels so that both meshes are held at the same place. "
        "Centroid distances and JC depend more on this choice than on any other.",
        "CC is printed as 100 mm to 50 mm, the lateral width; so the plates press along y.",
        "The Mooney-Rivlin constants are not printed. The shear moduli of Table 4.1 are kept, two "
        "thirds of them in C10.",
        "A volume difference of 0.0065 % is the Mooney-Rivlin one; the neo-Hookean 14.08 mm³ are "
        "0.0056 % of 250 ml.",
    ]
    if scale != "full":
        smaller = (
            "The reduced bodies are half as wide, but compartments have their full size: they "
            "are displaced less, and each is a larger part of the body."
        )
        texts.insert(0, smaller)
    failed = _without_equilibrium(found)
    if failed:
        texts.append(f"Without equilibrium, and excluded from the means: {'; '.join(failed)}.")
    if scale == "reduced" and any(text.startswith("phantom 9, CC") for text in failed):
        texts.append(FOLDS_OF_PHANTOM_9)
    worst = min((r.agreement.labels for r in _of(found.quality, "adaptive")), default=1.0)
    if worst < 0.985:
        texts.append(
            "Fewer than 98.5 % of the voxels are in a tetrahedron of their tissue: ligaments of "
            "0.6 mm between glandular compartments are thinner than the smallest cells, 0.7 mm."
        )
    return tuple(texts)


def _without_equilibrium(found: MeshResult) -> list[str]:
    """Return the compressions that did not converge, with their reasons."""
    return [
        f"phantom {row.phantom}, {row.view}, {row.law}, {mesh} mesh ({outcome.reason})"
        for row in found.compressions
        for mesh, outcome in (("adaptive", row.adaptive), ("homogeneous", row.homogeneous))
        if not outcome.converged
    ]


def sections(store: str, scale: Scale) -> list[Picture]:
    """Return the same slice of both meshes of one phantom, showing its tetrahedra."""
    kinds: tuple[MeshKind, ...] = ("adaptive", "homogeneous")
    requests = [Measure(store, scale, SHOWN_PHANTOM, kind) for kind in kinds]
    if not all(r.part.is_finished for r in requests):
        return []
    shown = [(f"{r.mesh.capitalize()} mesh", *coronal_section(r)) for r in requests]
    return [
        small_chart(
            mesh_sections(shown),
            "Tetrahedra cut by a coronal plane, on both meshes.",
            f"Phantom {SHOWN_PHANTOM} at rest, the tetrahedra of a coronal slice; dark: "
            "glandular (thesis Fig. 4.14).",
        )
    ]


def slices(store: str, scale: Scale) -> list[Picture]:
    """Return the same slice of a pressed phantom on both meshes, and their difference."""
    requests = [
        Press(store, scale, SHOWN_PHANTOM, mesh, "neo-Hookean", "CC")
        for mesh in ("adaptive", "homogeneous")
    ]
    if not all(r.part.is_finished for r in requests):
        return []
    bodies = [pressed(r).labels for r in requests]
    first, second = bodies
    if first is None or second is None:
        return []
    view = VIEWS[0]
    middle = middle_mm(first, [Tissue.GLANDULAR])[view.normal]
    cuts = [section(volume, view, middle) for volume in (first, second)]
    colours = colour_table({int(tissue): colour for tissue, colour in TISSUE_PALETTE.items()})
    planes = _one_box([c.values for c in cuts], [c.origin_mm for c in cuts], cuts[0].spacing_mm)
    pictures: list[tuple[str, NDArray[np.generic]]] = [
        (f"{title} mesh", colours[plane][::-1])
        for title, plane in zip(("Adaptive", "Homogeneous"), planes, strict=True)
    ]
    differs = np.zeros((*planes[0].shape, 4), np.uint8)
    differs[(planes[0] > 0) | (planes[1] > 0)] = THERE
    differs[planes[0] != planes[1]] = DIFFERS
    pictures.append(("Difference", differs[::-1]))
    return [
        picture(
            chapter_elements.pictures_in_a_row(pictures, labels=True),
            "A coronal slice of a pressed phantom on both meshes, and their difference.",
            f"Phantom {SHOWN_PHANTOM} pressed in CC, one slice (thesis Fig. 4.17).",
        )
    ]


def _one_box(
    planes: Sequence[NDArray[np.uint8]],
    origins: Sequence[tuple[float, float]],
    spacing: tuple[float, float],
) -> list[NDArray[np.uint8]]:
    """Place two planes of one lattice in boxes of equal shape."""
    low = np.min(origins, axis=0)
    starts = [np.rint((np.asarray(o) - low) / spacing).astype(int)[::-1] for o in origins]
    shape = np.max([s + p.shape for s, p in zip(starts, planes, strict=True)], axis=0)
    boxed = []
    for start, plane in zip(starts, planes, strict=True):
        box = np.zeros(shape, np.uint8)
        end = start + plane.shape
        box[start[0] : end[0], start[1] : end[1]] = plane
        boxed.append(box)
    return boxed
