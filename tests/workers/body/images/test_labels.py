"""Labels become tissues, and cropped boxes keep their position."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.storage.errors import InputError
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.tissue_labels import (
    crop_to_body,
    default_map,
    label_counts,
    relabel,
    resample_labels,
    summarise,
    tissue_named,
)


def volume(values: object, spacing: float = 1.0) -> Volume:
    return Volume(np.array(values), (spacing, spacing, spacing))


class TestRelabel:
    def test_accepts_names_tissues_and_numbers(self) -> None:
        image = volume([[[0, 7], [300, -5]]])
        out = relabel(image, {0: "air", 7: "Fat", 300: Tissue.GLANDULAR, -5: 3})  # type: ignore[dict-item]
        np.testing.assert_array_equal(out.values, [[[0, 1], [2, 3]]])
        assert out.values.dtype == np.uint8
        assert (out.spacing_mm, out.origin_mm) == (image.spacing_mm, image.origin_mm)

    def test_maps_several_labels_to_one_tissue(self) -> None:
        out = relabel(volume([[[0, 4, 9]]]), {0: "air", 4: "fat", 9: "fat"})
        np.testing.assert_array_equal(out.values, [[[0, 1, 1]]])

    @pytest.mark.parametrize("far", [9, 65_535, 65_536, 10**12, -(10**12)])
    def test_maps_labels_with_distant_numbers(self, far: int) -> None:
        values = np.random.default_rng(0).choice(np.array([0, 1, far]), (3, 4, 5))
        out = relabel(volume(values), {0: "air", 1: "skin", far: "muscle"})
        expected = np.select([values == 1, values == far], [Tissue.SKIN, Tissue.MUSCLE], 0)
        np.testing.assert_array_equal(out.values, expected)

    def test_refuses_label_missing_from_the_map(self) -> None:
        image = volume([[[0, 0, 1], [2, 8, 8]]])
        with pytest.raises(InputError) as caught:
            relabel(image, {0: "air", 1: "skin"})
        message = str(caught.value)
        assert "2 (1 voxel), 8 (2 voxels)" in message
        assert "labels: {0: air, 1: skin, 2: glandular, 8: ?}" in message

    def test_refuses_label_missing_from_the_volume(self) -> None:
        with pytest.raises(InputError) as caught:
            relabel(volume([[[0, 1, 1]]]), {0: "air", 1: "fat", 5: "skin"})
        message = str(caught.value)
        assert message.startswith("Label missing from the volume: 5.")
        assert "was segmented and exported" in message
        assert "Remove it" not in message
        assert "0 (1 voxel), 1 (2 voxels)" in message

    def test_long_lists_of_labels_are_shortened(self) -> None:
        with pytest.raises(InputError, match=r"\.\.\. \(988 more\)"):
            relabel(volume(np.arange(1000).reshape(10, 10, 10)), {})

    @pytest.mark.parametrize(
        ("typed", "meant"), [("glandualr", "glandular"), ("Fats", "fat"), ("mucsle", "muscle")]
    )
    def test_suggests_the_closest_tissue(self, typed: str, meant: str) -> None:
        with pytest.raises(InputError, match=f"Did you mean {meant}"):
            tissue_named(typed)

    @pytest.mark.parametrize("typed", ["bone marrow", "", 6, -1])
    def test_lists_the_known_tissues(self, typed: str) -> None:
        with pytest.raises(InputError, match="Known: air, fat, glandular, skin, muscle, ligament"):
            tissue_named(typed)

    def test_refuses_inverted_map(self) -> None:
        with pytest.raises(InputError, match=r"Write \{1: fat\}, not \{fat: 1\}"):
            relabel(volume([[[1]]]), {"fat": 1})  # type: ignore[dict-item]


class TestDefaultMap:
    def test_maps_tissue_numbers(self) -> None:
        computed = default_map(volume([[[0, 2, 2]]]))
        assert computed == {0: Tissue.AIR, 2: Tissue.GLANDULAR}

    def test_refuses_unknown_labels(self) -> None:
        with pytest.raises(InputError, match=r"6 \(2 voxels\).*\{0: air, 6: \?\}"):
            default_map(volume([[[0, 6, 6]]]))


class TestSummarise:
    def test_matches_hand_calculation(self) -> None:
        values = np.zeros((5, 10, 20), np.uint16)
        values[1:3, 2:4, 5:10] = 2  # 20 voxels of 0.25 ml
        values[4, 9, 19] = 70
        image = Volume(values, (5.0, 5.0, 10.0), (100.0, 0.0, -10.0))
        summary = json.loads(json.dumps(summarise(image)))
        assert summary == {
            "shape": [20, 10, 5],
            "spacing_mm": [5.0, 5.0, 10.0],
            "origin_mm": [100.0, 0.0, -10.0],
            "box_mm": {"lower": [97.5, -2.5, -15.0], "upper": [197.5, 47.5, 35.0]},
            "body_mm": {"lower": [122.5, 7.5, -5.0], "upper": [197.5, 47.5, 35.0]},
            "labels": {
                "0": {"voxels": 979, "ml": 244.75},
                "2": {"voxels": 20, "ml": 5.0},
                "70": {"voxels": 1, "ml": 0.25},
            },
        }

    def test_names_tissues_and_gives_no_box_without_a_body(self) -> None:
        summary = summarise(volume([[[1, 2, 2]]]), named=True)
        assert [entry["tissue"] for entry in summary["labels"].values()] == ["fat", "glandular"]
        assert summarise(volume([[[0, 0]]]))["body_mm"] is None

    @settings(deadline=None, max_examples=40)
    @given(kind=st.sampled_from(["u1", "i2", "u2", "i4", "i8"]), seed=st.integers(0, 1000))
    def test_counts_equal_numpy(self, kind: str, seed: int) -> None:
        limits = np.iinfo(kind)
        values = np.random.default_rng(seed).choice(
            np.array([limits.min, limits.max, 0, 1, 2], dtype=kind), (3, 4, 5)
        )
        labels, numbers = np.unique(values, return_counts=True)
        expected = dict(zip(labels.tolist(), numbers.tolist(), strict=True))
        assert label_counts(volume(values)) == expected


class TestCrop:
    @pytest.fixture
    def image(self) -> Volume:
        values = np.zeros((10, 11, 12), np.uint8)
        values[4:7, 2:9, 5:7] = 1
        return Volume(values, (0.5, 1.0, 2.0), (10.0, 20.0, 30.0))

    @pytest.mark.parametrize(
        ("margin", "shape", "origin"),
        [
            (0, (2, 7, 3), (12.5, 22.0, 38.0)),
            (1, (4, 9, 4), (12.0, 21.0, 38.0)),  # nothing below z: the chest wall
            (3, (8, 11, 6), (11.0, 20.0, 38.0)),  # y has only 2 voxels to spare on either side
        ],
    )
    def test_matches_hand_calculation(
        self, image: Volume, margin: int, shape: tuple[int, ...], origin: tuple[float, ...]
    ) -> None:
        box = crop_to_body(image, margin)
        assert box.shape_xyz == shape
        assert box.origin_mm == origin
        assert box.on_lattice_of(image)
        assert box.values[0].any()
        assert box.values.flags.c_contiguous

    @settings(deadline=None, max_examples=60)
    @given(seed=st.integers(0, 10_000), margin=st.integers(0, 3))
    def test_every_body_voxel_keeps_its_position(self, seed: int, margin: int) -> None:
        rng = np.random.default_rng(seed)
        values = np.zeros((6, 7, 8), np.uint8)
        corner = rng.integers(0, [4, 5, 6])
        values[tuple(slice(c, c + 2) for c in corner)] = rng.integers(1, 4, (2, 2, 2))
        whole = Volume(values, (0.3, 0.7, 1.1), (-5.0, 2.0, 9.0))
        box = crop_to_body(whole, margin)
        back = resample_labels(box, whole)
        np.testing.assert_array_equal(back.values, values)
        assert box.values.max(axis=(1, 2))[0] > 0

    def test_refuses_empty_volume_and_negative_margin(self) -> None:
        with pytest.raises(InputError, match="all air"):
            crop_to_body(volume(np.zeros((3, 3, 3), int)))
        with pytest.raises(InputError, match="got -1"):
            crop_to_body(volume(np.ones((3, 3, 3), int)), -1)


class TestResample:
    def test_resampling_onto_its_own_grid_changes_nothing(self) -> None:
        values = np.random.default_rng(0).integers(0, 4, (5, 6, 7)).astype(np.uint8)
        image = Volume(values, (0.273, 0.3, 0.7), (1.0, -2.0, 3.0))
        np.testing.assert_array_equal(resample_labels(image, image).values, values)

    def test_threefold_refinement_repeats_every_voxel(self) -> None:
        values = np.random.default_rng(0).integers(0, 4, (3, 4, 5)).astype(np.uint8)
        coarse = Volume(values, (3.0, 3.0, 3.0), (1.0, 1.0, 1.0))
        fine = Volume(np.zeros((9, 12, 15), np.uint8), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
        expected = values.repeat(3, axis=0).repeat(3, axis=1).repeat(3, axis=2)
        np.testing.assert_array_equal(resample_labels(coarse, fine).values, expected)
        np.testing.assert_array_equal(
            resample_labels(Volume(expected, fine.spacing_mm), coarse).values, values
        )

    def test_outside_is_air_and_a_common_face_goes_up(self) -> None:
        line = Volume(np.array([[[1, 2, 3]]], np.uint8), (1.0, 1.0, 1.0))  # from -0.5 to 2.5
        like = Volume(np.zeros((1, 1, 6)), (1.0, 1.0, 1.0), (-1.5, 0.0, 0.0))
        computed = resample_labels(line, like)  # centres -1.5, -0.5, 0.5, 1.5, 2.5, 3.5
        np.testing.assert_array_equal(computed.values, [[[0, 1, 2, 3, 0, 0]]])
        assert computed.values.dtype == np.uint8
        assert computed.origin_mm == like.origin_mm

    def test_volume_without_overlap_becomes_air(self) -> None:
        image = volume(np.ones((3, 3, 3), int))
        far = Volume(np.zeros((2, 2, 2)), (1.0, 1.0, 1.0), (50.0, 0.0, 0.0))
        assert not resample_labels(image, far).values.any()
