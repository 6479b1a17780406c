"""Chapters on the searches, and on the sensitivity to each constant."""

from collections.abc import Sequence
from statistics import fmean, stdev

from palpate.service.number_formatting import count, duration, number, symbol
from palpate.service.report.page.page_elements import picture
from palpate.service.thesis import chapter_elements, printed_results
from palpate.service.thesis.chapter_elements import Chapter, Table, Text, cost_rows
from palpate.service.thesis.printed_results import Estimated
from palpate.service.thesis.thesis_experiments import SHOWN_PHANTOM
from palpate.service.thesis.thesis_results import Cost, FoundSearch, SearchResult, Varied
from palpate.workers.thesis.phantom_compression import SEARCH_FORCE_N, TARGETS, Scale, TargetName


def search_chapter(found: SearchResult, cost: Cost | None, scale: Scale) -> Chapter:
    """Return the chapter of thesis section 4.5."""
    names = [name for name in TARGETS if found.of(name)]
    tables: list[Table] = []
    for name in names:
        tables += [_estimates(name, found.of(name)), _errors(name, found.of(name))]
    tables.append(_spent(found))
    return Chapter(
        "search",
        "The constants of ten phantoms",
        "Thesis 4.5.6, Tables 4.4 to 4.6",
        _verdict(found),
        "A genetic algorithm (84 candidates, 15 generations, elite 2) finds four constants, five "
        "with skin, from the glandular voxels of a phantom pressed by 100 N. Targets X1 and X2 "
        "without skin for five phantoms each, X3 with skin for five.",
        f"The same targets, bounds and stop rule through the studies of `palpate run`: strategy "
        f"{_effort(found)}, {count(found.nodes)} nodes, voxels of {found.spacing_mm:g} mm, "
        f"{SEARCH_FORCE_N[scale]:g} N, nodes already in contact with the fixed plate held along x "
        "(4.5.4). Target and candidates share one mesh, so errors exclude the mesh.",
        tables=tables,
        pictures=[
            picture(
                chapter_elements.error_chart(found.of(name), printed_results.SEARCHES[name]),
                f"Relative errors of each constant for {name}.",
                f"{name}: every phantom is a mark; thesis above, Palpate below.",
            )
            for name in names
        ],
        differences=_differences(scale, found),
        costs=_costs(found, cost),
    )


def _effort(found: SearchResult) -> str:
    """Return the strategy, and its number of candidates if that is set."""
    if found.strategy == "least-squares":
        return "least-squares, three starts"
    return (
        f"{found.strategy}, {found.population} candidates, {found.generations} generations at most"
    )


def _verdict(found: SearchResult) -> str:
    parts = []
    for name in TARGETS:
        searches = found.of(name)
        if searches:
            error = 100 * fmean(s.constants[0].error for s in searches)
            theirs = 100 * printed_results.SEARCHES[name].error[0]
            parts.append(f"{number(error, 2)} % for {name} (thesis {number(theirs, 3)} %)")
    each = fmean(s.cpu_s for s in found.searches) / 60
    return (
        f"Mean error of E fat: {', '.join(parts)}. A search took {number(each, 3)} core minutes, "
        f"the thesis {count(round(printed_results.HOURS * printed_results.CORES))} core hours."
    )


def _estimates(target: TargetName, searches: Sequence[FoundSearch]) -> Table:
    table = printed_results.SEARCHES[target]
    theirs: dict[int | None, Estimated] = {row.phantom: row for row in table.rows}
    rows: list[list[Text]] = [
        ["target", *(number(v) for v in TARGETS[target].values()), "1", "0", "0", ""]
    ]
    for s in searches:
        row = theirs[s.phantom]
        mm = row.mhd_voxels * printed_results.VOXEL_MM
        rows.append(
            [
                f"{s.phantom}, thesis",
                *(number(v) for v in row.constants_kpa),
                number(row.jc, 3),
                number(row.mhd_voxels, 3),
                number(mm, 3),
                "≈ 1000",
            ]
        )
        rows.append(
            [
                f"{s.phantom}, Palpate",
                *(number(c.estimate) for c in s.constants),
                number(s.jc, 4),
                number(s.mhd_voxels, 3),
                number(s.mhd_mm, 3),
                count(s.evaluations),
            ]
        )
    names = [symbol(c.name, "") for c in searches[0].constants]
    headings = ("Phantom", *names, "JC", "MHD, voxels", "MHD, mm", "Evaluations")
    note = "Constants in kPa. Voxels of the thesis: 0.2 mm."
    return Table(f"Estimates for {target} ({table.name})", headings, rows, note=note)


def _errors(target: TargetName, searches: Sequence[FoundSearch]) -> Table:
    table = printed_results.SEARCHES[target]
    rows: list[list[Text]] = []
    for n, constant in enumerate(searches[0].constants):
        every = [s.constants[n] for s in searches]
        estimates = [c.estimate for c in every]
        sd = stdev(estimates) if len(estimates) > 1 else None
        before = [c.genetic_error for c in every if c.genetic_error is not None]
        bounds = [c.bound for c in every if c.bound is not None]
        rows.append(
            [
                symbol(constant.name, ""),
                number(table.mean[n]),
                number(fmean(estimates)),
                number(table.sd[n], 3),
                number(sd, 3),
                _percent(table.error[n]),
                _percent(fmean(before)) if before else "–",
                _percent(fmean(c.error for c in every)),
                _percent(fmean(bounds)) if bounds else "–",
                coverage(every),
            ]
        )
    headings = (
        "",
        "Mean, thesis",
        "Palpate",
        "Deviation, thesis",
        "Palpate",
        "Error, thesis",
        "Genetic part",
        "Palpate",
        "At best",
        "Within interval",
    )
    note = (
        "Error: mean of |estimate − target| / target. At best: the standard deviation allowed by "
        "the derivatives (Cramér-Rao, with the noise of the image). Within interval: number of "
        "searches whose 90 % interval covers the target. " + table.note
    )
    return Table(f"Statistics for {target}", headings, rows, note=note.strip())


