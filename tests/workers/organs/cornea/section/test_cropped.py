"""Cropping of a section between two lines."""

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.workers.organs.cornea.section_comparison import SectionTarget, overlap_areas
from palpate.workers.organs.cornea.section_outline import cropped_section, generated_section


def test_both_surfaces_end_on_the_lines() -> None:
    whole = generated_section()
    part = cropped_section(whole, -4.0, 3.5)
    for surface, own in (
        (part.anterior_mm, whole.anterior_mm),
        (part.posterior_mm, whole.posterior_mm),
    ):
        assert surface[[0, -1], 0].tolist() == [-4.0, 3.5]
        assert np.allclose(np.interp(surface[:, 0], *own.T), surface[:, 1], atol=1e-12)
    # A shorter part is contained in the longer one, so the overlap is the ratio of the areas.
    shorter = cropped_section(whole, -4.0, 3.0)
    areas = [overlap_areas(s.outline_mm, s.outline_mm)[0] for s in (shorter, part)]
    assert SectionTarget(part).score(shorter).jc == pytest.approx(areas[0] / areas[1])


def test_lines_beyond_the_ends_change_nothing() -> None:
    whole = generated_section()
    same = cropped_section(whole, -9.0, 9.0)
    assert np.array_equal(same.anterior_mm, whole.anterior_mm)
    assert np.array_equal(same.posterior_mm, whole.posterior_mm)


def test_rejects_a_section_outside_the_lines() -> None:
    with pytest.raises(InputError, match="it is outside"):
        cropped_section(generated_section(), 7.0, 9.0)
