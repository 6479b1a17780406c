"""A breast phantom at rest and compressed by the solver, and faulty versions of its scans."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from palpate.storage.values import Volume
from palpate.workers.body.images.tissue_labels import crop_to_body
from palpate.workers.body.phantom.phantom_generation import generate_breast
from palpate.workers.body.phantom.phantom_settings import BreastPhantom
from palpate.workers.organs.breast.breast_keys import BreastCase, BreastScore, BreastTarget
from palpate.workers.organs.breast.breast_organ import ORGAN
from palpate.workers.organs.breast.breast_study_checks import BreastChecks
from palpate.workers.organs.breast.scan_alignment import RigidMotion, moved
from palpate.workers.organs.plausibility_rule import Finding

TRUE = {"E_fat_kpa": 10.0, "E_glandular_kpa": 40.0}
SEARCHED = {"E_fat": (0.005, 0.020), "E_glandular": (0.005, 0.080)}


@cache
def at_rest(seed: int = 1, preset: str = "445ml", **changes: float) -> Volume:
    """Return a body of 445.6 ml, by default 85 x 50 x 25 voxels of 2 mm."""
    settings = BreastPhantom.preset(preset, spacing_mm=2.0, **changes)
    return crop_to_body(generate_breast(settings, seed).labels)


def case_of(load: Mapping[str, Any], constants: Mapping[str, float] | None = None) -> BreastCase:
    return BreastCase.model_validate(
        {
            "reference": {"volume": "rest.nrrd"},
            "mesh": {"nodes": 1200},
            "load": dict(load),
            "constants": dict(constants or {}),
        }
    )


def pressed(rest: Volume, load: Mapping[str, Any], constants: Mapping[str, float] = TRUE) -> Volume:
    """Return the body under a load, simulated by Palpate."""
    case = case_of(load, constants)
    mesh = ORGAN.make_mesh(rest, case)
    model = ORGAN.prepare(mesh)
    problem = ORGAN.problem(model, case, case.complete({}), ORGAN.landmarks(rest, case))
    solution = ORGAN.solve(model, problem)
    assert solution.outcome.converged, solution.outcome.reason
    return crop_to_body(ORGAN.deform(rest, mesh, solution.displacement_mm))


@cache
def usual_pair() -> tuple[Volume, Volume]:
    """Return the body at rest and under 60 N."""
    rest = at_rest()
    return rest, pressed(rest, {"force_n": 60})


def findings(
    rest: Volume | None,
    scan: Volume | None,
    load: Mapping[str, Any] | None = None,
    *,
    align: str | None = None,
    constants: Mapping[str, float] | None = None,
) -> list[Finding]:
    """Return the findings of the checks of a study for two volumes."""
    case = case_of(load or {"force_n": 60}, constants)
    target = BreastTarget.model_validate({"volume": "pressed.nrrd", "align": align})
    if align is not None and rest is not None and scan is not None:
        scan = ORGAN.aligned(scan, rest, case)[0]
    checks = BreastChecks(SEARCHED)
    return list(checks.of_bodies(case, target, BreastScore(), rest, scan))


def texts(found: list[Finding], severity: str = "implausible") -> str:
    return "\n".join(one.text for one in found if one.severity == severity)


def shifted(volume: Volume, *by_mm: float) -> Volume:
    x, y, z = np.add(volume.origin_mm, by_mm)
    return replace(volume, origin_mm=(float(x), float(y), float(z)))


def turned(volume: Volume, *degrees: float) -> Volume:
    body = np.argwhere(volume.values)[:, ::-1].mean(axis=0)
    centre = np.asarray(volume.origin_mm) + np.asarray(volume.spacing_mm) * body
    x, y, z = (float(c) for c in centre)
    a, b, c = degrees
    return moved(volume, RigidMotion((0.0, 0.0, 0.0), (a, b, c), (x, y, z)))


def scaled(volume: Volume, factor: float) -> Volume:
    """Scale a body about its centre in x and y, and from the chest wall."""
    body = np.argwhere(volume.values)[:, ::-1].mean(axis=0)
    origin, spacing = np.asarray(volume.origin_mm), np.asarray(volume.spacing_mm)
    centre = origin + spacing * body
    centre[2] = origin[2] - spacing[2] / 2
    x, y, z = (float(o) for o in centre + factor * (origin - centre))
    a, b, c = (float(s) for s in factor * spacing)
    return replace(volume, spacing_mm=(a, b, c), origin_mm=(x, y, z))


def flipped(volume: Volume, axes: str) -> Volume:
    """Mirror the voxels along axes, in the same box."""
    numbers = tuple("zyx".index(axis) for axis in axes)
    return replace(volume, values=np.ascontiguousarray(np.flip(volume.values, numbers)))
