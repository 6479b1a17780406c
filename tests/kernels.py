"""Compile most kernels before the tests run: ``python -m tests.kernels breast|others``.

Otherwise both processes of `make test` compile the same kernels at the same time. The two parts
run beside the linters, on two cores.
"""

import sys
import tempfile
from pathlib import Path

import palpate
from palpate.workers.blind.case_body import body_of
from palpate.workers.blind.random_case import draw
from palpate.workers.blind.scene_solution import solve_scene
from palpate.workers.blind.solver.plate_equilibrium import topology_of
from palpate.workers.body.mesh.adaptive_lattice import Sizes
from palpate.workers.body.mesh.adaptive_mesher import adaptive_mesh
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom

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
SMALL = BreastPhantom(
    lower_mm=18.75, upper_mm=20.0, half_width_mm=18.75, depth_mm=18.75, compartments=20,
    spacing_mm=0.6, glandular_fraction=0.2,
)  # fmt: skip


def breast() -> None:
    """Run a study and a body with friction and derivatives."""
    with tempfile.TemporaryDirectory() as folder:
        palpate.Study.from_dict(STUDY, Path(folder) / "study").run(in_process=True)
    body = palpate.phantom(preset="445ml", spacing_mm=2.0)
    model = palpate.Breast(body, nodes=1000, force_n=40)
    model.simulate(E_fat_kpa=8, friction=0.3).gradient("E_fat_kpa")


def others() -> None:
    """Solve a cornea and a blind body, and mesh a phantom adaptively."""
    palpate.Cornea().simulate()
    truth = draw(2, "control", one_direction=True)
    body = body_of(truth.anatomy, 600, 1.5)
    solve_scene(truth.scene, topology_of(body.mesh), body.labels, truth.loads[:1])
    adaptive_mesh(generate_breast(SMALL, 3).labels, Sizes(1.6))


if __name__ == "__main__":
    {"breast": breast, "others": others}[sys.argv[1]]()
