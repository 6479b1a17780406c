"""The code's share of a digest: the modules that an evaluation imports, and nothing else."""

import ast
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from palpate.workers.organs.organ_plugins import organ_modules
from palpate.workers.tasks.code_version import _imported, code_version, reached

ROOT = Path(__file__).parents[3]
EVALUATION = ("palpate.workers.tasks.study_tasks", *organ_modules("breast"))
# Read once: the digest of a result must not depend on who computes it.
REACHED = reached(EVALUATION)
# Modules that earlier hand-written lists omitted although evaluations depend on them.
FORGOTTEN = (
    "palpate.workers.mechanics.model_parameters",
    "palpate.workers.mechanics.effects.support_effects",
    "palpate.workers.mechanics.materials.elastic_law",
    "palpate.workers.tasks.pipeline",
)


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the packages, so that files can be changed."""
    root = tmp_path_factory.mktemp("copied")
    skipped = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "palpate", root / "palpate", ignore=skipped)
    return root


def versions_in(root: Path, files: list[Path]) -> list[str]:
    """Return the current version, then the version after changing each file alone."""
    script = f"""
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from palpate.workers.tasks import code_version as module
import palpate.storage.json_digests
def version():
    module.code_version.cache_clear()
    return module.code_version(*{EVALUATION!r})
print(version())
for name in sys.argv[1:]:
    file = Path(name)
    text = file.read_bytes()
    file.write_bytes(text + b"# touched")
    print(version())
    file.write_bytes(text)
"""
    ran = subprocess.run(
        [sys.executable, "-c", script, *map(str, files)],
        cwd=root,
        env={"PYTHONPATH": str(root), "PATH": ""},
        capture_output=True,
        text=True,
        check=True,
    )
    return ran.stdout.split()


def test_every_imported_file_counts(copied: Path) -> None:
    files = [copied / file.relative_to(ROOT) for file in REACHED.values()]
    before, *after = versions_in(copied, files)
    assert len(after) == len(files) > 100
    unnoticed = [name for name, now in zip(REACHED, after, strict=True) if now == before]
    assert unnoticed == []


def test_files_that_are_not_imported_do_not_count(copied: Path) -> None:
    apart = [
        "palpate/workers/diagnosis/outcome/body_pictures.py",
        "palpate/workers/diagnosis/verdict/cause_selection.py",
        "palpate/workers/blind/random_case.py",
        "palpate/workers/organs/specimen/specimen_problem.py",
        "palpate/workers/tasks/diagnosis_tasks.py",
        "palpate/storage/journal.py",
    ]
    before, *after = versions_in(copied, [copied / name for name in apart])
    assert after == [before] * len(apart)


@pytest.mark.parametrize("module", FORGOTTEN)
def test_formerly_omitted_modules_count(module: str) -> None:
    assert module in REACHED


def test_every_module_loaded_by_python_is_reached() -> None:
    """Running the code must load no module beyond those found in its import statements."""
    script = (
        f"import sys, {', '.join(EVALUATION)}\n"
        "print(*(n for n in sys.modules if n.startswith(('palpate.workers', 'palpate.storage'))))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert set(ran.stdout.split()) <= set(REACHED)


def test_imports_count_at_any_position(tmp_path: Path) -> None:
    blocks = (
        "import json as a",
        "if x:\n    import json as b\nelif y:\n    import json as c\nelse:\n    import json as d",
        "try:\n    import json as e\nexcept E:\n    import json as f\nelse:\n    import json as g\n"
        "finally:\n    import json as h",
        "for x in y:\n    while x:\n        with x:\n            import json as i",
        "class C:\n    async def m(self):\n        def n():\n            import json as j",
        "match x:\n    case 1:\n        import json as k",
    )
    file = tmp_path / "every_block.py"
    file.write_text("\n".join(blocks))
    assert _imported(file, "every_block") == ("json",) * 11


def test_missing_module_is_named() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"workers\.nowhere"):
        code_version("palpate.workers.nowhere")


def test_version_is_the_same_from_concurrent_threads() -> None:
    """Python 3.11 cannot parse in several threads at once, so `code_version` must not parse."""
    ended = threading.Event()

    def found(_: int) -> str:
        code_version.cache_clear()
        _imported.cache_clear()
        return code_version(*EVALUATION)

    def parsing() -> None:
        while not ended.is_set():
            ast.literal_eval("('text', 1.0, [2, 3])")

    with ThreadPoolExecutor(5) as pool:
        other = pool.submit(parsing)
        try:
            assert len(set(pool.map(found, range(4)))) == 1
        finally:
            ended.set()
        other.result()
