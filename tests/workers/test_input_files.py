"""Input files: opening, resolution of paths, and error messages."""

import os
from pathlib import Path

import pytest

from palpate.service.remote_client import Client, with_uploaded_images
from palpate.service.study.preflight import preflight
from palpate.service.study.study_keys import read_spec
from palpate.storage.errors import InputError, StoreError
from palpate.workers.input_files import (
    check_regular,
    confined_to,
    named_by,
    read_bytes,
    read_text,
    reading,
)
from palpate.workers.tasks.diagnosis_sources import open_source, understood


def test_named_files_stay_in_the_folder_of_an_upload(tmp_path: Path) -> None:
    folder = tmp_path / "upload"
    folder.mkdir()
    (tmp_path / "secret.csv").write_text("secret")
    (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
    case = folder / "case.yaml"
    outside = ("../secret.csv", str(tmp_path / "secret.csv"), "link.csv", "a/../../secret.csv")
    for name in outside:
        assert named_by(case, name).name.endswith(".csv")
    with confined_to(folder):
        assert named_by(case, "a.csv") == folder / "a.csv"
        for name in outside:
            with pytest.raises(InputError, match="outside the uploaded folder"):
                named_by(case, name)
        with pytest.raises(InputError, match="outside the uploaded folder"):
            read_bytes(tmp_path / "secret.csv", 100)
    with pytest.raises(InputError, match="not a valid file name"):
        named_by(case, "a\0b")


def test_only_regular_files_of_a_limited_size_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match="a pipe or a device"):
            read_bytes(path, 100)
        with pytest.raises(InputError, match="a pipe or a device"):
            check_regular(path)
    (tmp_path / "text").write_bytes("\ufeffa\r\nb".encode())
    assert read_text(tmp_path / "text") == "a\nb"
    with pytest.raises(InputError, match="the limit for such a file"):
        read_bytes(tmp_path / "text", 3)
    with pytest.raises(IsADirectoryError):
        read_bytes(tmp_path, 3)


def test_any_exception_from_a_reader_becomes_one_message() -> None:
    class UnprintableError(ValueError):
        def __str__(self) -> str:
            return str(10**5000)

    raised = [
        KeyError("x"),
        ZeroDivisionError("division by zero\nof a line"),
        OverflowError(),
        RecursionError(),
        MemoryError(),
        UnprintableError(),
        UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
        OSError(5, "Input/output error"),
        ValueError("x" * 100_000),
    ]
    for error in raised:
        with pytest.raises(InputError) as caught, reading(Path("a.nrrd"), "NRRD"):
            raise error
        text = str(caught.value)
        assert text.startswith("a.nrrd ")
        assert "\n" not in text
        assert len(text) < 500
    with pytest.raises(StoreError, match="full"), reading("a", "NRRD"):
        raise StoreError("full")
    with pytest.raises(KeyboardInterrupt), reading("a", "NRRD"):
        raise KeyboardInterrupt


@pytest.mark.parametrize("name", ["case.yaml", "case.json", "case.yml"])
def test_refuses_a_pipe_as_a_case(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    for read in (open_source, understood):
        with pytest.raises(InputError, match="a pipe or a device"):
            read(tmp_path / name)


EYE = """
name: eye
case:
  organ: cornea
  reference: {{frame: {{file: {frame}, pixel_mm: [0.02, 0.02]}}}}
  load: {{iop_mmhg: 15, jet: {{pressure_kpa: 15, diameter_mm: 3, centre_mm: 0}}}}
target: {{frame: {{file: {frame}, pixel_mm: [0.02, 0.02]}}}}
search: {{parameters: {{mu1_pa: [5000, 20000]}}, population: 12}}
"""


@pytest.mark.parametrize("name", ["pipe.png", "device.png"])
def test_refuses_a_pipe_as_a_frame(tmp_path: Path, name: str) -> None:
    """Both the local check and the upload to a service refuse it."""
    frame = tmp_path / name
    if name == "pipe.png":
        os.mkfifo(frame)
    else:
        frame.symlink_to("/dev/zero")
    (tmp_path / "eye.yaml").write_text(EYE.format(frame=frame))
    spec = read_spec(tmp_path / "eye.yaml")
    with pytest.raises(InputError, match="a pipe or a device"):
        preflight(spec, str(tmp_path / "store"))
    with pytest.raises(InputError, match="a pipe or a device"):
        with_uploaded_images(Client("http://127.0.0.1:9"), spec)