def coverage(constants: Sequence) -> str:  # type: ignore[type-arg]
    """Return the number of searches whose interval covers the target, as text."""
    known = [c for c in constants if c.interval is not None]
    if not known:
        return "–"
    inside = sum(c.interval[0] <= c.target <= c.interval[1] for c in known)
    return f"{inside} of {len(known)}"


def _percent(share: float) -> str:
    return f"{number(100 * share, 3)} %"


def _spent(found: SearchResult) -> Table:
    rows = [
        [
            f"{s.target}, {s.phantom}",
            count(s.evaluations),
            duration(s.cpu_s),
            duration(s.wall_s),
            s.stopped,
        ]
        for s in found.searches
    ]
    headings = ("Search", "Evaluations", "Workers' time", "Wall time", "Why it stopped")
    return Table("What each search cost", headings, rows, (4,))


def _costs(found: SearchResult, cost: Cost | None) -> list[tuple[str, Text]]:
    core_hours = printed_results.HOURS * printed_results.CORES
    mean = fmean(s.cpu_s for s in found.searches)
    rows: list[tuple[str, Text]] = [
        ("the thesis, one search", f"48 h on 12 cores, {core_hours:g} core hours"),
        ("on", printed_results.MACHINE),
        ("Palpate, one search", f"{duration(mean)} wall time of one worker"),
        ("ratio", f"{count(round(core_hours * 3600 / mean))} times less"),
    ]
    if cost is not None:
        rows += [("all searches", f"{duration(cost.cpu_s)} of one worker"), ("on", cost.machine)]
    return rows


def _differences(scale: Scale, found: SearchResult) -> list[str]:
    texts = [
        "The thesis specifies neither crossover, mutation, selection nor seeds; Palpate uses those "
        "of MATLAB's ga. Estimates of a single phantom cannot be reproduced exactly.",
        "η multiplies a fibre term along chest wall to nipple that is nearly inextensible; the "
        "deformed shape hardly depends on it, so its estimate is anywhere in a flat valley.",
        "MHD is measured between boundary voxels, as the printed pairs of JC and MHD imply.",
        "The thesis prints no skin thickness; here the skin is a membrane of 1.5 mm.",
    ]
    if scale != "full":
        alone = found.strategy == "least-squares"
        fewer = "" if alone else f" and {found.population} instead of 84 candidates"
        smaller = (
            "The reduced search has bodies of an eighth of the volume, a coarser mesh, larger "
            f"voxels{fewer}. Its times are not comparable with "
            "the thesis; run with --full for those."
        )
        texts.insert(0, smaller)
    return texts


def sensitivity_chapter(found: Sequence[Varied], cost: Cost | None) -> Chapter:
    """Return the chapter of thesis Fig. 4.22."""
    eta = next(v for v in found if v.constant == "eta_glandular_kpa")
    ranked = sorted(found, key=lambda v: v.lowest_jc)
    strongest = ranked[0].constant.removesuffix("_kpa").replace("_", " ")
    return Chapter(
        "sensitivity",
        "Sensitivity of the scores to each constant",
        "Thesis 4.5.7, Fig. 4.22",
        f"Over the whole interval of η glandular JC is at least {number(eta.lowest_jc, 3)} and "
        f"MHD at most {number(eta.most_mhd_voxels, 3)} voxels (thesis: above 0.93 and below 1 "
        f"voxel). {strongest} has the largest influence.",
        "All constants but η glandular are held at the target; η glandular varies from 50 to "
        "200 kPa, and JC and MHD of the deformed phantom are plotted against it.",
        f"The same for every constant, each over its interval: phantom {SHOWN_PHANTOM}, target X1 "
        "without skin, and the skin's modulus on the model with skin.",
        tables=(_sensitivity_table(found),),
        pictures=(
            picture(
                chapter_elements.sensitivity_curves(found),
                "JC and MHD against each constant.",
                "Dotted: the target. A constant with a flat curve cannot be identified.",
            ),
        ),
        differences=(
            "The printed distances are in voxels of 0.2 mm; ours are in voxels of this scale, so "
            "they are also given in millimetres.",
        ),
        costs=cost_rows(cost, "not printed"),
    )


def _sensitivity_table(found: Sequence[Varied]) -> Table:
    rows = []
    for v in found:
        theirs = ("–", "–")
        if v.constant == "eta_glandular_kpa":
            theirs = (f"> {printed_results.LOWEST_JC}", f"< {printed_results.MOST_MHD_VOXELS:g}")
        most_mm = max((d for d in v.mhd_mm if d is not None), default=float("nan"))
        interval = f"{number(v.values_kpa[0])} … {number(v.values_kpa[-1])}"
        rows.append(
            [
                symbol(v.constant, "kPa"),
                interval,
                number(v.at_target),
                theirs[0],
                number(v.lowest_jc, 3),
                theirs[1],
                number(v.most_mhd_voxels, 3),
                number(most_mm, 3),
            ]
        )
    headings = (
        "",
        "Interval, kPa",
        "Target",
        "Least JC, thesis",
        "Palpate",
        "MHD, voxels, thesis",
        "Palpate",
        "Palpate, mm",
    )
    return Table("Worst scores over each interval", headings, rows)
