"""Report pages in a real browser: sliders, rotation, keys, colour schemes and widths."""

import csv
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from palpate.service.report.diagnosis import diagnosis_page
from palpate.service.report.study import study_page
from palpate.service.report.study.page_provenance import Origin
from palpate.service.report.study.study_data import StudySurface
from palpate.workers.comparison.observation.interface_residual import GLANDULAR, OUTLINE
from palpate.workers.diagnosis.problem.prepared_parts import shape
from palpate.workers.mechanics.fem.loads_and_regions import Pressed
from tests.service.report.diagnosis_bodies_at_hand import HALF_AXES_MM as AT_REST_MM
from tests.service.report.diagnosis_bodies_at_hand import NOMINAL_MM, PRESSED_MM, SCANS, found
from tests.service.report.study_data_at_hand import BODIES, study_data

api = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed: pip install .[dev]"
)
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")

WIDE, NARROW = 1400, 480
# The page is read from a file, so any other access would be a request.
OWN = ("file:", "data:", "blob:")


@dataclass
class Shown:
    """A page in a browser, with its errors and requests."""

    page: Any
    problems: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def asks(self, address: str) -> None:
        """Record an address outside the page."""
        if not address.startswith(OWN):
            self.requests.append(address)

    def canvas(self, selector: str) -> str:
        """Return the picture of a canvas."""
        return str(self.page.eval_on_selector(selector, "c => c.toDataURL()"))

    def data(self, viewer: str, name: str) -> float:
        """Return a number from a viewer's attributes."""
        root = self.page.locator(f'[data-viewer="{viewer}"]')
        return float(root.get_attribute(f"data-{name}"))

    def settled(self) -> None:
        """Wait until the drawing is up to date."""
        self.page.evaluate("() => new Promise(r => requestAnimationFrame(() => setTimeout(r, 30)))")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    quiet = ("background-networking", "component-update", "sync", "gpu")
    options = ["--no-sandbox", *(f"--disable-{name}" for name in quiet)]
    with api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield running
        running.close()


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    told = {"study": study_page.render_study(study()), "diagnosis": diagnosis()}
    for name, text in told.items():
        (folder / f"{name}.html").write_text(text)
    return {name: folder / f"{name}.html" for name in told}


def study() -> Any:
    """Provide the hand-made study with a three-dimensional body."""
    surfaces = []
    for interface in (OUTLINE, GLANDULAR):
        assert BODIES.target is not None
        drawn = shape(BODIES.target, interface.inside)
        moved = drawn.vertices * [1.2, 0.6, 1.1]
        gap = 0.02 * drawn.vertices[:, 0]
        surfaces.append(StudySurface(interface.name, *drawn, moved, gap))
    far = np.hypot.reduce(np.mgrid[-8:9, -10:11, -12:13]).astype(np.float32)
    assert BODIES.best is not None
    moved = replace(BODIES.best, values=np.where(BODIES.best.values > 0, far, np.nan))
    return study_data(bodies=replace(BODIES, surfaces=tuple(surfaces), displacement=moved))


def diagnosis() -> str:
    """Provide the egg between plates, with displacements of its points."""
    told = found()
    points, ends_mm = told.maps["points"], {"before": NOMINAL_MM, "after": PRESSED_MM}
    moved = {
        f"moved_{when}": np.stack([points / AT_REST_MM * end for end in ends])
        for when, ends in ends_mm.items()
    }
    told = replace(told, maps={**told.maps, **moved})
    loads = {SCANS[0]: Pressed((0, 1, 0), 40.0), SCANS[1]: Pressed((1, 0, 0), 40.0)}
    return diagnosis_page.render_diagnosis(told, Origin(loads=loads))


def shown(browser: Any, path: Path, width: int = WIDE, **options: Any) -> Shown:
    """Open a page as a user would, and wait for its viewers."""
    page = browser.new_page(viewport={"width": width, "height": 900}, **options)
    told = Shown(page)
    page.on("console", lambda message: told.problems.append(message.text))
    page.on("pageerror", lambda error: told.problems.append(str(error)))
    page.on("request", lambda request: told.asks(request.url))
    page.goto(path.as_uri())
    if options.get("java_script_enabled", True):
        page.wait_for_selector("html.has-slices.has-body", state="attached")
        told.settled()
    return told


@pytest.mark.parametrize("which", ["study", "diagnosis"])
@pytest.mark.parametrize(("width", "scheme"), [(WIDE, "dark"), (NARROW, "light")])
def test_page_has_no_requests_errors_or_clipping(
    browser: Any, pages: dict[str, Path], which: str, width: int, scheme: str
) -> None:
    told = shown(browser, pages[which], width, color_scheme=scheme)
    assert told.problems == []
    assert told.requests == []
    page = told.page
    too_wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    assert page.evaluate(too_wide) == 0
    cut = """[...document.querySelectorAll("svg, canvas, td, dd, p, h2")]
        .filter(e => e.getClientRects().length && e.getBoundingClientRect().right > innerWidth)
        .map(e => e.outerHTML.slice(0, 80))"""
    assert page.evaluate(cut) == []
    paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
    light = sum(int(part) for part in paper.strip("rgb()").split(",")) > 380
    assert light == (scheme == "light")
    page.close()


