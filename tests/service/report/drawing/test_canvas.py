"""Reproducible figures as text."""

import re

import numpy as np

from palpate.service.report.drawing.matplotlib_figures import figure, svg


def drawn(width: float) -> str:
    made = figure(4, 3)
    made.set_layout_engine("none")
    axes = made.add_axes((0.1, 0.1, width, 0.8))
    axes.plot([0, 1, 2], [0, 2, 1], marker="o", clip_on=True)
    axes.imshow(np.eye(3), extent=(0, 1, 0, 1))
    return svg(made)


def test_output_is_independent_of_rounding() -> None:
    assert drawn(0.8) == drawn(np.nextafter(0.8, 1.0))
    assert drawn(0.8) != drawn(0.7)


def test_references_are_defined() -> None:
    text = drawn(0.8)
    names = re.findall(r'\bid="([^"]+)"', text)
    referred = set(re.findall(r"url\(#([^)]+)\)", text)) | set(re.findall(r'href="#([^"]+)"', text))
    assert len(names) == len(set(names))
    assert referred <= set(names)
    assert len(referred) >= 2
