"""Fuzz one reader with damaged files for a given time.

::

    python -m tests.robustness.fuzz NRRD --seconds 600 --seed 1

Prints the number of inputs, the number of refusals, and each failure once, by its last line.
"""

import argparse
import shutil
import tempfile
import time
from collections import Counter
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np

from palpate.storage.errors import PalpateError
from tests.robustness.mutations import damaged
from tests.robustness.outcome import Outcome, outcome_of, with_secret
from tests.robustness.seeds import SEEDS, Seed


def fuzz(reader: str, seconds: float, seed: int) -> tuple[Counter[str], dict[str, Path]]:
    """Return the count of each outcome, and an example of each failure."""
    random = np.random.default_rng([seed, *reader.encode()])
    seeds = [one for one in SEEDS if one.reader == reader]
    counts: Counter[str] = Counter()
    failures: dict[str, Path] = {}
    kept = Path(tempfile.mkdtemp(prefix=f"palpate-fuzz-{reader}-"))
    with tempfile.TemporaryDirectory(prefix="palpate-fuzz-") as scratch:
        whole = {one: _whole(one, Path(scratch) / f"of {one.name}" / one.name) for one in seeds}
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            one = seeds[int(random.integers(0, len(seeds)))]
            place = Path(scratch) / "damaged"
            shutil.copytree(whole[one].parent, place)
            path = place / one.name
            path.write_bytes(damaged(whole[one].read_bytes(), random))
            found = outcome_of(lambda one=one, path=path: one.read(path))
            counts[found.kind] += 1
            if found.is_bad:
                name = _name(found)
                if name not in failures:
                    failures[name] = kept / f"{len(failures)}-{one.name}"
                    shutil.copy(path, failures[name])
            shutil.rmtree(place)
    return counts, failures


def _whole(seed: Seed, path: Path) -> Path:
    path.parent.mkdir(parents=True)
    seed.make(path)
    with_secret(path.parent)
    with suppress(PalpateError) if seed.reader == "archive" else nullcontext():  # has no journal
        seed.read(path)
    shutil.rmtree(path.parent / "imported", ignore_errors=True)
    return path


def _name(found: Outcome) -> str:
    lines = found.text.strip().splitlines() or [""]
    where = [line.strip() for line in lines if line.strip().startswith("File")]
    memory = f" {found.mib:.0f} MiB" if found.mib > 1500 else ""
    return f"{found.kind}{memory}: {lines[-1][:120]} {where[-1] if where else ''}"


def main() -> None:
    """Fuzz the reader given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reader", choices=sorted({one.reader for one in SEEDS}))
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    counts, failures = fuzz(given.reader, given.seconds, given.seed)
    summary = ", ".join(f"{kind} {count}" for kind, count in counts.most_common())
    print(f"{given.reader}: {sum(counts.values())} inputs: {summary}")  # noqa: T201
    for name, path in failures.items():
        print(f"  {name}\n    {path}")  # noqa: T201
    raise SystemExit(bool(failures))


if __name__ == "__main__":
    main()