@pytest.mark.parametrize("which", ["study", "diagnosis"])
def test_the_slider_moves_the_slice_and_keys_do_too(
    browser: Any, pages: dict[str, Path], which: str
) -> None:
    told = shown(browser, pages[which])
    slices = '[data-viewer="slices"]'
    before, picture = told.data("slices", "at"), told.canvas(f"{slices} canvas")
    slider = told.page.locator(f"{slices} input[type=range]")
    slider.focus()
    for _ in range(4):
        told.page.keyboard.press("ArrowRight")
    told.settled()
    after = told.data("slices", "at")
    assert after > before
    assert told.canvas(f"{slices} canvas") != picture
    assert f"{after:.1f} mm".replace("-", "\u2212") in told.page.inner_text(f"{slices} .place")
    slider.evaluate("s => { s.value = s.min; s.dispatchEvent(new Event('input')); }")
    assert told.data("slices", "at") < before
    told.page.get_by_text("sagittal", exact=True).first.click()
    assert told.page.get_attribute(slices, "data-view") == "sagittal"
    assert told.problems == []
    told.page.close()


def test_a_slice_shows_the_labels_of_its_plane(browser: Any, pages: dict[str, Path]) -> None:
    """The middle of the target is gland; the readout agrees with the volume."""
    told = shown(browser, pages["study"])
    panel = told.page.locator('[data-viewer="slices"] canvas').nth(1)
    panel.scroll_into_view_if_needed()
    box = panel.bounding_box()
    told.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    said = told.page.inner_text('[data-viewer="slices"] .readout')
    assert said.startswith("Target at x ")
    assert said.endswith("glandular")
    told.page.mouse.move(box["x"] + 1, box["y"] + 1)
    assert told.page.inner_text('[data-viewer="slices"] .readout').endswith("air")
    told.page.close()


def test_slices_show_plates_a_scale_and_the_outline_of_the_target(
    browser: Any, pages: dict[str, Path]
) -> None:
    told = shown(browser, pages["study"])
    panels = told.page.locator('[data-viewer="slices"] figure.panel')
    counts = [
        [panels.nth(k).locator(f"path.{what}").count() for what in ("plate", "interface")]
        for k in range(panels.count())
    ]
    assert counts == [[0, 0], [1, 0], [1, 1], [1, 0]]
    # The body fills 15 rows; lines are slightly outside.
    lines = panels.nth(1).locator("path.plate").get_attribute("d")
    low, high = (float(line.split("L")[0].split()[1]) for line in lines.split("M")[1:])
    assert 15 < low - high < 15.5
    figure = panels.nth(1)
    bar, slice_ = figure.locator(".scale-bar").bounding_box(), figure.locator("canvas")
    shown_mm = 2 * float(slice_.get_attribute("width"))
    length = float(figure.locator(".scale-bar + span").inner_text().split()[0])
    assert bar["width"] == pytest.approx(
        slice_.bounding_box()["width"] * length / shown_mm, abs=1.5
    )
    told.page.close()


def test_the_best_candidate_is_coloured_by_displacement(
    browser: Any, pages: dict[str, Path]
) -> None:
    told = shown(browser, pages["study"])
    viewer = told.page.locator('[data-viewer="slices"]')
    canvases = '[data-viewer="slices"] .panels figure:nth-child({}) canvas'
    before = [told.canvas(canvases.format(k)) for k in (2, 3)]
    assert not viewer.locator(".scale").is_visible()
    viewer.get_by_text("displacement", exact=True).click()
    after = [told.canvas(canvases.format(k)) for k in (2, 3)]
    assert after[0] == before[0]
    assert after[1] != before[1]
    assert viewer.locator(".scale").is_visible()
    assert told.problems == []
    told.page.close()


def test_the_model_of_a_diagnosis_is_coloured_by_displacement_and_gap(
    browser: Any, pages: dict[str, Path]
) -> None:
    told = shown(browser, pages["diagnosis"])
    viewer = told.page.locator('[data-viewer="slices"]')
    model = '[data-viewer="slices"] .panels figure:nth-child(2) canvas'
    pictures = [told.canvas(model)]
    for colour in ("displacement", "gap"):
        viewer.get_by_text(colour, exact=True).click()
        pictures.append(told.canvas(model))
        assert colour in viewer.locator(".scale .what").inner_text()
    end = viewer.locator(".scale span:nth-child(3)").inner_text()
    viewer.get_by_text("with ").first.click()
    pictures.append(told.canvas(model))
    assert len(set(pictures)) == 4
    assert viewer.locator(".scale span:nth-child(3)").inner_text() == end  # one scale for both
    assert told.problems == []
    told.page.close()


