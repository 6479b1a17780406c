"""The page in a real browser: submit, watch, pause, resume, cancel, a failure, slices, the body."""

import json
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from palpate.service.remote_client import Client
from tests.recovery.stand_ins import SPEC, Inline, executed, run, set_manners, small_spec, told
from tests.service.server.service_process import (
    TOKEN,
    ServiceProcess,
    running_service,
    until_stopped,
)
from tests.service.server.shown_page import PATIENCE_MS, Shown

api = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed: pip install .[dev]"
)
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")

WIDE, NARROW = 1400, 480
SLOW = SPEC.replace("population: 12", "population: 40\n  stall: null")
SLOW = SLOW.replace("generations: 5", "generations: 100")
REAL = """
name: real
case:
  reference: {phantom: {preset: 445ml, spacing_mm: 2.0, glandular_fraction: 0.2, seed: 1}}
  mesh: {nodes: 1000}
  load: {force_n: 40}
target: {constants: {E_fat_kpa: 10, E_glandular_kpa: 40}}
search:
  parameters: {E_fat_kpa: [5, 20], E_glandular_kpa: [5, 80]}
  population: 4
  generations: 2
  elite: 1
seed: 3
"""
# Limits for 20,000 evaluations on a busy machine: reading them, and drawing them once.
READ_S, DRAW_MS = 20.0, 250.0


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    home = tmp_path_factory.mktemp("paged") / "runs"
    with running_service(home, ["--workers", "2"], "--bodies", threads=2) as running:
        yield running


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    quiet = ("background-networking", "component-update", "sync", "gpu")
    options = ["--no-sandbox", *(f"--disable-{name}" for name in quiet)]
    with api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield running
        running.close()


@pytest.fixture
def shown(browser: Any, served: ServiceProcess) -> Iterator[Shown]:
    """Provide the page, signed in with the address printed by the service."""
    page = browser.new_page(viewport={"width": WIDE, "height": 900})
    page.set_default_timeout(PATIENCE_MS)
    told = Shown(page, served.url)
    page.on("console", lambda message: told.problems.append(message.text))
    page.on("pageerror", lambda error: told.problems.append(str(error)))
    page.on("request", lambda asked: told.elsewhere.append(asked.url))
    page.goto(f"{served.url}/#token={TOKEN}")
    page.wait_for_selector("html.signed-in", state="attached")
    assert TOKEN not in page.url
    yield told
    assert told.problems == []
    assert [url for url in told.elsewhere if not url.startswith((served.url, "data:"))] == []
    page.close()


def named(name: str, text: str = SPEC) -> str:
    return text.replace("name: demo", f"name: {name}")


def test_a_study_can_be_submitted_paused_resumed_and_cancelled(
    shown: Shown, served: ServiceProcess
) -> None:
    set_manners(served.home / "store", seconds=0.05)
    page = shown.page
    page.click("text=Submit a study")
    page.fill("textarea[name=study]", named("watched", SLOW))
    page.click("button:has-text('Submit')")
    page.wait_for_selector("h1:has-text('watched')")
    page.evaluate("() => { window.sameDocument = true; }")
    shown.state("running")
    shown.wait_drawn(5)
    before = shown.drawn()
    shown.wait_drawn(before + 5)
    assert "of at most" in page.inner_text("header .lead")
    page.locator("#workers tbody tr").nth(1).wait_for()
    assert page.locator("#workers tbody tr").count() == 2
    shown.act("pause")
    shown.state("paused")
    until_stopped(served.home / "watched")
    stopped = len(told(served.home / "watched"))
    shown.wait_drawn(stopped)
    page.wait_for_timeout(600)
    assert shown.drawn() == stopped
    shown.act("resume")
    shown.state("running")
    shown.wait_drawn(stopped + 5)
    page.once("dialog", lambda dialog: dialog.dismiss())
    shown.act("cancel")
    assert page.locator("header .badge.running").count() == 1
    page.once("dialog", lambda dialog: dialog.accept())
    shown.act("cancel")
    shown.state("cancelled")
    assert page.locator("[data-action]").count() == 0
    assert page.evaluate("window.sameDocument") is True  # nothing was loaded again
    shown.open()
    assert page.locator("tr[data-job=watched] .badge").inner_text() == "cancelled"


