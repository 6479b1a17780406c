"""Spacings in TIFF files of ImageJ and OME.

Both give a unit. Plain resolution tags are ignored, and so is ImageJ's inch: it comes
from the print resolution of an image.
"""

import re
from typing import Any

import numpy as np
from tifffile import TiffFile

from palpate.storage.values import FloatArray

_UNIT_MM = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "micron": 1e-3, "nm": 1e-6}
_NAMES = {
    "millimeter": "mm",
    "millimetre": "mm",
    "centimeter": "cm",
    "microns": "um",
    "micrometer": "um",
    "micrometre": "um",
}
_OME_SIZE = re.compile(r'PhysicalSize([XYZ])(Unit)?="([^"]*)"')


def stated_spacing_mm(tiff: TiffFile) -> FloatArray:
    """Return the spacing along x, y and z; NaN where the file gives none with a unit."""
    if tiff.is_ome and tiff.ome_metadata:
        return _of_ome(tiff.ome_metadata)
    if tiff.is_imagej and tiff.imagej_metadata:
        return _of_imagej(tiff, tiff.imagej_metadata)
    return np.full(3, np.nan)


def _of_ome(text: str) -> FloatArray:
    sizes: dict[str, str] = {}
    units: dict[str, str] = {}
    for axis, unit, value in _OME_SIZE.findall(text):
        (units if unit else sizes).setdefault(axis, value)
    return np.array([_number(sizes.get(a)) * _mm(units.get(a, "um")) for a in "XYZ"])


def _of_imagej(tiff: TiffFile, facts: dict[str, Any]) -> FloatArray:
    unit = _mm(str(facts.get("unit", "")))
    tags = tiff.pages[0].tags
    spacing = [_pixel(tags.get("XResolution")), _pixel(tags.get("YResolution"))]
    return unit * np.array([*spacing, _number(facts.get("spacing"))])


def _pixel(tag: Any) -> float:
    """Return the size of a pixel from a tag that gives pixels per unit as a fraction."""
    if tag is None or not tag.value[0]:
        return np.nan
    return float(tag.value[1]) / float(tag.value[0])


def _number(given: Any) -> float:
    try:
        return float(given)
    except (TypeError, ValueError):
        return np.nan


def _mm(unit: str) -> float:
    """Return the length of a unit in mm; NaN if it is not a plausible unit of length."""
    plain = unit.strip().lower()
    for micro in ("\\u00b5", "\u00b5", "\u03bc"):  # ImageJ writes the escape itself
        plain = plain.replace(micro, "u")
    return _UNIT_MM.get(_NAMES.get(plain, plain), np.nan)