@pytest.mark.parametrize("which", ["study", "diagnosis"])
def test_the_body_turns_by_pointer_and_by_keyboard(
    browser: Any, pages: dict[str, Path], which: str
) -> None:
    told = shown(browser, pages[which])
    canvas = told.page.locator("canvas.body")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    azimuth, picture = told.data("body", "azimuth"), told.canvas("canvas.body")
    told.page.mouse.move(x, y)
    told.page.mouse.down()
    told.page.mouse.move(x + 60, y, steps=3)
    told.page.mouse.up()
    told.settled()
    assert told.data("body", "azimuth") == pytest.approx(azimuth - 30, abs=1)
    assert told.canvas("canvas.body") != picture
    canvas.focus()
    elevation = told.data("body", "elevation")
    told.page.keyboard.press("ArrowDown")
    told.page.keyboard.press("+")
    told.settled()
    assert told.data("body", "elevation") == pytest.approx(elevation + 10)
    assert told.data("body", "zoom") == pytest.approx(1.2)
    told.page.keyboard.press("0")
    told.settled()
    assert told.canvas("canvas.body") == picture
    told.page.close()


def test_colours_and_shapes_of_the_body_are_switched(browser: Any, pages: dict[str, Path]) -> None:
    told = shown(browser, pages["study"])
    pictures = {told.canvas("canvas.body")}
    viewer = told.page.locator('[data-viewer="body"]')
    assert viewer.locator(".scale").is_visible()  # displacement is shown first
    for text in ("gap", "before", "glandular"):
        viewer.get_by_text(text, exact=True).click()
        told.settled()
        pictures.add(told.canvas("canvas.body"))
        assert viewer.locator(".scale").is_visible()
    assert "outside (+) or inside" in viewer.inner_text()
    viewer.get_by_text("plain", exact=True).click()
    told.settled()
    assert not viewer.locator(".scale").is_visible()
    assert len({*pictures, told.canvas("canvas.body")}) == 5
    told.page.close()


def test_charts_show_candidate_under_pointer(browser: Any, pages: dict[str, Path]) -> None:
    told = shown(browser, pages["study"])
    chart = told.page.locator('svg.wide[data-chart="evaluations"]')
    chart.scroll_into_view_if_needed()
    chart.focus()
    told.page.keyboard.press("ArrowRight")
    tip = told.page.locator(".tip")
    assert "candidate 0, generation 1" in tip.inner_text()
    assert "GSF \u22123.83" in tip.inner_text()
    assert "E_fat, kPa 10.12" in tip.inner_text()
    rings = told.page.eval_on_selector_all(
        ".pointed", "all => all.filter(r => r.style.display !== 'none').length"
    )
    assert rings >= 3  # in this chart and in that of each parameter
    told.page.keyboard.press("Escape")
    assert not tip.is_visible()
    ring = chart.locator(".pointed")
    x, y = (float(ring.get_attribute(k)) for k in ("cx", "cy"))
    box, width = chart.bounding_box(), float(chart.get_attribute("viewBox").split()[2])
    told.page.mouse.move(box["x"] + x * box["width"] / width, box["y"] + y * box["width"] / width)
    assert "candidate 0, generation 1" in tip.inner_text()
    told.page.close()


def saved(told: Shown, figure: Any, kind: str) -> Path:
    """Press a button of a chart and return the saved file."""
    with told.page.expect_download() as download:
        figure.get_by_role("button", name=f"Save this chart as {kind}").click()
    return Path(download.value.path())


def test_charts_are_saved_as_image_drawing_and_numbers(
    browser: Any, pages: dict[str, Path]
) -> None:
    told = shown(browser, pages["study"], NARROW, color_scheme="dark")
    figure = told.page.locator("#convergence figure").first
    assert saved(told, figure, "PNG").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    drawing = ElementTree.parse(saved(told, figure, "SVG")).getroot()
    assert float(drawing.get("width")) > NARROW  # the wide form, though the page is narrow
    inks = {e.get("style", "").partition("fill: rgb(")[2].partition(")")[0] for e in drawing.iter()}
    assert "228, 232, 238" in inks  # of the dark page, written into the file
    with saved(told, figure, "CSV").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["candidate", "generation", "GSF", "E_fat, kPa", "eta_fat, kPa"]
    assert rows[1][:3] == ["0", "1", "-3.83"]
    with saved(told, told.page.locator("#parameters figure"), "CSV").open(newline="") as file:
        (first, *_) = list(csv.DictReader(file))
    assert (first["estimate"], first["target"], first["upper"]) == ("10.12", "10", "20")
    assert told.problems == []
    told.page.close()


@pytest.mark.parametrize("which", ["study", "diagnosis"])
def test_without_scripts_the_page_shows_pictures(
    browser: Any, pages: dict[str, Path], which: str
) -> None:
    told = shown(browser, pages[which], NARROW, java_script_enabled=False)
    assert told.page.locator(".still-slices svg").first.is_visible()
    assert not told.page.locator(".viewer").first.is_visible()
    assert told.page.locator(".still-body").first.is_visible()
    assert told.problems == []
    told.page.close()
