"""Bad files of every kind on the command line: each must give one message and exit code 2."""

import os
import re
import shutil
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.service import cli
from palpate.service.cluster import dask_cluster as cluster_module
from palpate.service.errors_and_interrupts import ClusterError
from palpate.storage.errors import PalpateError
from tests.cases.bench.bench_cases import described, write
from tests.robustness.mutations import damaged
from tests.robustness.outcome import SECRET, Outcome, outcome_of, with_secret
from tests.robustness.seeds import SEEDS, Seed, labels

MUTATIONS = 6  # of each valid file
ACCEPTED = "accepted: workers would begin now"
LABELS = "0=air,1=fat,2=glandular"
CORNEA = """
name: eye
case:
  organ: cornea
  reference: {{frame: {{file: {name}, pixel_mm: [0.02, 0.02]}}}}
  load: {{iop_mmhg: 15, jet: {{pressure_kpa: 15, diameter_mm: 3, centre_mm: 0}}}}
target: {{frame: {{file: {name}, pixel_mm: [0.02, 0.02]}}}}
search: {{parameters: {{mu1_pa: [5000, 20000]}}, population: 12}}
"""
EXPERIMENT_CHANGES: dict[str, Callable[[dict], object]] = {
    "column formats": lambda d: d["markers"].update(column="{marker}_{axis:>999999999}"),
    "column attributes": lambda d: d["markers"].update(column="{marker.__class__}{marker}{axis}"),
    "down of 1e308": lambda d: d.update(down=[1e308, 1e308, 1e308]),
    "box of 1e308": lambda d: d.update(body={"box_mm": [1e308, 1e308, 1e308]}),
    "box of 1e-300": lambda d: d.update(body={"box_mm": [1e-300, 30, 60]}),
    "force of 1e308": lambda d: d["states"][0]["forces"][0].update(force_n=[0, 0, 1e308]),
    "density of 1e308": lambda d: d["materials"]["gel"].update(density_kg_per_m3=1e308),
    "windows of 1e308": lambda d: d["markers"].update(rest_s=[-1e308, 1e308]),
    "a foreign recording": lambda d: d["states"][0].update(files=["/etc/passwd"]),
    "a null byte": lambda d: d["states"][0].update(files=["a\0.csv"]),
    "a recording that is a folder": lambda d: d["states"][0].update(files=["."]),
    "a device": lambda d: d["states"][0].update(files=["/dev/zero"]),
    "tiny voxels": lambda d: d.update(body={"mesh": "a.stl", "voxel_mm": 1e-9}),
    "huge voxels": lambda d: d.update(body={"mesh": "a.stl", "voxel_mm": 1e300}),
    "huge units": lambda d: d.update(body={"mesh": "a.stl", "voxel_mm": 1.0, "mm_per_unit": 1e300}),
    "a mesh of another kind": lambda d: d.update(body={"mesh": "a.csv", "voxel_mm": 1.0}),
    "many names": lambda d: d["regions"].update(
        {f"r{n}": {"plane": {"axis": "z", "at_mm": 0}} for n in range(5000)}
    ),
}


@dataclass(frozen=True)
class BadFile:
    """One bad input.

    Parameters
    ----------
    kind : str
        The reader.
    name : str
    prepare : callable
        Writes the file into a folder and returns the arguments of the command.
    """

    kind: str
    name: str
    prepare: Callable[[Path], list[str]]


def bad_files(seed: int) -> Iterator[BadFile]:
    """Yield all bad inputs."""
    random = np.random.default_rng(seed)
    for one in SEEDS:
        for number in range(MUTATIONS):
            drawn = int(random.integers(0, 2**32))
            yield BadFile(one.reader, f"{one.name}, damage {number + 1}", _mutated(one, drawn))
        for what, spoil in SPOILED.items():
            yield BadFile(one.reader, f"{one.name}, {what}", _spoiled(one, spoil))
    for name, change in EXPERIMENT_CHANGES.items():
        yield BadFile("YAML", name, _experiment(change))


def _mutated(one: Seed, drawn: int) -> Callable[[Path], list[str]]:
    def prepare(folder: Path) -> list[str]:
        path = _whole(one, folder)
        path.write_bytes(damaged(path.read_bytes(), np.random.default_rng(drawn)))
        return command(one, path)

    return prepare


def _spoiled(one: Seed, spoil: Callable[[Path], object]) -> Callable[[Path], list[str]]:
    def prepare(folder: Path) -> list[str]:
        path = _whole(one, folder)
        content = path.read_bytes()
        path.unlink()
        spoil(path)
        if path.is_file() and not path.is_symlink() and path.stat().st_size == 1:
            path.write_bytes(content * 2)
        return command(one, path)

    return prepare