def test_a_failed_candidate_is_opened_with_its_constants_and_its_log(
    shown: Shown, served: ServiceProcess
) -> None:
    set_manners(served.home / "store", crash_above=0.014)
    with served.client() as client:
        client.submit_study(named("failing").replace("seed: 7", "seed: 8"))
    shown.open("failing")
    shown.state("finished")
    page = shown.page
    row = page.locator("#failures tbody tr:has-text('crashed')").first
    row.wait_for()
    assert re.search(r"E_fat_kpa 1[4-9]\.", row.inner_text())
    assert "no such tissue" in row.inner_text()
    row.locator("button").focus()
    page.keyboard.press("Enter")
    page.wait_for_selector("dialog[open] pre.traceback")
    log = page.inner_text("dialog pre.traceback")
    assert log.startswith("Traceback")
    assert "ZeroDivisionError: no such tissue" in log
    page.keyboard.press("Escape")
    page.wait_for_selector("dialog:not([open])", state="attached")
    tiles = page.inner_text("header .tiles")
    (endings,) = [int(n) for n in re.findall(r"Crashed\s+(\d+)", tiles)]
    assert endings == page.locator("#failures .badge.crashed").count() > 0


def test_abandoned_view_does_not_appear(shown: Shown, served: ServiceProcess) -> None:
    set_manners(served.home / "store")
    with served.client() as client:
        client.submit_study(named("twice").replace("seed: 7", "seed: 12"))
    page = shown.page
    page.evaluate("""() => {
        for (const job of ["twice", "", "twice", "", "twice"]) {
            location.hash = `#/${job}`;
            dispatchEvent(new Event("hashchange"));
        }
    }""")
    shown.state("finished")
    page.wait_for_timeout(300)
    assert page.locator("#main h1").all_inner_texts() == ["twice"]
    assert page.locator("#bodies").count() == page.locator("#workers").count() == 1


def test_charts_respond_to_keys(shown: Shown, served: ServiceProcess) -> None:
    set_manners(served.home / "store")
    with served.client() as client:
        client.submit_study(named("keys"))
    shown.open("keys")
    shown.state("finished")
    shown.wait_drawn(52)
    page = shown.page
    chart = page.locator("canvas[data-chart=convergence]")
    assert "Scores of 52 evaluations" in chart.get_attribute("aria-label")
    other = page.locator("canvas[data-chart=ranges]")
    plain = other.evaluate("c => c.toDataURL()")
    chart.focus()
    page.keyboard.press("ArrowRight")
    shown.settled()
    assert page.inner_text("#convergence .readout").startswith("candidate 0, generation 1; GSF")
    assert other.evaluate("c => c.toDataURL()") != plain  # it is marked in all charts
    page.keyboard.press("Enter")
    page.wait_for_selector("dialog[open] h2:has-text('Candidate 0, generation 1')")
    page.keyboard.press("Escape")
    page.wait_for_selector("dialog:not([open])", state="attached")


def test_slider_changes_the_slice_and_dragging_turns_the_body(
    shown: Shown, served: ServiceProcess
) -> None:
    with served.client() as client:
        client.submit_study(named("bodies").replace("seed: 7", "seed: 9"))
    shown.open("bodies")
    shown.state("finished")
    page = shown.page
    page.wait_for_selector('[data-viewer="body"] canvas.body', timeout=PATIENCE_MS)
    shown.show_the_best()
    assert page.locator('[data-viewer="slices"] canvas').count() == 4
    slider = page.locator('[data-viewer="slices"] input[type=range]')
    picture = page.eval_on_selector('[data-viewer="slices"] canvas', "c => c.toDataURL()")
    at = float(page.get_attribute('[data-viewer="slices"]', "data-at"))
    slider.focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    shown.settled()
    after = float(page.get_attribute('[data-viewer="slices"]', "data-at"))
    assert at + 4.0 < after < at + 8.0  # three voxels on, from the nearest one
    assert page.eval_on_selector('[data-viewer="slices"] canvas', "c => c.toDataURL()") != picture
    body = page.locator("canvas.body")
    body.scroll_into_view_if_needed()
    box = body.bounding_box()
    azimuth = float(page.get_attribute('[data-viewer="body"]', "data-azimuth"))
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y, steps=3)
    page.mouse.up()
    shown.settled()
    turned = float(page.get_attribute('[data-viewer="body"]', "data-azimuth"))
    assert turned == pytest.approx(azimuth - 30, abs=1)


