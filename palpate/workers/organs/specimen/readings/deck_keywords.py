"""Keywords of input decks that the mesh reader ignores although they move the body."""

from pathlib import Path

from palpate.storage.errors import InputError
from palpate.workers.input_files import MIB, read_bytes

DECK_BYTES = 512 * MIB
ABAQUS, NASTRAN = (".inp",), (".bdf", ".nas", ".fem")
GENERATORS = {"NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM", "INCLUDE"}
# Each of these may occur only once: the reader keeps the last.
ONCE = ("PART", "INSTANCE", "NODE")


def check_deck(path: Path) -> None:
    """Reject an input deck that would be read incompletely.

    Raises
    ------
    InputError
        With the first unsupported keyword and its line.
    """
    suffix = path.suffix.lower()
    if suffix not in ABAQUS + NASTRAN:
        return
    try:
        content = read_bytes(path, DECK_BYTES)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    lines = content.decode("utf-8", errors="replace").splitlines()
    found = _abaqus(lines) if suffix in ABAQUS else _nastran(lines)
    if found is not None:
        line, why = found
        raise InputError(
            f"{path}, line {line}: {why} is not read. Export the mesh as one part, in global "
            "coordinates and without transformations, for instance as .vtk or .msh."
        )


def _abaqus(lines: list[str]) -> tuple[int, str] | None:
    seen: dict[str, int] = {}
    keyword = ""
    for number, text in enumerate(lines, start=1):
        line = text.strip()
        if not line or line.startswith("**"):
            continue
        if not line.startswith("*"):
            if keyword == "INSTANCE":
                return number, "a translation or rotation of an *INSTANCE"
            continue
        parts = [part.strip().upper() for part in line[1:].split(",")]
        keyword = parts[0]
        options = {part.partition("=")[0].strip() for part in parts[1:]}
        if keyword in GENERATORS:
            return number, f"*{keyword}"
        if keyword in ("NODE", "ELEMENT") and options & {"SYSTEM", "INPUT"}:
            return number, f"*{keyword} with {' and '.join(sorted(options & {'SYSTEM', 'INPUT'}))}"
        if keyword in seen and keyword in ONCE:
            return number, f"a second *{keyword}, after the one in line {seen[keyword]},"
        seen.setdefault(keyword, number)
    return None


def _nastran(lines: list[str]) -> tuple[int, str] | None:
    for number, text in enumerate(lines, start=1):
        if text.upper().startswith(("CORD", "INCLUDE")):
            return number, text.split()[0].rstrip("*,")
    return None
