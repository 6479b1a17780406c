"""Compile most kernels before the tests run: ``python -m tests.kernels``.

Otherwise both processes of `make test` compile the same kernels at the same time. It runs beside
the linters, which leave one core free.
"""

import tempfile
from pathlib import Path

import palpate

STUDY = {
    "name": "kernels",
    "case": {
        "organ": "breast",
        "reference": {"phantom": {"preset": "445ml", "spacing_mm": 2.0}},
        "mesh": {"nodes": 1000},
        "load": {"force_n": 40},
    },
    "target": {"constants": {"E_fat_kpa": 10, "E_glandular_kpa": 40}},
    "search": {"strategy": "least-squares", "parameters": {"E_fat_kpa": [5, 20]}},
}


def main() -> None:
    """Run a study and a body with friction and derivatives in this process."""
    with tempfile.TemporaryDirectory() as folder:
        palpate.Study.from_dict(STUDY, Path(folder) / "study").run(in_process=True)
    body = palpate.phantom(preset="445ml", spacing_mm=2.0)
    breast = palpate.Breast(body, nodes=1000, force_n=40)
    breast.simulate(E_fat_kpa=8, friction=0.3).gradient("E_fat_kpa")
    palpate.Cornea().simulate()


if __name__ == "__main__":
    main()
