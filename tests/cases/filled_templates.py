"""Templates of `palpate new` with the required keys filled in, and a small body for them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from palpate.service.templates import template
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom

SMALL = BreastPhantom(
    lower_mm=30.0,
    upper_mm=45.0,
    half_width_mm=28.0,
    depth_mm=32.0,
    spacing_mm=2.0,
    glandular_fraction=0.3,
    skin_mm=0.0,
    ligament_mm=0.0,
    compartments=60,
)
FILES = {"diagnosis": ("scans.reference", "scans.loads.0.volume")}
FILES["breast-images"] = ("case.reference.volume", "target.volume")


def filled(kind: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a template with values inserted at dotted paths."""
    data: dict[str, Any] = yaml.safe_load(template(kind, "mine"))
    for path, value in values.items():
        *parents, last = path.split(".")
        inside: Any = data
        for key in parents:
            inside = inside[int(key) if key.isdigit() else key]
        assert last in inside, f"the template of {kind} has no key {path}"
        inside[last] = value
    return data


def required(kind: str, force_n: float) -> dict[str, Any]:
    """Return values of the required keys of a template: two files and the force."""
    rest, pressed = FILES[kind]
    load = "case.load.force_n" if kind == "breast-images" else "scans.loads.0.force_n"
    return {rest: "rest.nrrd", pressed: "pressed.nrrd", load: force_n}


def small_breast() -> Volume:
    """Return a breast of fat and glandular tissue only."""
    labels = generate_breast(SMALL, seed=5).labels
    values = np.where(labels.values == Tissue.GLANDULAR, 2, labels.values > 0)
    return Volume(values.astype(np.uint8), labels.spacing_mm, labels.origin_mm)
