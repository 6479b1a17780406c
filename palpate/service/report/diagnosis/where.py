"""Pictures of the gap, as far as the store has the data."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from palpate.service.diagnosis.words import signed
from palpate.service.report.diagnosis.maps import SIGNIFICANT, range_mm, residual_map
from palpate.service.report.diagnosis.slices import cause_sections, overlays, titled
from palpate.service.report.diagnosis.surfaces import Solid, seen_from_all_sides, surface_map
from palpate.service.report.drawing.pictures import Picture, small_chart
from palpate.service.report.drawing.slices import middle_mm
from palpate.service.report.drawing.svg import Svg
from palpate.storage.stores.arrays import Arrays
from palpate.storage.values import BoolArray, FloatArray, Tissue, Triple, Volume
from palpate.workers.diagnosis.problem.acquisition import INTERFACES
from palpate.workers.diagnosis.schema.summary import CauseMapSummary

# No map is drawn of an interface with fewer points.
FEW_POINTS = 5
PARTS = ("vertices", "triangles")


def maps(
    found: Arrays, scans: Sequence[str], named: str, surfaces: Sequence[str]
) -> Iterator[Picture]:
    """Yield maps of the signed residuals of every scan, on one colour scale.

    They are drawn on surfaces, averaged around each point, if the store has these; otherwise as
    points seen from three sides.
    """
    own = {name: found["interface"] == number for number, name in enumerate(surfaces)}
    own = {name: mask for name, mask in own.items() if mask.sum() >= FEW_POINTS}
    if not own:
        return
    drawn_on = _on_surfaces if on_surfaces(found) else _as_points
    yield from drawn_on(found, scans, named, own)


def _on_surfaces(
    found: Arrays, scans: Sequence[str], named: str, own: Mapping[str, BoolArray]
) -> Iterator[Picture]:
    most = range_mm(found["local_before"], found["local_before_sd"])
    seen = seen_from_all_sides([_solid(found, name, mask) for name, mask in own.items()])
    for scan, scan_name in enumerate(scans):
        local = {
            title: {
                name: (found[f"local_{key}"][scan, mask], found[f"local_{key}_sd"][scan, mask])
                for name, mask in own.items()
            }
            for key, title in titled(found, named)
        }
        shares = [f"{name}: {_loud(found, scan, named, mask)}" for name, mask in own.items()]
        drawn = surface_map(seen, local, most)
        yield _captioned(drawn, f"Scan at {scan_name}", _beyond("; ".join(shares)))


def _as_points(
    found: Arrays, scans: Sequence[str], named: str, own: Mapping[str, BoolArray]
) -> Iterator[Picture]:
    most = range_mm(found["before"], found["noise"])
    for scan, scan_name in enumerate(scans):
        for name, mask in own.items():
            rows = {title: found[key][scan, mask] for key, title in titled(found, named)}
            drawn = residual_map(found["points"][mask], rows, found["noise"][scan, mask], most)
            title = f"{name.capitalize()}, scan at {scan_name}"
            yield _captioned(drawn, title, _beyond(_loud(found, scan, named, mask)))


def _solid(found: Arrays, name: str, own: BoolArray) -> Solid:
    vertices, triangles = (found[f"shape_{name}_{part}"] for part in PARTS)
    return Solid(name, vertices.astype(np.float64), triangles, found["points"][own])


def on_surfaces(found: Arrays) -> bool:
    """Check whether the store has the shapes of the interfaces and residuals averaged on them."""
    return "local_before" in found and f"shape_{INTERFACES[0].name}_vertices" in found


def sections(found: Arrays, scans: Sequence[str], named: str) -> Iterator[Picture]:
    """Yield sections of the observed and predicted bodies of every scan in the store."""
    for scan, name in enumerate(scans):
        if f"labels_{scan}" not in found:
            continue
        stack, frame = found[f"labels_{scan}"], found[f"labels_{scan}_frame"]
        observed, *models = (_volume(labels, frame) for labels in stack)
        keys = dict(zip(("before", "after"), models, strict=False))
        shown = {title: keys[key] for key, title in titled(keys, named)}
        middle = middle_mm(observed, (Tissue.GLANDULAR,))
        yield _captioned(
            overlays(observed, shown, middle),
            f"Scan at {name}",
            "sections through the middle of the glandular tissue of the scan; lines are its "
            "interfaces",
        )


def cause_picture(found: Arrays, causes: CauseMapSummary | None, named: str) -> Picture | None:
    """Return the map of causes; None if there is none."""
    if causes is None or "cause_before" not in found:
        return None
    before = causes.before
    body = _volume(found["labels_rest"], found["labels_rest_frame"])
    keys = {key: found[f"cause_{key}"] for key in ("before", "after") if f"cause_{key}" in found}
    shown = {title: _volume(keys[key], found["cause_frame"]) for key, title in titled(keys, named)}
    at: Triple = (before.x_mm, before.y_mm, before.z_mm)
    drawn = cause_sections(shown, body, at, before.reached_by_noise)
    return _captioned(drawn, "Map of causes", cause_words(causes))


def cause_words(causes: CauseMapSummary) -> str:
    """Return the place of the highest score of the map, and whether it exceeds the noise."""
    before = causes.before
    way = "stiffer" if before.score > 0 else "softer"
    noise = before.reached_by_noise
    at = {"x": before.x_mm, "y": before.y_mm, "z": before.z_mm}
    place = ", ".join(f"{axis} = {signed(value, 0)}" for axis, value in at.items())
    verdict = (
        "more than noise alone reaches anywhere in the body"
        if abs(before.score) > noise
        else "no more than noise alone reaches somewhere in the body"
    )
    return (
        f"{way} tissue at {place} mm (the cross) would explain the gap best. Its score of "
        f"{signed(before.score, 1)} is {verdict} (±{noise:.1f} in 5 of 100 cases, the strokes on "
        "the scale)"
    )


def _beyond(said: str) -> str:
    return f"points beyond twice the noise of a point: {said}. Noise alone would put 5 % there"


def _loud(found: Arrays, scan: int, named: str, own: BoolArray) -> str:
    """Return the fraction of points beyond twice the noise, by model."""
    limit = SIGNIFICANT * found["noise"][scan, own]
    shares = {
        title: (np.abs(found[key][scan, own]) >= limit).mean()
        for key, title in titled(found, named)
    }
    return ", ".join(f"{100 * share:.0f} % ({title})" for title, share in shares.items())


def _captioned(drawn: Svg, title: str, words: str) -> Picture:
    return small_chart(drawn, f"{title}: {words}.", Markup("<b>{}</b>: {}.").format(title, words))


def _volume(values: Any, frame: FloatArray) -> Volume:
    (dx, dy, dz), (x, y, z) = frame.tolist()
    return Volume(values, (dx, dy, dz), (x, y, z))
