"""Draw a page of Palpate, or one section of it, as a picture.

::

    palpate diagnose examples/diagnosis/hidden.yaml
    python docs/pictures/screenshot.py runs/hidden/diagnosis.html diagnosis.png
    python docs/pictures/screenshot.py runs/hidden/diagnosis.html causes.png "#causes figure"
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

WIDTH, HEIGHT = 1100, 760


def draw(page: Path, out: Path, section: str | None) -> None:
    """Open a page in Chromium, and keep its first screen or the section of a CSS selector."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        shown = running.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        shown.goto(page.resolve().as_uri())
        shown.wait_for_timeout(1500)
        (shown.locator(section).first if section else shown).screenshot(path=out)
        running.close()


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3] if sys.argv[3:] else None)