def test_does_not_wait_for_newer_bodies(
    shown: Shown, served: ServiceProcess, tmp_path: Path
) -> None:
    """The drawn body may belong to a newer best candidate than the one on the page."""
    text = named("ahead").replace("seed: 7", "seed: 10")
    run(tmp_path / "calm" / "ahead", Inline(), small_spec(text))
    scores = {c: e[4]["gsf"] for c, e in told(tmp_path / "calm" / "ahead").items() if e[4]}
    best = min(scores, key=lambda candidate: (scores[candidate], candidate))
    assert best >= 12
    bodies = {"ready": True, "candidate": best, "slices": None, "body": None}
    bodies |= {"missing": [], "tissues": [], "differences": []}
    page = shown.page
    page.route("**/jobs/ahead/bodies", lambda route: route.fulfill(json=bodies))
    set_manners(served.home / "store", held_after=len(executed(served.home / "store")) + 6)
    try:
        with served.client() as client:
            client.submit_study(text)
        shown.open("ahead")
        offer = page.locator("#bodies button:has-text('now the best')")
        offer.click()
        page.wait_for_selector("#bodies .note:has-text('being drawn')")
    finally:
        set_manners(served.home / "store")
    shown.state("finished")
    page.wait_for_selector(f"#bodies .note:has-text('Candidate {best}.')")
    assert not offer.is_visible()


def test_chosen_studies_are_compared(shown: Shown, served: ServiceProcess) -> None:
    set_manners(served.home / "store")
    ids = ["one-side", "other-side"]
    with served.client() as client:
        for number, name in enumerate(ids):
            client.submit_study(named(name).replace("seed: 7", f"seed: {20 + number}"))
            shown.open(name)
            shown.state("finished")
        found = [client.results(name)["estimates"]["E_fat"]["estimate"] for name in ids]
    shown.open()
    page = shown.page
    button = page.locator("button:has-text('compare selected studies')")
    assert button.is_disabled()
    for name in ids:
        page.check(f"tr[data-job='{name}'] input[type=checkbox]")
    button.click()
    page.wait_for_selector("h1:has-text('Studies side by side')")
    row = page.locator("#constants tbody tr:has-text('E_fat')").inner_text()
    assert all(f"{value:.4g} " in row for value in found)
    assert page.locator("#outcomes thead a").all_inner_texts() == ids
    page.click(f"#outcomes thead a:has-text('{ids[1]}')")
    page.wait_for_selector(f"h1:has-text('{ids[1]}')")
    assert page.locator("[data-file='study.yaml']").inner_text() == "settings (study.yaml)"


@pytest.mark.parametrize("width", [NARROW, pytest.param(WIDE, marks=pytest.mark.slow)])
def test_an_empty_list_offers_a_first_step(browser: Any, tmp_path: Path, width: int) -> None:
    with running_service(tmp_path / "runs", ["--workers", "1"], threads=1) as empty:
        page = browser.new_page(viewport={"width": width, "height": 900})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(f"{empty.url}/#token={TOKEN}")
        page.wait_for_selector("text=Nothing has been submitted yet")
        page.click("button:has-text('Upload scans')")
        files = page.locator("input[aria-label='case.yaml and scans']")
        files.set_input_files(
            [
                {"name": "rest scan.nrrd", "mimeType": "text/plain", "buffer": b"no scan"},
                {"name": "Patient 7.yaml", "mimeType": "text/plain", "buffer": b"name: small"},
            ]
        )
        form = page.locator("details:has(summary:has-text('Diagnose scans'))")
        assert form.locator("input[name=folder]").input_value() == "Patient-7"
        form.locator("button").click()
        page.wait_for_selector("#trouble:not([hidden])")
        wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert page.evaluate(wide) == 0
        page.click("button:has-text('Start the demo')")
        page.wait_for_selector("h1:has-text('demo')")
        page.wait_for_selector("header .badge")
        page.close()


@pytest.mark.parametrize(("width", "scheme"), [(WIDE, "dark"), (NARROW, "light")])
def test_no_clipping_in_light_and_dark_mode(
    shown: Shown, served: ServiceProcess, width: int, scheme: str
) -> None:
    with served.client() as client:
        client.submit_study(named("looked"), key="looked")
    page = shown.page
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme=scheme)
    for job in ("", "looked"):
        shown.open(job)
        shown.settled()
        too_wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert page.evaluate(too_wide) == 0
        cut = """[...document.querySelectorAll("canvas, td, dd, p, h1, h2, button, input")]
            .filter(e => e.getClientRects().length && e.getBoundingClientRect().right > innerWidth)
            .map(e => e.outerHTML.slice(0, 80))"""
        assert page.evaluate(cut) == []
    paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
    light = sum(int(part) for part in paper.strip("rgb()").split(",")) > 380
    assert light == (scheme == "light")


