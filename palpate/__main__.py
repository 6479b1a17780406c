"""Runs the command `palpate`, once its own packages are what Python finds under their names.

`service`, `workers` and `storage` are common names: another project that stands earlier on
the path, or in the current folder, would be imported in their place.
"""

import sys
from collections.abc import Sequence
from importlib.machinery import PathFinder
from pathlib import Path

PACKAGES = ("service", "workers", "storage")
HERE = Path(__file__).resolve().parent.parent


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; 2 if other packages stand in the way."""
    problems = [problem for name in PACKAGES if (problem := shadow(name))]
    if problems:
        for problem in problems:
            sys.stderr.write(f"problem: {problem}\n")
        sys.stderr.write("not ready\n")
        return 2
    try:
        from service.cli import main as run

        return run(arguments)
    except KeyboardInterrupt:  # while packages are still being loaded
        sys.stderr.write("Interrupted.\n")
        return 130


def shadow(name: str) -> str | None:
    """Say which other package Python finds under the name of one of ours; None if ours."""
    spec = PathFinder.find_spec(name)
    expected = HERE / name
    if spec is None or spec.submodule_search_locations is None:
        found = "nothing" if spec is None else str(spec.origin)
        folders = []
    else:
        folders = [Path(folder).resolve() for folder in spec.submodule_search_locations]
        found = ", ".join(map(str, folders))
    if folders and folders[0] == expected:
        return None
    return (
        f"the package `{name}` of palpate ({expected}) is shadowed: Python finds {found} before "
        "it. Take that folder off PYTHONPATH, leave it (PYTHONSAFEPATH=1 keeps the current folder "
        "off the path), or install palpate into an environment of its own."
    )


if __name__ == "__main__":
    sys.exit(main())
