"""The cornea against another solver: 9-node quadrilaterals with a carried prestretch."""

import numpy as np
import pytest

from palpate.workers.organs.cornea.corneal_model import (
    MPA_PER_MMHG,
    CorneaConstants,
    CorneaLoad,
    CorneaModel,
)
from palpate.workers.organs.cornea.section_mesh import mesh_section
from palpate.workers.organs.cornea.section_outline import generated_section
from tests.workers.organs.cornea.solver.quad_cornea import Eye, deformed
from tests.workers.organs.cornea.solver.solved import solve_cornea

SECTION = generated_section()
IOP = 10.5 * MPA_PER_MMHG


@pytest.mark.slow
@pytest.mark.parametrize(
    ("eye", "load", "model"),
    [
        ({}, {}, {}),
        (
            {"shift": (0.02, -0.2), "tilt": 0.02},
            {"eye_shift_mm": (0.02, -0.2), "eye_tilt_rad": 0.02},
            {},
        ),
        ({"jet_centre": 0.3}, {"jet_centre_mm": 0.3}, {}),
    ],
    ids=["jet", "whole eye", "off centre"],
)
def test_both_solvers_agree(eye: dict, load: dict, model: dict) -> None:
    top, bottom = deformed(
        Eye(SECTION.anterior_mm, SECTION.posterior_mm, (0.011, 0.035), (30.0, 80.0), IOP, **eye)
    )
    centre = eye.get("jet_centre", 0.0)
    mesh = mesh_section(SECTION, 2880, sorted({centre - 1.5, 0.0, centre, centre + 1.5}))
    solution = solve_cornea(
        mesh,
        CorneaConstants((0.011, 0.035), (30.0, 80.0)),
        CorneaLoad(IOP, **load),
        CorneaModel(prestress="inverse", **model),
    )
    x = mesh.nodes_mm + solution.displacement_mm
    for line, surface in ((top, mesh.anterior), (bottom, mesh.posterior)):
        inside = np.abs(line[:, 0]) < 5
        other = np.interp(line[inside, 0], *x[surface].T)
        # 0.3 % of an apex displacement of about 900 um.
        assert np.abs(other - line[inside, 1]).max() < 0.003
