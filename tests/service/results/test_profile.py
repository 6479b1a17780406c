"""The profile of a study with a known sum of squares."""

from pathlib import Path

import numpy as np
import pytest

from palpate.service.results.profile_likelihood import Profile, profile_of
from palpate.service.study.study_folder import StudyLog
from palpate.storage.backends.store_paths import StudyLayout
from palpate.storage.errors import InputError
from tests.recovery.stand_ins import SPEC, TASKS, Inline, executions, run, small_spec


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("profile") / "demo"
    run(home, Inline(), small_spec(SPEC.replace("  pop", "  strategy: least-squares\n  pop")))
    return home


def profile(folder: Path, name: str) -> Profile:
    spec = small_spec(SPEC.replace("  pop", "  strategy: least-squares\n  pop"))
    log = StudyLog.read(StudyLayout(folder).journal)
    return profile_of(spec, log, TASKS, Inline(), name, 7)  # type: ignore[arg-type]


def test_profile_matches_the_exact_parabola(folder: Path) -> None:
    """Twenty residuals E / E_true - 1 with a noise of 1 %: the rise is 20 ((E/10 - 1) / 0.01)^2."""
    found = profile(folder, "E_fat")
    values = np.array([p.value for p in found.points])
    rises = np.array([p.rise for p in found.points], float)
    assert np.allclose(rises, 20 * ((values / 10 - 1) / 0.01) ** 2, atol=0.02)
    half = 10 * 0.01 * (2.706 / 20) ** 0.5
    assert found.lower == pytest.approx(10 - half, rel=1e-3)
    assert found.upper == pytest.approx(10 + half, rel=1e-3)
    assert all(p.genes["E_glandular_kpa"] == pytest.approx(40, rel=1e-3) for p in found.points)


def test_repeated_profile_reuses_stored_evaluations(folder: Path) -> None:
    profile(folder, "E_fat_kpa")
    ran = executions(folder)
    profile(folder, "E_fat_kpa")
    assert executions(folder) == ran


def test_rejects_an_unknown_constant(folder: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'E_fat_kpa'"):
        profile(folder, "E_fatt_kpa")
