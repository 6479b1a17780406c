"""Rigid alignment of a breast under load with the same breast at rest."""

from dataclasses import replace

from palpate.storage.values import Volume
from palpate.workers.organs.breast.plausibility.rigid_motion import (
    RigidMotion,
    motion_between,
    moved,
)
from palpate.workers.organs.breast.plausibility.scan_facts import PlateLoad, Scan
from palpate.workers.organs.breast.problem import compression_axis
from palpate.workers.organs.breast.spec import BreastCase


def aligned(rest: Volume, scan: Volume, load: PlateLoad) -> tuple[Volume, RigidMotion]:
    """Return a loaded scan in the frame of the scan at rest, and the motion applied.

    See `workers.organs.breast.plausibility.rigid_motion` for the limits under compression.
    """
    here = Scan("the scan at rest", 0.0, load.axis, rest)
    there = Scan("the loaded scan", load.force_n, load.axis, scan)
    motion = motion_between(here, there, load, placed=False)
    there_now = moved(scan, motion)
    same = replace(there_now, frame_uid=rest.frame_uid, place_known=rest.place_known)
    return same, motion


def study_load(case: BreastCase) -> PlateLoad:
    """Return the load of a study for checks and alignment."""
    load, distance = case.load, case.load.plate_distance_mm
    fixed = "middle" if load.moving == "both" else "lower"
    axis = compression_axis(load.oblique_deg)
    if distance is None:
        return PlateLoad("case.load.force_n", axis, force_n=load.force_n, fixed=fixed)
    if distance.lower is not None and distance.upper is not None:
        ends = distance.lower, distance.upper
        return PlateLoad("case.load.plate_distance_mm", axis, ends_mm=ends)
    return PlateLoad(
        "case.load.plate_distance_mm.final",
        axis,
        initial_mm=distance.initial,
        distance_mm=distance.final,
    )
