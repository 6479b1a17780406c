"""Conversion of labels to tissues: by name, and by number only as stated."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
import pytest
import yaml

from palpate.service.cli import main
from palpate.service.export import TISSUE_NAMES, export_volume
from palpate.service.study.study_keys import read_spec
from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import save_volume
from palpate.storage.values import Tissue, Volume
from palpate.workers.body.images.image_formats import read_volume_file
from palpate.workers.body.images.named_labels import read_label_file, read_tissues
from palpate.workers.body.images.scan_orientation import whole_numbers
from palpate.workers.body.images.tissue_labels import crop_to_body, tissue_in
from palpate.workers.organs.breast.breast_keys import BreastCase, BreastTarget
from palpate.workers.organs.breast.breast_organ import ORGAN
from palpate.workers.organs.breast.scanned_case_files import CaseImages, no_store
from palpate.workers.organs.breast.scanned_case_keys import CaseScans
from palpate.workers.tasks.task_store import BodyStore
from tests.cases.images.image_cases import (
    LPS,
    SLICER,
    breast,
    segments,
    tissues,
    write_nrrd,
    write_segmentation,
)

SNAP = """\
# ITK-SnAP Label Description File
    0     0    0    0        0  0  0    "Clear Label"
    1   255    0    0        1  1  1    "Skin"
    2     0  255    0        1  1  1    "Adipose tissue"
    3     0    0  255        1  1  1    "Fibroglandular tissue"
    4   255  255    0        1  1  1    "Cooper's ligaments"
