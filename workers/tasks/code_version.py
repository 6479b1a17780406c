"""The digest of the source code that a result depends on, derived from its imports.

A result that is stored under the digest of its inputs alone becomes stale when the code
changes. The code's part of that digest is found by following the import statements from
the module that makes the result: what it reaches counts, what it does not reach does not.
"""

import ast
import threading
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from palpate.storage.digest import digest, file_digest
from palpate.workers.plugins import foreign_plugins

PACKAGES = ("palpate.workers", "palpate.storage")
# Python 3.11 cannot parse in several threads at once (cpython issue 106905), and studies of one
# process run in threads.
_PARSING = threading.Lock()
# Where a statement, a handler of exceptions or a case of a match has statements of its own.
_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")


@cache
def code_version(*modules: str) -> str:
    """Return a digest of the source of all that some modules import, themselves included.

    Parameters
    ----------
    *modules : str
        Dotted names, such as ``"palpate.workers.tasks.evaluation"``. Of a plug-in the whole
        top-level package counts that it imports from, and the version of its distribution.

    Returns
    -------
    str
        The same on every machine that has the same source, wherever it is installed.

    Raises
    ------
    ModuleNotFoundError
        If there is no such module.
    """
    foreign = {_top(module) for module in modules if not _below(module, PACKAGES)}
    files = reached(modules, (*PACKAGES, *foreign))
    versions = {(p.distribution, p.version) for p in foreign_plugins() if _top(p.module) in foreign}
    code = sorted((name, file_digest(file)) for name, file in files.items())
    return digest(code, sorted(versions)) if foreign else digest(code)


def reached(modules: Iterable[str], packages: Iterable[str] = PACKAGES) -> dict[str, Path]:
    """Return the modules of some packages that these modules reach by their imports.

    Imports inside functions and for type checkers count. The ``__init__`` of every package
    on the way counts, because Python runs it.

    Parameters
    ----------
    modules : iterable of str
        Where to begin.
    packages : iterable of str
        Packages that are followed; others are left out.

    Returns
    -------
    dict of str to Path
        The file of each module that is reached.
    """
    roots = tuple(packages)
    files: dict[str, Path] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name in files or not _below(name, roots):
            continue
        file = source_file(name)
        if file is None:
            raise ModuleNotFoundError(f"There is no module {name}.", name=name)
        files[name] = file
        waiting.extend(_parents(name))
        waiting.extend(_imported(file, name, roots))
    return files


def _top(module: str) -> str:
    return module.partition(".")[0]


def _below(module: str, packages: Iterable[str]) -> bool:
    return any(module == name or module.startswith(f"{name}.") for name in packages)


@cache
def source_file(module: str) -> Path | None:
    """Return the file of a module or of a package's ``__init__``; None if there is none."""
    top, *rest = module.split(".")
    spec = find_spec(top)
    if spec is None or spec.origin is None:
        return None
    if not rest and spec.submodule_search_locations is None:
        return Path(spec.origin)
    place = Path(spec.origin).parent.joinpath(*rest)
    for file in (place / "__init__.py", place.with_suffix(".py")):
        if file.is_file():
            return file
    return None


def _parents(module: str) -> Iterator[str]:
    parts = module.split(".")
    return (".".join(parts[:count]) for count in range(1, len(parts)))


@cache
def _imported(file: Path, module: str, roots: tuple[str, ...] = PACKAGES) -> tuple[str, ...]:
    """Return the modules that a file names in import statements.

    ``from package import name`` names the module ``package.name`` where there is one.
    """
    names: list[str] = []
    with _PARSING:
        tree = ast.parse(file.read_bytes())
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            names.extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = _imported_from(node, module, file)
            names.append(base)
            names.extend(_submodules(base, node, roots))
    return tuple(names)


def _imported_from(node: ast.ImportFrom, module: str, file: Path) -> str:
    """Return the absolute name of the module that a ``from`` statement imports from."""
    if not node.level:
        return node.module or ""
    package = module.split(".") if file.name == "__init__.py" else module.split(".")[:-1]
    above = package[: len(package) - node.level + 1]
    return ".".join([*above, node.module] if node.module else above)


def _statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Return all statements of a file; most of what `ast.walk` returns are expressions."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for block in _BLOCKS:
            waiting.extend(getattr(node, block, ()))


def _submodules(base: str, node: ast.ImportFrom, roots: tuple[str, ...]) -> Iterator[str]:
    if not _below(base, roots):
        return
    for alias in node.names:
        name = f"{base}.{alias.name}"
        if source_file(name) is not None:
            yield name
