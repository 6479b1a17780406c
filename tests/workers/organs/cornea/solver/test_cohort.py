"""The printed tables reproduce their own statistics."""

import numpy as np
import pytest

from palpate.workers.thesis.thesis_eyes import (
    PRINTED_AVERAGE,
    PRINTED_SD,
    TABLE_5_1,
    TABLE_5_2,
    SyntheticEye,
)


def test_rows_reproduce_the_statistics_of_table_5_2() -> None:
    constants = np.array([eye.constants for eye in TABLE_5_2])
    assert constants.shape == (24, 4)
    # Printed means of the shear terms are truncated to whole numbers, the others rounded.
    assert np.allclose(constants.mean(axis=0), PRINTED_AVERAGE[0], atol=[1, 0.006, 1, 0.006])
    assert np.allclose(constants.std(axis=0, ddof=1), PRINTED_SD[0], atol=[1, 0.006, 1, 0.012])
    jc, mhd = np.array([(eye.jc, eye.mhd_um) for eye in TABLE_5_2]).T
    assert jc.mean() == pytest.approx(PRINTED_AVERAGE[1], abs=0.005)
    assert jc.std(ddof=1) == pytest.approx(PRINTED_SD[1], abs=0.005)
    # The rows give 25.32 um; the table prints 25.4.
    assert mhd.mean() == pytest.approx(25.32, abs=0.005)
    assert mhd.std(ddof=1) == pytest.approx(PRINTED_SD[2], abs=0.05)


def test_average_eye_of_table_5_1_differs_from_the_measured_ranges() -> None:
    iop, pachymetry = np.array([(eye.iop_mmhg, eye.pachymetry_um) for eye in TABLE_5_2]).T
    assert (iop.min(), iop.max(), iop.mean()) == pytest.approx((8, 17, 11.94), abs=0.005)
    assert (pachymetry.min(), pachymetry.max()) == (458, 613)
    assert pachymetry.mean() == pytest.approx(549, abs=0.5)


def test_shear_modulus_varies_less_than_its_terms() -> None:
    moduli = np.array([eye.constants.shear_modulus_mpa for eye in TABLE_5_2])
    assert moduli.mean() == pytest.approx(1.70, abs=0.005)
    assert moduli.std() == pytest.approx(0.41, abs=0.005)
    rng = np.random.default_rng(0)
    constants = np.array([eye.constants for eye in TABLE_5_2])
    smaller = 0
    for _ in range(2000):
        mixed = np.column_stack([rng.permutation(column) for column in constants.T])
        shear = mixed[:, 0] * mixed[:, 1] + mixed[:, 2] * mixed[:, 3]
        smaller += shear.std() / shear.mean() <= moduli.std() / moduli.mean()
    assert smaller / 2000 < 0.01
    left, right = moduli[::2], moduli[1::2]
    assert np.corrcoef(left, right)[0, 1] == pytest.approx(0.77, abs=0.01)


@pytest.mark.parametrize("eye", TABLE_5_1, ids=lambda eye: eye.name)
def test_constants_reproduce_the_printed_errors_of_table_5_1(eye: SyntheticEye) -> None:
    target, estimate = np.array(eye.target), np.array(eye.estimate)
    errors = 100 * np.abs(estimate - target) / target
    assert np.allclose(errors, eye.printed_errors_percent, atol=0.05)


def test_eyes_are_named_in_pairs() -> None:
    assert [eye.patient for eye in TABLE_5_2] == [n for n in range(1, 13) for _ in range(2)]
    assert [eye.side for eye in TABLE_5_2[:2]] == ["left", "right"]
    assert TABLE_5_2[12].constants.mu1_pa == 10978
