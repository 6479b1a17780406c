"""Figures about the structure of `palpate`: ``make counts``.

CONTRIBUTING.md says what they should be. With ``--walk`` they are those of the code that one
evaluation of a study runs through, from the task on.
"""

import ast
import io
import sys
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).parents[1]
SMALL = 30
SILENT = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """One file.

    Parameters
    ----------
    path : Path
        Below the repository.
    code : int
        Lines without comments, docstrings and blanks.
    imports : int
        How many of them are import statements.
    needs : set of str
        Modules that it imports anywhere, also inside functions.
    """

    path: Path
    code: int
    imports: int
    needs: set[str]

    @property
    def name(self) -> str:
        """The dotted name."""
        return ".".join(self.path.with_suffix("").parts).removesuffix(".__init__")


def lines_of(nodes: Iterator[ast.AST]) -> set[int]:
    """Return the numbers of all lines of some statements."""
    return {line for n in nodes for line in range(n.lineno, n.end_lineno + 1)}  # type: ignore[attr-defined]


def docstrings(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield the docstrings of a module."""
    for node in ast.walk(tree):
        if isinstance(node, Documented) and ast.get_docstring(node, clean=False) is not None:
            yield node.body[0]


def read(path: Path, known: set[str]) -> Module:
    """Measure one file; `known` are the names of all modules."""
    text = path.read_text()
    tree = ast.parse(text)
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    spans = [range(t.start[0], t.end[0] + 1) for t in tokens if t.type not in SILENT and t.string]
    code = {line for span in spans for line in span} - lines_of(docstrings(tree))
    statements = [n for n in ast.walk(tree) if isinstance(n, ast.Import | ast.ImportFrom)]
    named = {a.name for n in statements if isinstance(n, ast.Import) for a in n.names}
    for statement in (n for n in statements if isinstance(n, ast.ImportFrom)):
        members = {f"{statement.module}.{alias.name}" for alias in statement.names}
        named |= members & known or {str(statement.module)}
    imports = code & lines_of(iter(statements))
    return Module(path.relative_to(ROOT), len(code), len(imports), named & known)


def circles(modules: list[Module]) -> list[list[str]]:
    """Return the groups of modules that import each other, directly or not."""
    reached = {m.name: set(m.needs) - {m.name} for m in modules}
    for via in reached:
        for name, far in reached.items():
            if via in far:
                reached[name] = far | reached[via]
    groups = {
        tuple(sorted(other for other in far if name in reached[other]))
        for name, far in reached.items()
        if name in far
    }
    return [list(group) for group in sorted(groups)]


def measured(package: Path = ROOT / "palpate") -> list[Module]:
    """Measure every file of the package."""
    paths = sorted(package.rglob("*.py"))
    dotted = {".".join(p.relative_to(ROOT).with_suffix("").parts) for p in paths}
    known = {name.removesuffix(".__init__") for name in dotted}
    return [read(path, known) for path in paths]


Call = tuple[str, str, str]
"""The file of a caller, the file that it calls, below the package, and the called function."""

CASE = {"reference": {"phantom": {"spacing_mm": 2.0}}, "mesh": {"nodes": 850}}
TARGET = {"constants": {"E_fat_kpa": 8.0}}
# These files of the storage neither read nor write.
IN_MEMORY = {f"storage/{name}.py" for name in ("json_digests", "values", "errors", "read_only")}


def walk() -> list[Call]:
    """Return the calls from file to file in one evaluation of a study, in order.

    It is the second one in this process, so nothing is imported; what it needs from the store is
    read again. A call through another package, such as a validator, counts as a call by the last
    file of Palpate before it.
    """
    from palpate.workers.resources import CACHE
    from palpate.workers.tasks.study_tasks import evaluate, make_target, prepare_case

    package = f"{ROOT / 'palpate'}/"
    calls: list[Call] = []

    def file_of(frame: FrameType | None) -> str:
        while frame is not None and not frame.f_code.co_filename.startswith(package):
            frame = frame.f_back
        return "" if frame is None else frame.f_code.co_filename.removeprefix(package)

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(package):
            by, to = file_of(frame.f_back), file_of(frame)
            if by and by != to:
                calls.append((by, to, frame.f_code.co_name))

    with tempfile.TemporaryDirectory() as store:
        prepared = prepare_case(CASE, store)
        target = make_target(CASE, TARGET, store)["target"]
        request: Any = {"store": store, "case": CASE, "prepared": prepared, "target": target}
        evaluate(request | {"constants": {"E_fat": 0.010}})
        CACHE.clear()
        sys.setprofile(note)
        evaluate(request | {"constants": {"E_fat": 0.012}})
        sys.setprofile(None)
    return calls


def crossings(calls: list[Call]) -> int:
    """Return how many times tasks turn to the store, with other work in between.

    To make a body or a mesh of the arrays that were read is part of reading.
    """
    tasks = ("workers/tasks/", "workers/resources.py")
    stored = [
        to.startswith("storage/")
        for by, to, name in calls
        if by.startswith(tasks) and not (to.startswith(tasks) or to in IN_MEMORY)
        if not name.endswith("_from_arrays")
    ]
    return sum(is_stored for is_stored, _ in groupby(stored))


def print_walk() -> None:
    """Print the figures of one evaluation."""
    calls = walk()
    pairs = {(by, to) for by, to, _ in calls}
    mutual = {frozenset(pair) for pair in pairs if pair[::-1] in pairs}
    print(f"files entered                  {len({file for pair in pairs for file in pair})}")
    print(f"pairs that call each other     {len(mutual)} of {len({frozenset(p) for p in pairs})}")
    print(f"turns of tasks to the store    {crossings(calls)}")


def main() -> None:
    """Print the figures."""
    modules = measured()
    code = sum(m.code for m in modules)
    imports = sum(m.imports for m in modules)
    small = sum(m.code < SMALL for m in modules)
    stems = Counter(m.path.stem for m in modules if m.path.stem != "__init__")
    shared = {stem: count for stem, count in stems.items() if count > 3}
    folder, files = Counter(str(m.path.parent) for m in modules).most_common(1)[0]
    deepest = max(len(m.path.parent.parts) for m in modules)
    print(f"files                          {len(modules)}")
    print(f"lines of code                  {code} ({code / len(modules):.0f} a file)")
    print(f"lines that import              {imports} ({100 * imports / code:.1f} %)")
    print(f"files below {SMALL} lines           {small}")
    print(f"files whose name four share    {sum(shared.values())} {shared or ''}")
    print(f"fullest folder                 {files} files: {folder}")
    print(f"folders above the deepest file {deepest}")
    print(f"circles of imports             {circles(modules) or 'none'}")


if __name__ == "__main__":
    print_walk() if "--walk" in sys.argv else main()
