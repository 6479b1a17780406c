"""Bad inputs, attacks over HTTP and kills; prints a table and exits with 1 after a failure.

::

    python -m tests.robustness.run --seed 1 [--only files|http|kills]
"""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.robustness import bad_files, http_attacks, kills


def main() -> int:
    """Run all parts, or one of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=("files", "http", "kills"))
    parser.add_argument("--kills", type=int, default=30)
    given = parser.parse_args()
    failures = 0
    with tempfile.TemporaryDirectory(prefix="palpate-robustness-") as scratch:
        if given.only in (None, "files"):
            failures += _files(given.seed, Path(scratch) / "files")
        if given.only in (None, "http"):
            failures += _rows("attack over HTTP", http_attacks.run(Path(scratch) / "http", _log))
        if given.only in (None, "kills"):
            found = kills.run(given.seed, given.kills, Path(scratch) / "kills", _log)
            failures += _rows("kill", found)
    print(f"{failures} failures" if failures else "no failures")  # noqa: T201
    return int(failures > 0)


def _files(seed: int, folder: Path) -> int:
    results = bad_files.run(seed, folder, _log)
    kinds = sorted({bad.kind for bad, _ in results})
    print("| reader | inputs | refused | read | failures | most MiB | longest s |")  # noqa: T201
    print("|---|---|---|---|---|---|---|")  # noqa: T201
    for kind in [*kinds, None]:
        own = [found for bad, found in results if kind is None or bad.kind == kind]
        counts = Counter(found.kind for found in own)
        bad = sum(found.is_bad for found in own)
        mib, seconds = max(f.mib for f in own), max(f.seconds for f in own)
        print(  # noqa: T201
            f"| {kind or 'all'} | {len(own)} | {counts['refused']} | {counts['read']} | {bad} | "
            f"{mib:.0f} | {seconds:.1f} |"
        )
    return sum(found.is_bad for _, found in results)


def _rows(what: str, results: dict[str, str]) -> int:
    """Print how many checks passed; the values of failed ones are their reasons."""
    failed = {name: why for name, why in results.items() if why}
    print(f"| {what} | {len(results)} tried | {len(failed)} failed |")  # noqa: T201
    return len(failed)


def _log(text: str) -> None:
    print(text, file=sys.stderr, flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main())