"""
CTBL = """\
# Color table file
0 Background 0 0 0 0
1 Skin 177 122 101 255
2 Adipose_tissue 230 220 70 255
3 Glandular 128 174 128 255
4 Ligament 111 184 210 255
"""


def expected() -> np.ndarray[Any, Any]:
    """Return the body of `image_cases` as tissues, cropped."""
    return crop_to_body(Volume(tissues(), (2.0, 2.0, 2.0))).values


def slicer(folder: Path, **changes: Any) -> Path:
    return write_nrrd(folder / "a.seg.nrrd", breast(), **segments(SLICER), **changes)


def xml_names(path: Path, names: dict[int, str]) -> Path:
    """Write a NIfTI file with label names in the format of TotalSegmentator."""
    labels = "".join(
        f'<Label Key="{k}" Red="1"><![CDATA[{n}]]></Label>\n' for k, n in names.items()
    )
    text = (
        f'<?xml version="1.0"?><CaretExtension><LabelTable>{labels}</LabelTable></CaretExtension>'
    )
    image = nib.Nifti1Image(breast().transpose(), np.diag([-2.0, -2.0, 2.0, 1.0]))
    image.header.extensions.append(nib.nifti1.Nifti1Extension("comment", text.encode()))
    nib.save(image, path)
    return path


class TestNamesInFiles:
    def test_slicer_segment_names_are_read(self, tmp_path: Path) -> None:
        np.testing.assert_array_equal(read_tissues(slicer(tmp_path)).volume.values, expected())

    def test_dicom_segment_names_are_read(self, tmp_path: Path) -> None:
        names = {1: ("Skin", "Skin"), 2: ("Segment_2", "Adipose tissue"), 3: ("FGT", "Tissue")}
        names[4] = ("Cooper's ligament", "Tissue")
        path = write_segmentation(tmp_path / "a.dcm", breast(), names)
        np.testing.assert_array_equal(read_tissues(path).volume.values, expected())

    def test_dicom_label_and_type_must_agree(self, tmp_path: Path) -> None:
        path = write_segmentation(tmp_path / "a.dcm", breast(), {1: ("Fat", "Skin")})
        with pytest.raises(InputError, match="labelled 'Fat', but its property type is 'Skin'"):
            read_tissues(path)

    def test_names_in_a_nifti_extension_are_read(self, tmp_path: Path) -> None:
        names = {1: "skin", 2: "subcutaneous_fat", 3: "glandular", 4: "ligament"}
        path = xml_names(tmp_path / "a.nii.gz", names)
        np.testing.assert_array_equal(read_tissues(path).volume.values, expected())

    @pytest.mark.parametrize(
        ("file", "text"),
        [
            ("labels.txt", SNAP),
            ("colours.ctbl", CTBL),
            ("names.json", json.dumps({"1": "skin", "2": "fat", "3": "gland", "4": "ligament"})),
            ("dataset.json", json.dumps({"labels": {n: k for k, n in SLICER.items()}})),
        ],
    )
    def test_label_files_are_read(self, tmp_path: Path, file: str, text: str) -> None:
        image = write_nrrd(tmp_path / "a.nrrd", breast())
        (tmp_path / file).write_text(text)
        read = read_tissues(image, str(tmp_path / file))
        np.testing.assert_array_equal(read.volume.values, expected())

    @pytest.mark.parametrize(
        ("file", "text", "said"),
        [
            (
                "a.txt",
                "fat = 1\n",
                "line 1: found 'fat = 1', expected a label in the format of ITK-SNAP",
            ),
            ("a.txt", CTBL + "1 Fat 0 0 0 0\n", "line 7: label 1 is named twice"),
            ("a.json", '{"fat": "gland"}', "has the entry 'fat'"),
            ("a.json", "{", "not valid JSON"),
            ("a.ctbl", "# nothing\n", "contains no label names"),
        ],
    )
    def test_refuses_invalid_label_files(
        self, tmp_path: Path, file: str, text: str, said: str
    ) -> None:
        (tmp_path / file).write_text(text)
        with pytest.raises(InputError, match=said):
            read_label_file(tmp_path / file)

    def test_refuses_layers_with_export_advice(self, tmp_path: Path) -> None:
        both = np.stack([breast(), breast()], axis=-1)  # layers run fastest
        header = LPS | {"space directions": np.vstack([np.full(3, np.nan), 2 * np.eye(3)])}
        header["kinds"] = ["list", "domain", "domain", "domain"]
        fields = segments(SLICER, {3: 1})
        path = write_nrrd(tmp_path / "a.seg.nrrd", both, header, **fields)
        with pytest.raises(InputError, match=r"2 layers.*overlap.*label map: Segment Editor"):
            read_volume_file(path)

    def test_layers_are_those_of_the_axis_without_direction(self, tmp_path: Path) -> None:
        both = np.stack([breast(), breast()])  # layers run slowest
        header = LPS | {"space directions": np.vstack([2 * np.eye(3), np.full(3, np.nan)])}
        header["kinds"] = ["domain", "domain", "domain", "list"]
        path = write_nrrd(tmp_path / "a.seg.nrrd", both, header, **segments(SLICER, {3: 1}))
        with pytest.raises(InputError, match="has segments in 2 layers"):
            read_volume_file(path)
        path = write_nrrd(tmp_path / "b.seg.nrrd", both[:1], header, **segments(SLICER))
        np.testing.assert_array_equal(read_volume_file(path).values, breast())
        path = write_nrrd(tmp_path / "c.seg.nrrd", breast(), **segments(SLICER, {3: 1}))
        with pytest.raises(InputError, match="has segments in 2 layers"):
            read_volume_file(path)


class TestStatedLabels:
    def test_numbers_must_agree_with_names(self, tmp_path: Path) -> None:
        numbers = {0: "air", 1: "fat", 2: "glandular", 3: "skin", 4: "ligament"}
        with pytest.raises(InputError, match=r"Label 1 is given as fat, but .* names it 'Skin'"):
            read_tissues(slicer(tmp_path), numbers)
        right = {0: "air", 1: "skin", 2: "fat", 3: "glandular", 4: "ligament"}
        read = read_tissues(slicer(tmp_path), right)
        np.testing.assert_array_equal(read.volume.values, expected())

    def test_names_are_mapped_as_given(self, tmp_path: Path) -> None:
        read = read_tissues(slicer(tmp_path), {"skin": "fat", "Ligament": "fat"})
        assert set(np.unique(read.volume.values)) == {0, Tissue.FAT, Tissue.GLANDULAR}

    def test_refuses_a_name_that_the_file_lacks(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"no label named 'Tumour'.*1 'Skin', 2 'Fat'"):
            read_tissues(slicer(tmp_path), {"Tumour": "glandular"})
        with pytest.raises(InputError, match=r"has no names of labels.*it has 0, 1, 2, 3, 4"):
            read_tissues(write_nrrd(tmp_path / "b.nrrd", breast()), {"Fat": "fat"})

    def test_unknown_names_come_with_a_map_to_complete(self, tmp_path: Path) -> None:
        names = segments(SLICER | {3: "Lesion"})
        path = write_nrrd(tmp_path / "a.seg.nrrd", breast(), **names)
        with pytest.raises(InputError) as caught:
            read_tissues(path)
        said = str(caught.value)
        assert "no tissue is known for 'Lesion' (label 3)" in said
        assert "labels: {Skin: skin, Fat: fat, Lesion: ?, Ligament: ligament}" in said
        read = read_tissues(path, {"Lesion": "glandular"})
        np.testing.assert_array_equal(read.volume.values, expected())

    def test_refuses_a_label_without_a_name(self, tmp_path: Path) -> None:
        some = segments({label: name for label, name in SLICER.items() if label != 2})
        path = write_nrrd(tmp_path / "a.seg.nrrd", breast(), **some)
        with pytest.raises(InputError, match="label 2, which has no name"):
            read_tissues(path)

    @pytest.mark.parametrize(
        ("names", "said"),
        [
            (SLICER, "no glandular voxel: its label 'Glandular' is empty"),
            ({1: "Skin", 2: "Fat", 4: "Ligament"}, "no glandular voxel: its labels are 1 'Skin'"),
        ],
    )
    def test_refuses_a_missing_tissue(
        self, tmp_path: Path, names: dict[int, str], said: str
    ) -> None:
        without = np.where(breast() == 3, 2, breast()).astype(np.uint8)
        path = write_nrrd(tmp_path / "a.seg.nrrd", without, **segments(names))
        with pytest.raises(InputError, match=said):
            read_tissues(path)

    @pytest.mark.parametrize(
        ("name", "tissue"),
        [
            ("Background", Tissue.AIR),
            ("Clear Label", Tissue.AIR),
            ("ADIPOSE TISSUE", Tissue.FAT),
            ("torso_fat", Tissue.FAT),
            ("Fibro-glandular tissue (left)", Tissue.GLANDULAR),
            ("FGT", Tissue.GLANDULAR),
            ("Pectoralis major muscle", Tissue.MUSCLE),
            ("Cooper's ligaments", Tissue.LIGAMENT),
            ("non-fat", None),
            ("fat and skin", None),
            ("Segment_1", None),
            ("breast", None),
            ("", None),
        ],
    )
    def test_tissues_are_recognised_by_name(self, name: str, tissue: Tissue | None) -> None:
        assert tissue_in(name) == tissue


class TestStudiesAndImports:
    def test_study_files_take_names_and_label_files(self, tmp_path: Path) -> None:
        slicer(tmp_path)
        write_nrrd(tmp_path / "b.nrrd", breast())
        (tmp_path / "labels.txt").write_text(SNAP)
        study = {
            "name": "s",
            "case": {"reference": {"volume": "a.seg.nrrd", "labels": {"Fat": "fat"}}},
            "target": {"volume": "b.nrrd", "labels": "labels.txt"},
            "search": {"parameters": {"E_fat_kpa": [5, 20]}},
        }
        study["case"]["load"] = {"force_n": 10}  # type: ignore[index]
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(study))
        spec = read_spec(tmp_path / "s.yaml")
        assert isinstance(spec.case, BreastCase)
        for image in (spec.case.reference, spec.target):
            np.testing.assert_array_equal(ORGAN.make_body(image).values, expected())
        assert ORGAN.body_files(spec.target)[1].name == "labels.txt"
        again = type(spec).model_validate(spec.as_dict())
        assert again.as_dict() == spec.as_dict()

    def test_numbers_round_trip_through_json(self) -> None:
        reference = {"volume": "a", "labels": {"0": "air", "2": "Fat"}}
        case = BreastCase.model_validate({"reference": reference, "load": {"force_n": 1}})
        assert case.reference.labels == {0: "air", 2: "fat"}

    @pytest.mark.parametrize(
        ("labels", "said"),
        [
            ({"fat": 1}, "write {1: fat}, not {fat: 1}"),
            ({1: "fta"}, "Did you mean fat"),
            ({"1": "fat", 1: "skin"}, "label 1 is named twice"),
            ([1, 2], "expected a mapping such as"),
        ],
    )
    def test_refuses_invalid_maps(self, labels: Any, said: str) -> None:
        reference = {"volume": "a", "labels": labels}
        with pytest.raises(ValueError, match=said):
            BreastCase.model_validate({"reference": reference, "load": {"force_n": 1}})

    def test_import_reads_label_names(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        slicer(tmp_path)
        numbers = "0=air,1=fat,2=glandular,3=skin,4=ligament"
        assert main(["import", "a.seg.nrrd", "--name", "a", "--labels", numbers]) == 2
        assert "names it 'Skin'" in capsys.readouterr().err
        assert not Path("runs/images/a.png").exists()
        command = ["import", "a.seg.nrrd", "--name", "a", "--labels", "Skin=fat", "--anyway"]
        assert main([*command, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["label_tissues"] == {
            "0": "air",
            "1": "fat",
            "2": "fat",
            "3": "glandular",
            "4": "ligament",
        }
        voxels = int((breast() == 3).sum())
        gland = {"tissue": "glandular", "voxels": voxels, "ml": voxels * 0.008}
        assert found["labels"]["2"] == gland

    def test_a_label_file_is_part_of_the_body(self, tmp_path: Path) -> None:
        write_nrrd(tmp_path / "a.nrrd", breast())
        named = tmp_path / "names.txt"
        reference = {"volume": str(tmp_path / "a.nrrd"), "labels": str(named)}
        bodies = BodyStore(open_store(tmp_path / "store"), ORGAN)
        digests = []
        for text in (SNAP, SNAP.replace("Skin", "Fat")):
            named.write_text(text)
            case = BreastCase.model_validate({"reference": reference, "load": {"force_n": 1}})
            digests.append(bodies.bring_body(case.reference))
        assert digests[0] != digests[1]


class TestCases:
    def images(self, folder: Path, stored: Any = no_store, **how: Any) -> Callable[[str], Volume]:
        loads = [{"volume": "b", "force_n": 1}]
        scans = CaseScans.model_validate({"reference": "a", "loads": loads} | how)
        return CaseImages(folder / "case.yaml", scans, stored).tissues

    def test_names_are_read_and_skin_counts_as_fat(self, tmp_path: Path) -> None:
        values = np.where(breast() == 4, 2, breast()).astype(np.uint8)
        write_nrrd(tmp_path / "a.seg.nrrd", values, **segments(SLICER))
        found = self.images(tmp_path)("a.seg.nrrd").values
        np.testing.assert_array_equal(found, np.array([0, 1, 1, 2], np.uint8)[values])

    def test_ligament_must_be_given(self, tmp_path: Path) -> None:
        slicer(tmp_path)
        with pytest.raises(InputError, match="has ligament, but a diagnosis has only air, fat"):
            self.images(tmp_path)("a.seg.nrrd")
        found = self.images(tmp_path, labels={"Ligament": "fat"})("a.seg.nrrd").values
        np.testing.assert_array_equal(found, np.array([0, 1, 1, 2, 1], np.uint8)[breast()])

    def test_axes_turn_all_scans(self, tmp_path: Path) -> None:
        values = np.minimum(tissues(), 2)
        write_nrrd(tmp_path / "a.nrrd", values)
        labels = {0: "air", 1: "fat", 2: "glandular"}
        turned = self.images(tmp_path, axes="L S A", labels=labels)("a.nrrd")
        expected = read_volume_file(tmp_path / "a.nrrd", axes="x,z,-y")
        np.testing.assert_array_equal(turned.values, expected.values)

    def test_a_scan_may_be_a_volume_of_the_store(self, tmp_path: Path) -> None:
        store = open_store(tmp_path / "store")
        volume = Volume(np.minimum(tissues(), 3), (2.0, 2.0, 2.0))
        save_volume(store, "0" * 16, volume, meta={"name": "rest"})
        from palpate.workers.tasks.diagnosis_sources import volumes_of

        found = self.images(tmp_path, volumes_of(tmp_path / "store"))("rest")
        np.testing.assert_array_equal(found.values, np.array([0, 1, 2, 1], np.uint8)[volume.values])
        with pytest.raises(InputError, match="names other, which is neither in the folder nor"):
            self.images(tmp_path, volumes_of(tmp_path / "store"))("other")
        with pytest.raises(InputError, match="spacing and axes are known"):
            self.images(tmp_path, volumes_of(tmp_path / "store"), axes="L S A")("rest")


class TestNumbersWithoutNames:
    def test_are_never_guessed_in_a_study_or_an_import(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.chdir(tmp_path)
        write_nrrd(tmp_path / "a.nrrd", np.minimum(tissues(), 2))
        with pytest.raises(InputError) as refusal:
            read_tissues(tmp_path / "a.nrrd")
        text = str(refusal.value)
        assert "labels: {0: air, 1: ?, 2: ?}" in text
        inside = int((tissues() == 1).sum()) * 0.008
        assert f"1: {inside:.3g} ml, 0% of the body's surface, x -44 to -30" in text
        assert "100% of the body's surface" in text
        assert main(["import", "a.nrrd", "--name", "a"]) == 2
        assert "--labels '0=air,1=?,2=?'" in capsys.readouterr().err
        assert not Path("runs").exists()

    def test_are_never_guessed_in_a_diagnosis(self, tmp_path: Path) -> None:
        write_nrrd(tmp_path / "a.nrrd", np.minimum(tissues(), 2))
        images = TestCases().images
        with pytest.raises(InputError, match=r"labels: \{0: air, 1: \?, 2: \?\}"):
            images(tmp_path)("a.nrrd")
        stated = images(tmp_path, labels={0: "air", 1: "glandular", 2: "fat"})("a.nrrd")
        np.testing.assert_array_equal(stated.values, np.array([0, 2, 1])[np.minimum(tissues(), 2)])

    def test_many_numbers_are_counted(self, tmp_path: Path) -> None:
        write_nrrd(tmp_path / "a.nrrd", np.arange(1000, dtype=np.int16).reshape(10, 10, 10))
        with pytest.raises(InputError, match="and 992 more labels"):
            read_tissues(tmp_path / "a.nrrd")

    def test_a_study_shows_the_labels_of_both_scans(self) -> None:
        numbers = {0: "air", 1: "glandular", 2: "fat"}
        reference = {"volume": "in/rest.nii", "labels": numbers}
        case = BreastCase.model_validate({"reference": reference, "load": {"force_n": 1}})
        shown = dict(case.understood([]))
        assert shown["labels at rest"] == "rest.nii: 0 air, 1 glandular, 2 fat"
        target = BreastTarget.model_validate({"volume": "in/pressed.seg.nrrd"})
        assert dict(target.understood) == {
            "labels under load": "pressed.seg.nrrd: by the names in the file"
        }


class TestValues:
    @pytest.mark.parametrize("error", [0.0, 6.99e-10, 9e-4, -9e-4])
    def test_nearly_whole_numbers_are_labels(self, error: float) -> None:
        found = whole_numbers(breast() + error, "a")
        np.testing.assert_array_equal(found, breast())
        assert found.dtype == np.uint8

    def test_a_scaled_nifti_is_read(self, tmp_path: Path) -> None:
        image = nib.Nifti1Image((breast() * 7).transpose(), np.diag([-2.0, -2.0, 2.0, 1.0]))
        image.header.set_slope_inter(np.float32(1 / 7), 0)
        image.header.set_data_dtype(np.int16)
        nib.save(image, tmp_path / "a.nii")
        np.testing.assert_array_equal(read_volume_file(tmp_path / "a.nii").values % 7, breast() % 7)

    @pytest.mark.parametrize(
        ("bad", "said"),
        [(2e-3, "it contains 0.002"), (np.nan, "it contains NaN"), (np.inf, "infinity")],
    )
    def test_fractions_and_non_finite_numbers_are_refused(self, bad: float, said: str) -> None:
        values = breast().astype(float)
        values[0, 0, 0] = bad
        with pytest.raises(InputError, match=said):
            whole_numbers(values, "a")


class TestExports:
    def test_names_are_written_and_read_back(self, tmp_path: Path) -> None:
        path = tmp_path / "a.seg.nrrd"
        export_volume(path, Volume(tissues(), (2.0, 2.0, 2.0)), TISSUE_NAMES)
        read = read_tissues(path)
        assert dict(read.image.names) == {1: "Fat", 2: "Glandular", 3: "Skin", 5: "Ligament"}
        np.testing.assert_array_equal(read.volume.values, expected())

    def test_palpate_phantom_writes_names(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        assert main(["phantom", "--spacing-mm", "2", "--out", "a.nrrd"]) == 0
        assert set(read_tissues(Path("a.nrrd")).image.names.values()) >= {"Fat", "Glandular"}