def test_read_only_access_without_token(browser: Any, served: ServiceProcess) -> None:
    page = browser.new_page()
    page.set_default_timeout(PATIENCE_MS)
    loading: list[Any] = []
    page.route("**/api/v1/jobs?*", lambda request: loading.append(request))
    page.goto(served.url)
    page.wait_for_selector("form.sign-in")
    assert not page.locator("text=Submit a study").is_visible()
    page.fill("input[name=token]", "no such token")
    page.click("form.sign-in button")
    page.wait_for_selector("#trouble:has-text('This token is not valid')")
    assert loading  # the list comes after the refusal and does not take it back
    with page.expect_request("**/api/v1/events*"):
        for request in loading:
            request.continue_()
    page.unroute("**/api/v1/jobs?*")
    page.wait_for_timeout(200)
    assert page.locator("#trouble:has-text('This token is not valid')").is_visible()
    page.fill("input[name=token]", TOKEN)
    page.keyboard.press("Enter")
    page.wait_for_selector("#session:has-text('environment')")
    assert page.locator("text=Submit a study").is_visible()
    page.click("text=sign out")
    page.wait_for_selector("form.sign-in")
    page.close()


@pytest.mark.slow
def test_a_real_study_shows_its_gap_and_its_report(browser: Any, tmp_path: Path) -> None:
    with running_service(tmp_path / "runs", ["--workers", "1"], "--real") as served:
        look_at_a_real_study(browser, served)


def look_at_a_real_study(browser: Any, served: ServiceProcess) -> None:
    page = browser.new_page(viewport={"width": WIDE, "height": 900})
    shown = Shown(page, served.url)
    with served.client() as client:
        client.submit_study(REAL)
    page.goto(served.url)
    shown.open("real")
    page.wait_for_selector("header .badge.finished", timeout=240_000)
    shown.show_the_best()
    page.locator('[data-viewer="body"]').get_by_text("gap", exact=True).click()
    assert "outside (+) or inside" in page.inner_text('[data-viewer="body"] .scale')
    with page.expect_popup() as opened:
        page.click("[data-file='report.html']")
    opened.value.wait_for_selector("h2:has-text('Estimates')")
    page.close()


@pytest.mark.slow
def test_twenty_thousand_evaluations_stay_smooth(
    shown: Shown, served: ServiceProcess, record_property: Any
) -> None:
    with served.client() as client:
        fill_journal(client, served.home, "many", 20_000)
    began = time.monotonic()
    shown.open("many")
    shown.wait_drawn(20_000)
    read_s = time.monotonic() - began
    draw_ms = shown.page.evaluate(
        """async () => {
            const chart = document.querySelector("canvas[data-chart=convergence]");
            const frames = [];
            for (let k = 0; k < 9; k++) {
                chart.dispatchEvent(new PointerEvent("pointermove",
                    { clientX: 300 + 20 * k, clientY: chart.getBoundingClientRect().top + 150 }));
                const began = performance.now();
                await new Promise(r => requestAnimationFrame(() => setTimeout(r, 0)));
                frames.push(performance.now() - began);
            }
            return frames.sort((a, b) => a - b)[4];
        }"""
    )
    record_property("read_s", read_s)
    record_property("draw_ms", draw_ms)
    assert read_s < READ_S
    assert draw_ms < DRAW_MS


def fill_journal(client: Client, home: Path, name: str, count: int) -> None:
    """Write a journal of many evaluations for a paused study."""
    client.submit_study(named(name, SLOW), priority=-100)
    client.change(name, "pause")
    while client.job(name).state == "running" or not (home / name / "journal.jsonl").exists():
        time.sleep(0.1)
    time.sleep(1.0)
    with (home / name / "journal.jsonl").open("a") as journal:
        for n in range(10_000, 10_000 + count):
            score = {"jc": 0.5, "mhd_mm": 1.0, "gsf": -5 * n / count + (n * 7919 % 1000) / 500}
            record = {
                "kind": "evaluation", "schema_version": 1, "candidate": n, "generation": n // 40,
                "genes": {"E_fat_kpa": 5 + n * 31 % 15, "E_glandular_kpa": 5 + n * 17 % 75},
                "digest": f"{n:064x}", "status": "done", "reason": "", "score": score,
                "seconds": {"solve": 0.1}, "worker": "w", "attempts": 1, "reused": False,
            }  # fmt: skip
            journal.write(json.dumps(record, separators=(",", ":")) + "\n")
