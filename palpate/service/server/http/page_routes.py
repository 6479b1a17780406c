"""Routes of the web page: one HTML file, its style sheet and its scripts.

There is no build step, and nothing is loaded from other sites. The slice and body viewers are
shared with the reports.
"""

from pathlib import Path

from fastapi import APIRouter, HTTPException, Response
from fastapi.responses import FileResponse

PAGE = Path(__file__).parents[1] / "page"
REPORT = Path(__file__).parents[2] / "report" / "page"
TYPES = {".css": "text/css", ".js": "text/javascript"}
FILES = {
    path.name: path
    for path in (
        *sorted(PAGE.glob("*.css")),
        *sorted(PAGE.glob("*.js")),
        REPORT / "report.css",
        *(REPORT / "scripts" / name for name in ("common.js", "slices.js", "body.js")),
    )
}

router = APIRouter(include_in_schema=False)


@router.get("/")
def get_page() -> Response:
    """Return the page, which gets its data from the API."""
    return FileResponse(PAGE / "index.html", media_type="text/html; charset=utf-8")


@router.get("/page/{name}")
def get_part(name: str) -> Response:
    """Return the style sheet or a script."""
    path = FILES.get(name)
    if path is None:
        raise HTTPException(404, f"The page has no file {name[:80]!r}.")
    return FileResponse(path, media_type=f"{TYPES[path.suffix]}; charset=utf-8")
