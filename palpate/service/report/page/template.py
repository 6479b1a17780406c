"""Rendering of page templates."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

HERE = Path(__file__).parent


def filled(template: str, values: Mapping[str, Any], folder: Path = HERE) -> str:
    """Return the page as text; equal values give the same bytes.

    Parameters
    ----------
    template : str
        Name of the file in `folder`; included files may also be in this folder.
    values : mapping of str to Any
        Values of all names in the template.
    folder : Path
    """
    return _environment(folder).get_template(template).render(values)


@cache
def _environment(folder: Path) -> Environment:
    """Return the template environment, which caches compiled templates."""
    return Environment(
        loader=FileSystemLoader([folder, HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
