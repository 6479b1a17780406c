"""Names of effects occur only in their family and in the catalogues of organs."""

import ast
import re
from importlib import import_module
from pathlib import Path

from palpate import workers
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.organs.organ_plugins import catalogue_of, organ_names

ROOT = Path(str(workers.__file__)).resolve().parents[1]
FAMILIES = "palpate.workers.mechanics.effects"
# Names with another meaning elsewhere: a constant of a study, causes of the other solver, and
# tangents timed by a benchmark.
OTHERWISE = {"service/bench/stage_timing.py", "service/number_formatting.py"}
OF_ORGANS = re.compile(r"workers/organs/(\w+)/\1_(keys|problem)\.py")


def modules():
    for folder in ("service", "workers", "storage"):
        for file in sorted((ROOT / folder).rglob("*.py")):
            path = file.relative_to(ROOT).as_posix()
            own = path.startswith(("workers/mechanics/effects/", "workers/blind/"))
            if not own and not (
                path.startswith("workers/organs/") and file.name.endswith("_effects.py")
            ):
                yield path, ast.parse(file.read_text())


def test_no_module_imports_a_single_effect():
    found = [
        (path, alias.name)
        for path, tree in modules()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith(FAMILIES)
        for alias in node.names
        if isinstance(getattr(import_module(str(node.module)), alias.name), Effect)
    ]
    assert found == []


def test_no_module_compares_with_the_name_of_an_effect():
    names = {e.name for organ in organ_names() for e in catalogue_of(organ).effects}
    found = [
        (path, node.value)
        for path, tree in modules()
        if path not in OTHERWISE and not OF_ORGANS.fullmatch(path)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and node.value in names
    ]
    assert found == []
