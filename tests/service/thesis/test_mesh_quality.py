"""Phantoms, meshes and compressions of thesis section 4.4, at small size."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.mesh.mesh_hierarchy import build_hierarchy
from palpate.workers.body.phantom.phantom_generation import Phantom, generate_breast
from palpate.workers.mechanics.fem.loads_and_regions import DistanceControl
from palpate.workers.mechanics.materials.polynomial_laws import NeoHookean
from palpate.workers.thesis.mesh_quality import MeshKind, QualityRow, aspect_rows, made_mesh, row_of
from palpate.workers.thesis.phantom_compression import (
    REDUCED,
    Compressed,
    compared,
    compress,
    compression_problem,
    constants_of,
    density_of,
    thesis_phantom,
    two_materials,
)


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return generate_breast(replace(REDUCED, spacing_mm=0.75, glandular_fraction=0.2), 4)


@pytest.fixture(scope="module")
def pressed(phantom: Phantom) -> Compressed:
    mesh = build_hierarchy(two_materials(phantom.labels), element_size_mm=3.0)
    return compress(phantom, mesh, "CC", "neo-Hookean")


@pytest.fixture(scope="module")
def rows() -> tuple[QualityRow, QualityRow]:
    def row(kind: MeshKind) -> QualityRow:
        return row_of(2, kind, made_mesh(2, kind))

    return row("adaptive 3 mm"), row("homogeneous")


def test_densities_run_from_7_to_35_percent() -> None:
    assert [density_of(n) for n in (1, 10)] == [0.07, 0.35]
    assert density_of(4) - density_of(3) == pytest.approx(0.28 / 9)
    with pytest.raises(InputError, match="1 to 10"):
        density_of(11)
    facts = thesis_phantom(10).facts
    assert facts["glandular_fraction"] == pytest.approx(0.35, rel=0.01)
    assert facts["volume_ml"] == pytest.approx(250 / 8, rel=0.01)


def test_two_materials_keep_only_fat_and_gland(phantom: Phantom) -> None:
    found = two_materials(phantom.labels).values
    assert set(np.unique(found)) == {Tissue.AIR, Tissue.FAT, Tissue.GLANDULAR}
    assert np.array_equal(found == Tissue.GLANDULAR, phantom.labels.values == Tissue.GLANDULAR)


@pytest.mark.slow
def test_homogeneous_meshes_are_more_regular(rows: tuple[QualityRow, QualityRow]) -> None:
    adaptive, homogeneous = rows
    for row in rows:
        assert row.bad == 0
        assert row.worst_aspect <= 8.86
        assert all(0 < row.mean[name] <= 1 for name in ("M1", "M2", "M3", "M4"))
        assert abs(row.agreement.body_volume) < 0.002
    # Thesis section 4.4.3: more regular, but not aligned with the tissue.
    assert homogeneous.mean["aspect"] < adaptive.mean["aspect"]
    assert abs(adaptive.agreement.tissue_volume) < 0.01
    assert abs(adaptive.agreement.tissue_volume) < abs(homogeneous.agreement.tissue_volume)
    assert adaptive.tets < 0.5 * homogeneous.tets
    assert abs(adaptive.agreement.labels - homogeneous.agreement.labels) < 0.01


@pytest.mark.slow
def test_table_has_mean_averages_and_the_worst_aspect(rows: tuple[QualityRow, QualityRow]) -> None:
    adaptive, homogeneous = rows
    other = replace(adaptive, mean=adaptive.mean | {"aspect": 2.0}, worst_aspect=1.0)
    first, second = aspect_rows((adaptive, other, homogeneous))
    assert first.average == pytest.approx((adaptive.mean["aspect"] + 2.0) / 2)
    assert first.worst == adaptive.worst_aspect
    assert (second.kind, second.worst) == ("homogeneous", homogeneous.worst_aspect)


def test_constants_match_table_4_1() -> None:
    neo, mooney = constants_of("neo-Hookean"), constants_of("Mooney-Rivlin")
    for tissue, mu in ((Tissue.FAT, 12750e-6), (Tissue.GLANDULAR, 36750e-6)):
        assert neo[tissue].mu_mpa == pytest.approx(mu)
        law = mooney[tissue].law
        assert law is not None
        assert law.shear_modulus_mpa == pytest.approx(NeoHookean(mu).shear_modulus_mpa)
        assert mooney[tissue].kappa_mpa == neo[tissue].kappa_mpa
    assert neo[Tissue.FAT].young_mpa == pytest.approx(0.037995)
    with pytest.raises(InputError, match="law must be one of"):
        constants_of("Ogden")  # type: ignore[arg-type]


def test_plate_distances_match_the_thesis(phantom: Phantom) -> None:
    for view, width, left in (("CC", 37.5, 0.5), ("MLO", None, 0.75)):
        problem = compression_problem(phantom.labels, view, "neo-Hookean")  # type: ignore[arg-type]
        load = problem.load
        assert isinstance(load, DistanceControl)
        y, x = np.nonzero((phantom.labels.values > 0).any(axis=0))
        along = (x * -0.7071 + y * 0.7071 if view == "MLO" else y) * 0.75
        thickness = width or float(np.ptp(along)) + 0.75 * np.sqrt(2)
        assert load.upper_mm - load.lower_mm == pytest.approx(left * thickness, abs=0.6)
    with pytest.raises(InputError, match="view must be one of"):
        compression_problem(phantom.labels, "LM", "neo-Hookean")  # type: ignore[arg-type]


def test_compression_halves_the_thickness_and_preserves_the_gland(
    phantom: Phantom, pressed: Compressed
) -> None:
    assert pressed.outcome.converged
    assert pressed.labels is not None
    assert pressed.compartments is not None
    thick = np.ptp(np.nonzero(pressed.labels.values.any(axis=(0, 2)))[0]) + 1
    assert thick * 0.75 == pytest.approx(37.5 / 2, abs=1.6)
    before = np.count_nonzero(phantom.labels.values == Tissue.GLANDULAR)
    assert np.count_nonzero(pressed.compartments.values) == pytest.approx(before, rel=0.05)
    assert pressed.seconds_per_1000 > 0


def test_compares_a_phantom_with_itself_and_with_a_shifted_copy(pressed: Compressed) -> None:
    same = compared(4, "CC", "neo-Hookean", pressed, pressed)
    assert (same.centroid_mm, same.volume_mm3, same.jc, same.mhd_mm) == (0.0, 0.0, 1.0, 0.0)
    assert (same.whole_jc, same.lost) == (1.0, 0)
    ids = pressed.compartments
    assert ids is not None
    x, y, z = ids.origin_mm
    moved = replace(pressed, compartments=Volume(ids.values, ids.spacing_mm, (x + 0.75, y, z)))
    row = compared(4, "CC", "neo-Hookean", pressed, moved)
    assert row.centroid_mm == pytest.approx(0.75)
    assert row.volume_mm3 == 0.0
    assert 0 < row.jc < 1
    assert 0 < row.mhd_mm <= 0.75


def test_counts_lost_compartments_and_skips_diverged_bodies(pressed: Compressed) -> None:
    ids = pressed.compartments
    assert ids is not None
    first = int(ids.values[ids.values > 0].min())
    fewer = np.where(ids.values == first, 0, ids.values)
    row = compared(
        4, "CC", "neo-Hookean", pressed,
        replace(pressed, compartments=Volume(fewer, ids.spacing_mm, ids.origin_mm)),
    )  # fmt: skip
    assert row.lost == 1
    assert row.compartments == len(np.unique(ids.values)) - 2
    assert row.jc == 1.0
    failed = compared(4, "CC", "neo-Hookean", pressed, Compressed(None, None, pressed.outcome, 1.0))
    assert np.isnan(failed.jc)
    assert failed.compartments == 0
