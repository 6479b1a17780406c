"""Rendering of page templates, and the glossary: one sentence on each term of a page.

Templates, style sheet and scripts are beside this module.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

TEMPLATES = Path(__file__).parent


def filled(template: str, values: Mapping[str, Any], folder: Path = TEMPLATES) -> str:
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
        loader=FileSystemLoader([folder, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )


STUDY_TERMS = (
    ("Candidate", "One proposal of the search: a value for every searched constant."),
    ("Generation", "The candidates proposed together, counted from 1."),
    ("Elite", "The best candidates of a generation, kept unchanged in the next."),
    ("Target", "The deformed body that the simulation should match."),
    (
        "E, η",
        "Young's modulus and fibre stiffness: how strongly a tissue resists, in all directions "
        "and along its fibres.",
    ),
    (
        "Jaccard (JC)",
        "Volume of the intersection of two bodies, divided by the volume of their union: 1 if "
        "equal.",
    ),
    ("Dice", "Twice the volume of the intersection, divided by the sum of both volumes."),
    (
        "MHD",
        "Modified Hausdorff distance: the mean distance between two surfaces, the larger of the "
        "two directions.",
    ),
    ("GSF", "ln((1 − Jaccard) · MHD in voxels); lower is better."),
    (
        "Weakly determined",
        "The interval is wider than half the value: other values explain the images almost as "
        "well.",
    ),
)

DIAGNOSIS_TERMS = (
    ("Gap", "Root mean square difference of model and data beyond the noise, in mm."),
    (
        "Noise",
        "Standard deviation of the error of the segmentation, or of a marker's recording, at one "
        "point.",
    ),
    ("Nominal model", "The model without any suspected effect, with fitted constants."),
    ("Effect", "A cause missing from the model, with a magnitude that can be fitted."),
    ("Evidence, nats", "A gain of 3 makes a hypothesis 20 times as probable."),
    ("Alarm", "The evidence for a gap that noise alone exceeds in 5 of 100 cases."),
    (
        "Absorbed by constants",
        "The part of an effect that other constants could mimic; if it is large, the effect is "
        "neither confirmed nor ruled out.",
    ),
    ("On unseen scans", "Each scan is compared with a fit to the others."),
)
# For scans; a bench has no overlap.
OVERLAP_TERMS = (
    ("JC, MHD, GSF", "Jaccard coefficient, modified Hausdorff distance, and ln((1 − JC) · MHD)."),
)
