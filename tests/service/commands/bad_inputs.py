"""Bad inputs from users: files, options, environments, terminals, permissions.

Each is one command line in a folder of its own, the files placed there beforehand, and the expected
message.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

STUDY = """
name: demo
case:
  reference: {phantom: {preset: 445ml}}
  mesh: {nodes: 2000}
  load: {force_n: 60}
target: {constants: {E_fat_kpa: 10}}
search:
  parameters: {E_fat_kpa: [5, 20], eta_fat_kpa: [50, 200]}
  population: 12
"""
IMAGES = STUDY.replace("phantom: {preset: 445ml}", "volume: rest.npy, spacing_mm: 2, LABELS")
IMAGES = IMAGES.replace(
    "{constants: {E_fat_kpa: 10}}", "{volume: pressed.npy, spacing_mm: 2, LABELS}"
)
IMAGES = IMAGES.replace("LABELS", "labels: {0: air, 1: fat, 2: glandular}")
# Each list repeats the previous one nine times: four billion words when expanded.
BOMBED = "after its aliases (*) are expanded"
BOMB = "[&a0 [x], " + ", ".join(f"&a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 11))
BOMB += "]"

Prepare = Callable[[Path], object]


@dataclass(frozen=True)
class BadInput:
    """One bad input.

    Parameters
    ----------
    command : str
        ``palpate`` is the installed command.
    said : str
        Expected part of the message.
    prepare : callable
        Creates files in the given folder, which contains study.yaml.
    code : int
        Exit code.
    environment : mapping
        Additional environment variables.
    plain_user : bool
        Run without root's permission to write anywhere.
    folder : str
        Working folder, inside the folder of the case.
    in_shell : bool
        Run the command in a shell.
    """

    command: str
    said: str
    prepare: Prepare = lambda place: None
    code: int = 2
    environment: Mapping[str, str] = field(default_factory=dict)
    plain_user: bool = False
    folder: str = "."
    in_shell: bool = False


def text(content: str, name: str = "study.yaml") -> Prepare:
    """Write a file."""
    return lambda place: (place / name).write_text(content)


def data(content: bytes, name: str = "study.yaml") -> Prepare:
    """Write a file of bytes."""
    return lambda place: (place / name).write_bytes(content)


def with_change(old: str, new: str, study: str = STUDY) -> Prepare:
    """Write a study file with an error."""
    assert old in study
    return text(study.replace(old, new, 1))


def images(
    change: Callable[[np.ndarray], np.ndarray] = lambda values: values, study: str = IMAGES
) -> Prepare:
    """Write two images of a block, the second one squeezed and changed, and their study."""

    def prepare(place: Path) -> None:
        (place / "study.yaml").write_text(study)
        rest = np.zeros((30, 44, 40), np.uint8)
        rest[:28, 2:42, 2:38] = 1
        rest[8:20, 12:24, 8:20] = 2
        pressed = np.zeros((34, 44, 44), np.uint8)
        pressed[:31, 7:37, 1:43] = 1
        pressed[9:22, 14:23, 8:22] = 2
        np.save(place / "rest.npy", rest)
        np.save(place / "pressed.npy", change(pressed))

    return prepare


def all_of(*steps: Prepare) -> Prepare:
    """Return a function that applies several others in turn."""

    def prepare(place: Path) -> None:
        for step in steps:
            step(place)

    return prepare


def locked(name: str, mode: int) -> Prepare:
    """Remove permissions from a file or a folder, creating it if missing."""

    def prepare(place: Path) -> None:
        path = place / name
        if not path.exists():
            path.mkdir(parents=True)
        path.chmod(mode)

    return prepare


def exchanged(place: Path) -> None:
    """Swap reference and target."""
    os.rename(place / "rest.npy", place / "other.npy")  # noqa: PTH104
    os.rename(place / "pressed.npy", place / "rest.npy")  # noqa: PTH104
    os.rename(place / "other.npy", place / "pressed.npy")  # noqa: PTH104


def journal(content: str) -> Prepare:
    """Write a journal of the study demo."""

    def prepare(place: Path) -> None:
        folder = place / "runs" / "demo"
        folder.mkdir(parents=True)
        (folder / "journal.jsonl").write_text(content)

    return prepare


RUN = "palpate run study.yaml"

FILES = {
    "no file": BadInput("palpate run nothing.yaml", "palpate new breast nothing"),
    "a name with a blank": BadInput("palpate run 'my study.yaml'", "palpate new breast 'my study'"),
    "an empty file": BadInput(RUN, "found nothing", text("")),
    "bytes": BadInput(RUN, "cannot be read as text", data(b"\x00\xff\xfe")),
    "utf-16": BadInput(RUN, "cannot be read as text", data(STUDY.encode("utf-16"))),
    "a folder that is not a study": BadInput("palpate run empty", "empty", locked("empty", 0o755)),
    "a device": BadInput("palpate run /dev/null", "is a pipe or a device"),
    "no YAML": BadInput(RUN, "not valid YAML", text("name: [demo")),
    "a tabulator": BadInput(RUN, "not valid YAML", text("name: demo\n\tcase: 1\n")),
    "a list": BadInput(RUN, "found list", text("- a\n- b\n")),
    "a key twice": BadInput(RUN, "is repeated", text(STUDY + "name: again\n")),
    "brackets without end": BadInput(RUN, "nested too deeply", text("name: " + "[" * 20_000)),
    "a YAML bomb": BadInput(RUN, BOMBED, text(f"a: {BOMB}\n{STUDY}")),
    "a YAML bomb as a number": BadInput(
        RUN, BOMBED, with_change("population: 12", f"population: {BOMB}")
    ),
    "a YAML bomb as an interval": BadInput(RUN, BOMBED, with_change("[5, 20]", BOMB)),
    "an unknown key": BadInput(RUN, "did you mean 'search'", with_change("search:", "serach:")),
    "an unknown key within": BadInput(RUN, "did you mean 'nodes'", with_change("nodes", "node")),
    "an unknown organ": BadInput(RUN, "organ", with_change("case:\n", "case:\n  organ: liver\n")),
    "an evil name": BadInput(RUN, "name", with_change("demo", "../evil")),
    "reversed bounds": BadInput(RUN, "Write [5, 20]", with_change("[5, 20]", "[20, 5]")),
    "not a number": BadInput(RUN, "E_fat_kpa", with_change("[5, 20]", "[.nan, 20]")),
    "infinity": BadInput(RUN, "E_fat_kpa", with_change("[5, 20]", "[5, .inf]")),
    "text for a number": BadInput(RUN, "search.population", with_change("12", "many")),
    "only elites": BadInput(
        RUN, "at least one candidate must be new", with_change("12", "12\n  elite: 12")
    ),
    "a force below zero": BadInput(RUN, "force_n", with_change("force_n: 60", "force_n: -60")),
    "force and distance": BadInput(
        RUN, "exactly one", with_change("60}", "60, plate_distance_mm: {final: 60}}")
    ),
    "an unknown phantom": BadInput(RUN, "445ml", with_change("445ml", "huge")),
    "a spacing of zero": BadInput(RUN, "spacing_mm", with_change("445ml", "445ml, spacing_mm: 0")),
    "searched and held": BadInput(
        RUN, "searched", with_change("  load", "  constants: {E_fat_kpa: 9}\n  load")
    ),
    "skin of none": BadInput(RUN, "model.skin is none", with_change("eta_fat", "E_skin")),
    "pascal for kilopascal": BadInput(
        RUN, "known interval of 5 to 20 kPa", with_change("[5, 20]", "[5000, 20000]")
    ),
    "100 million candidates": BadInput(RUN, "evaluations at most", with_change("12", "100000000")),
    "too few nodes": BadInput(RUN, "Ask for 850 nodes", with_change("2000", "400")),
    "an absent tissue": BadInput(
        RUN, "muscle is to be compared", text(STUDY + "score: {labels: [muscle]}\n")
    ),
    "no image": BadInput(RUN, "rest.npy", text(IMAGES)),
    "an image of text": BadInput(RUN, "rest.npy", all_of(images(), text("hello", "rest.npy"))),
    "half an image": BadInput(
        RUN, "rest.npy", all_of(images(), lambda p: os.truncate(p / "rest.npy", 3000))
    ),
    "a flat image": BadInput(RUN, "pressed.npy", images(lambda v: v[0])),
    "an image of fractions": BadInput(RUN, "whole numbers", images(lambda v: v + 0.5)),
    "pickled objects": BadInput(
        RUN, "pressed.npy", images(lambda v: np.array([{}, []], dtype=object))
    ),
    "a label without a name": BadInput(RUN, "7", images(lambda v: np.where(v == 2, 7, v))),
    "an image of air": BadInput(RUN, "labels", images(lambda v: 0 * v)),
    "exchanged images": BadInput(RUN, "look swapped", all_of(images(), exchanged)),
    "voxels of two metres": BadInput(
        RUN,
        "2000 x 2000 x 2000 mm",
        images(study=IMAGES.replace("spacing_mm: 2,", "spacing_mm: 2000,")),
    ),
    "an unknown kind of image": BadInput(
        RUN, "rest.xyz", all_of(with_change("rest.npy", "rest.xyz", IMAGES), text("x", "rest.xyz"))
    ),
    "a damaged journal": BadInput("palpate status demo", "line 1", journal("not json\n{}\n")),
    "a study file to diagnose": BadInput("palpate diagnose study.yaml", "is a study file"),
    "no case to diagnose": BadInput("palpate diagnose nothing", "cannot be diagnosed"),
    "no blind set": BadInput("palpate blind run nothing", "nothing"),
    "no study": BadInput("palpate status", "There is no study in"),
}

OPTIONS = {
    "no worker": BadInput(f"{RUN} --workers 0", "--workers must be at least 1"),
    "workers in words": BadInput(f"{RUN} --workers two", "--workers two: expected a number"),
    "a range without workers": BadInput(f"{RUN} --workers 0-4", "one worker is always kept"),
    "a scheduler that is not an address": BadInput(
        f"{RUN} --scheduler foo", "tcp://127.0.0.1:8786"
    ),
    "a scheduler with a web address": BadInput(
        f"{RUN} --scheduler http://127.0.0.1:8787", "invalid address"
    ),
    "a scheduler that nobody knows": BadInput(
        f"{RUN} --scheduler tcp://no.such.host.invalid:8786", "is unknown"
    ),
    "a scheduler that does not listen": BadInput(
        f"{RUN} --scheduler tcp://127.0.0.1:9", "There is no scheduler at tcp://127.0.0.1:9"
    ),
    "scheduler and workers": BadInput(
        f"{RUN} --scheduler tcp://127.0.0.1:9 --workers 2", "give one of them"
    ),
    "an unknown option": BadInput(f"{RUN} --wrokers 2", "--wrokers"),
    "an unknown command": BadInput("palpate runn study.yaml", "runn"),
    "nothing to run": BadInput("palpate run", "Missing argument"),
    "a store on the web": BadInput(f"{RUN} --store https://host/store", "is a URL"),
    "a store without a bucket": BadInput(f"{RUN} --store s3://", "names no bucket"),
    "a candidate by name": BadInput("palpate show first", "give its number, or best"),
    "an unknown study": BadInput("palpate report nix", "There is no study nix"),
    "a constant without a value": BadInput(
        "palpate simulate study.yaml --set E_fat_kpa", "expected NAME=VALUE"
    ),
    "an unknown constant": BadInput(
        "palpate simulate study.yaml --set E_fatt_kpa=3", "did you mean 'E_fat_kpa'"
    ),
    "a constant that is not a number": BadInput(
        "palpate simulate study.yaml --set E_fat_kpa=nan", "E_fat_kpa must be above 0 kPa"
    ),
    "a mesh of 400 nodes": BadInput("palpate mesh study.yaml --nodes 400", "Ask for 850 nodes"),
    "a mesh in an unknown form": BadInput("palpate mesh study.yaml --out mesh.txt", ".vtu"),
    "a mesh for no folder": BadInput("palpate mesh study.yaml --out no/mesh.vtu", "create it"),
    "an unknown preset": BadInput("palpate phantom --preset huge", "huge"),
    "labels in another form": BadInput(
        "palpate import rest.npy --name n --labels 0:air", "expected e.g. 0=air"
    ),
    "an evil name of an image": BadInput(
        "palpate import rest.npy --name ../evil --spacing-mm 2 2 2", "The name", images()
    ),
    "two spacings for three": BadInput(
        "palpate import rest.npy --name n --spacing-mm 1 1", "--spacing-mm"
    ),
    "an organ that is none": BadInput("palpate parameters --organ liver", "unknown organ 'liver'"),
    "a kind that is none": BadInput("palpate new planet mine", "planet"),
    "a name with a slash": BadInput("palpate new breast a/b", "name"),
    "a file that is there": BadInput("palpate new breast study", "already exists"),
    "sizes in words": BadInput("palpate bench --nodes many", "expected positive numbers"),
    "a diagnosis on ten nodes": BadInput("palpate diagnose study.yaml --nodes 10", "--nodes"),
    "workers in the environment": BadInput(
        RUN, "PALPATE_WORKERS=many", environment={"PALPATE_WORKERS": "many"}
    ),
    "a scheduler in the environment": BadInput(
        RUN, "'foo': invalid address", environment={"PALPATE_SCHEDULER": "foo"}
    ),
    "a store in the environment": BadInput(
        RUN, "/dev/null/store", environment={"PALPATE_STORE": "/dev/null/store"}
    ),
}

PLACES = {
    "a full disk for the output": BadInput(
        "palpate parameters > /dev/full", "the disk is full", in_shell=True
    ),
    "a full disk for JSON": BadInput(
        "palpate parameters --json > /dev/full", "the disk is full", in_shell=True
    ),
    "a full disk for the help": BadInput(
        "palpate run --help > /dev/full", "the disk is full", in_shell=True
    ),
    "nobody who reads": BadInput(
        "palpate parameters | true; exit ${PIPESTATUS[0]}", "", code=141, in_shell=True
    ),
    "new where nothing may be written": BadInput(
        "palpate new breast mine",
        "may not write there",
        locked("locked", 0o555),
        plain_user=True,
        folder="locked",
    ),
    "a run where nothing may be written": BadInput(
        "palpate run ../study.yaml",
        "locked/runs",
        locked("locked", 0o555),
        plain_user=True,
        folder="locked",
    ),
    "a study file that may not be read": BadInput(
        RUN, "not readable", locked("study.yaml", 0o000), plain_user=True
    ),
    "a store that may not be written": BadInput(
        f"{RUN} --store locked", "locked", locked("locked", 0o555), plain_user=True
    ),
    "a phantom where nothing may be written": BadInput(
        "palpate phantom --spacing-mm 2 --out locked/p.nrrd --store s",
        "Cannot write locked/p.nrrd",
        locked("locked", 0o555),
        plain_user=True,
    ),
    "a study's folder that is a file": BadInput(
        f"{RUN} --study taken", "is a file; expected a study folder", text("x", "taken")
    ),
    "a store that is a file": BadInput(f"{RUN} --store taken", "is a file", text("x", "taken")),
    "a name too long for the disk": BadInput(f"palpate run {'n' * 300}.yaml", "n.yaml"),
    "links in a circle": BadInput(
        "palpate run circle.yaml",
        "circle.yaml",
        lambda p: (p / "circle.yaml").symlink_to("circle.yaml"),
    ),
}

BAD_INPUTS = FILES | OPTIONS | PLACES
