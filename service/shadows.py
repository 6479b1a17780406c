"""Looks for other packages with the names of ours: `service`, `workers` and `storage` are common.

Whichever stands first on a process's path is imported, so a second one may win elsewhere: on a
worker that was started in another folder, or after another project is installed.
`palpate.__main__` refuses to start where ours has lost; here is said where it might.
"""

import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import packages_distributions
from pathlib import Path

PACKAGES = ("service", "workers", "storage")
DISTRIBUTION = "palpate"
HERE = Path(__file__).resolve().parent.parent


def other_packages(path: Iterable[str] | None = None) -> list[str]:
    """Describe the folders and modules on the path that have the name of one of our packages.

    Parameters
    ----------
    path : iterable of str, optional
        Folders that are searched; `sys.path` of this process by default.
    """
    problems = []
    for folder in dict.fromkeys(Path(entry or ".").resolve() for entry in path or sys.path):
        others = [other for name in PACKAGES if (other := _found(folder, name))]
        if len(others) == len(PACKAGES):
            continue  # ours, or another palpate: `service.doctor` compares the code of processes
        problems += [
            f"another `{other.stem}` is on the path, {other}: where it comes before ours "
            f"({HERE / other.stem}), it is imported in its place. Take {folder} off the path, or "
            "install palpate into an environment of its own"
            for other in others
        ]
    return problems


def _found(folder: Path, name: str) -> Path | None:
    """Return the package or module of this name in a folder; None if there is none."""
    if (folder / name / "__init__.py").is_file():
        return folder / name
    module = folder / f"{name}.py"
    return module if module.is_file() else None


def other_distributions() -> list[str]:
    """Describe the installed distributions that claim the name of one of our packages."""
    claimed = packages_distributions()
    return [
        f"the distribution {name} has a package `{package}`, too: its files and those of palpate "
        "overwrite each other. Install palpate into an environment of its own"
        for package in PACKAGES
        for name in _others(claimed.get(package, ()))
    ]


def _others(distributions: Sequence[str]) -> list[str]:
    return sorted({name for name in distributions if name.lower() != DISTRIBUTION})