def _loop(path: Path) -> None:
    path.symlink_to(path)


SPOILED: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "a pipe": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "links in a circle": _loop,
    "a folder": lambda path: path.mkdir(),
    "zeros": lambda path: path.write_bytes(bytes(2**20)),
    "a gigabyte that is not there": lambda path: path.touch() or os.truncate(path, 2**31),
    "its content twice": lambda path: path.write_bytes(b"2"),
}


def _whole(one: Seed, folder: Path) -> Path:
    path = folder / one.name
    one.make(path)
    return path


def _experiment(change: Callable[[dict], object]) -> Callable[[Path], list[str]]:
    def prepare(folder: Path) -> list[str]:
        data = described()
        change(data)
        path = write(folder, data)
        stl = np.zeros(12, np.dtype("<f4"))
        (folder / "a.stl").write_bytes(bytes(80) + struct.pack("<I", 1) + stl.tobytes() + bytes(2))
        return ["diagnose", str(path), "--scheduler", "tcp://127.0.0.1:1"]

    return prepare


def command(one: Seed, path: Path) -> list[str]:
    """Return the command that reads a file."""
    if one.reader in ("NRRD", "NIfTI", "TIFF", "NumPy", "DICOM"):
        given = path.parent if path.name == "slice.dcm" else path
        spacing = ["--spacing-mm", "1", "1", "1"] if path.suffix in (".npy", ".tif") else []
        names = [] if path.suffix == ".nrrd" else ["--labels", LABELS]
        return ["import", str(given), "--name", "x", *spacing, *names]
    if one.reader == "labels":
        image = path.with_name("image.npy")
        np.save(image, labels())
        given = ["--spacing-mm", "1", "1", "1", "--labels", str(path)]
        return ["import", str(image), "--name", "x", *given]
    if one.reader == "archive":
        return ["store", "import", str(path)]
    where = ["--scheduler", "tcp://127.0.0.1:1"]
    if one.reader == "mesh":
        body = {"mesh": path.name, "voxel_mm": 3.0}
        write(path.parent, described(body=body))
        return ["diagnose", str(path.with_name("experiment.yaml")), *where]
    if one.reader == "picture":
        study = path.with_name("eye.yaml")
        study.write_text(CORNEA.format(name=path.name))
        return ["run", str(study), *where]
    if one.name == "law.csv":
        return ["fit-law", str(path)]
    if one.name == "study.yaml":
        return ["run", str(path), *where]
    return ["diagnose", str(path.with_name("experiment.yaml")), *where]


def outcome(bad: BadFile, folder: Path) -> Outcome:
    """Run the command for one bad input in a child process."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "work").mkdir(parents=True)
    with_secret(folder / "work")
    arguments = bad.prepare(folder / "work")
    said = folder / "said.txt"
    found = outcome_of(lambda: _run(arguments, folder / "work", said))
    text = said.read_text(errors="replace") if said.exists() else ""
    if found.kind != "read":
        return found
    code, _, _ = found.text.removeprefix("Ended of shape ").partition(" ")
    return Outcome(_kind(code, text), text or found.text, found.mib, found.seconds)


class Ended:
    """The exit code of a command, in the form expected by `outcome_of`."""

    class values:  # noqa: N801
        shape = 0

    def __init__(self, code: int) -> None:
        self.values.shape = code


def _kind(code: str, text: str) -> str:
    if "Traceback" in text or SECRET in text:
        return "traceback" if "Traceback" in text else "foreign bytes"
    if code == "0" or ACCEPTED in text:
        return "read"
    errors = re.findall(r"^Error: ", text, re.MULTILINE)
    return "refused" if code == "2" and len(errors) == 1 else f"exit code {code}"


def _run(arguments: list[str], folder: Path, said: Path) -> Ended:
    def nobody(address: str, connect_s: float) -> None:
        raise ClusterError(ACCEPTED)

    cluster_module.check_reachable = nobody
    os.chdir(folder)
    handle = os.open(said, os.O_WRONLY | os.O_CREAT)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    try:
        return Ended(cli.main([*arguments]))
    except PalpateError as error:
        raise AssertionError(f"the command line has let through: {error}") from error


def run(seed: int, folder: Path, log: Callable[[str], object]) -> list[tuple[BadFile, Outcome]]:
    """Try all bad inputs and return the outcomes."""
    results = []
    for bad in bad_files(seed):
        found = outcome(bad, folder)
        results.append((bad, found))
        if found.is_bad:
            log(f"{bad.kind}: {bad.name}: {found.kind}, {found.mib:.0f} MiB\n{found.text[-1500:]}")
    return results
