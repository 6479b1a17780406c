"""Runs the command `palpate`."""

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    try:
        from palpate.service.cli import main as run

        return run(arguments)
    except KeyboardInterrupt:  # while modules are still being loaded
        sys.stderr.write("Interrupted.\n")
        return 130


if __name__ == "__main__":
    sys.exit(main())
