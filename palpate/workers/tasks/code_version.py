"""Digests of the source code that a result depends on, derived from its imports.

A result stored under the digest of its inputs alone becomes stale when the code changes. So the
digest also covers the code: every module reached by import statements from the module that
makes the result, and no other.
"""

import dis
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import CodeType
from typing import Any

from palpate.storage.json_digests import digest, file_digest
from palpate.workers.plugins import foreign_plugins

PACKAGES = ("palpate.workers", "palpate.storage")
_IMPORT = dis.opmap["IMPORT_NAME"]


@cache
def code_version(*modules: str) -> str:
    """Return a digest of the source of some modules and of everything they import.

    Parameters
    ----------
    *modules : str
        Dotted names, such as ``"palpate.workers.tasks.study_tasks"``. For a plug-in, its whole
        top-level package counts as far as it is imported, as does the version of its distribution.

    Returns
    -------
    str
        A digest that is the same on every machine with the same source, wherever it is installed.

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
    """Return the modules of some packages that are reached from these modules by imports.

    Imports inside functions and under TYPE_CHECKING count. The ``__init__`` of every package
    on the way counts, because Python runs it.

    Parameters
    ----------
    modules : iterable of str
        Starting modules.
    packages : iterable of str
        Packages whose imports are followed; others are ignored.

    Returns
    -------
    dict of str to Path
        The file of each module reached.
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
    """Return the modules named in the import statements of a file.

    ``from package import name`` names the module ``package.name`` if there is one.
    """
    names: list[str] = []
    for level, base, members in _import_statements(file):
        origin = _absolute(level, base, module, file)
        names.append(origin)
        names.extend(_submodules(origin, members, roots))
    return tuple(names)


def _import_statements(file: Path) -> list[tuple[int, str, tuple[str, ...]]]:
    """Return the level, module and members of each import statement in a file, in order.

    They are read from the compiled code, because `ast.parse` fails while another thread is parsing
    too (cpython issue 106905), even if it parses only a string in a template.
    """
    found: dict[tuple[int, int, str], tuple[int, str, tuple[str, ...]]] = {}
    waiting = [compile(file.read_bytes(), str(file), "exec", dont_inherit=True)]
    while waiting:
        code = waiting.pop()
        waiting.extend(one for one in code.co_consts if isinstance(one, CodeType))
        if _IMPORT in code.co_code[::2]:
            found |= _imports_of(code)
    return [found[place] for place in sorted(found)]


def _imports_of(code: CodeType) -> dict[tuple[int, int, str], tuple[int, str, tuple[str, ...]]]:
    """Return the import statements of one code object, keyed by their position in the file."""
    imports: dict[tuple[int, int, str], tuple[int, str, tuple[str, ...]]] = {}
    level: Any = 0  # with `members`, the two constants loaded before the import
    members: Any = None
    for step in dis.get_instructions(code):
        if step.opname == "IMPORT_NAME":
            where = step.positions
            line, column = (where.lineno, where.col_offset) if where else (0, 0)
            imports[line or 0, column or 0, step.argval] = level, step.argval, members or ()
        elif step.opname != "EXTENDED_ARG":
            level, members = members, step.argval
    return imports


def _absolute(level: int, base: str, module: str, file: Path) -> str:
    """Return the absolute name of the module from which a statement imports."""
    if not level:
        return base
    package = module.split(".") if file.name == "__init__.py" else module.split(".")[:-1]
    above = package[: len(package) - level + 1]
    return ".".join([*above, base] if base else above)


def _submodules(base: str, members: Iterable[str], roots: tuple[str, ...]) -> Iterator[str]:
    if not _below(base, roots):
        return
    for member in members:
        name = f"{base}.{member}"
        if source_file(name) is not None:
            yield name
