"""Mammograms of the body of a study under its own compression."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from palpate.storage.errors import InputError
from palpate.storage.store import open_store
from palpate.storage.stored_arrays import load_volume
from palpate.workers.comparison.mammogram_image import Mammogram, Noise, View, expose
from palpate.workers.comparison.xray_beam import CC_AXIS, Unit, geometry_of, mlo_axis, spectrum_of
from palpate.workers.tasks.study_tasks import simulate_once

OBLIQUE_DEG: dict[View, float] = {"CC": 0.0, "MLO": 45.0}


@dataclass(frozen=True, eq=False)
class TakenView:
    """Mammograms of one view.

    Parameters
    ----------
    view : {"CC", "MLO"}
    fitted : Mammogram
        Mammogram of the body with the constants found by the study.
    target : Mammogram or None
        Mammogram with the target's constants, in the same geometry; None if they are unknown.
    """

    view: View
    fitted: Mammogram
    target: Mammogram | None


def take_view(
    case: Mapping[str, Any],
    fitted: Mapping[str, float],
    target: Mapping[str, float] | None,
    view: View,
    store: str,
    *,
    pixel_mm: float = 0.2,
    noise_seed: int | None = 0,
) -> TakenView:
    """Press the body of a case for one view and take its mammogram.

    Parameters
    ----------
    case : dict
        Case of a breast, as serialised by `CaseSpec`; its plates are rotated to the view.
    fitted, target : mapping of str to float
        Constants, in internal names and units.
    view : {"CC", "MLO"}
    store : str
    pixel_mm : float
        Edge of the detector's pixels.
    noise_seed : int, optional
        Seed of the noise; None for a mammogram without noise.

    Raises
    ------
    InputError
        If the case is not of a breast, or its compression does not converge.
    """
    if case.get("organ", "breast") != "breast":
        raise InputError(
            f"A mammogram needs a study of a breast, but this one is of the {case['organ']}. Name "
            "a study of a breast."
        )
    load = {**case["load"], "oblique_deg": OBLIQUE_DEG[view]}
    turned = {**case, "load": load}
    bodies = [None if values is None else _pressed(turned, values, view, store)
              for values in (fitted, target)]  # fmt: skip
    first, second = bodies
    assert first is not None
    axis = CC_AXIS if view == "CC" else mlo_axis(OBLIQUE_DEG[view])
    geometry, spectrum = geometry_of(first, axis, Unit(pixel_mm=pixel_mm)), spectrum_of("w_rh")

    def taken(body: Any, more: int) -> Mammogram:
        noise = None if noise_seed is None else Noise(noise_seed + more)
        return expose(body, geometry, spectrum, noise=noise)

    return TakenView(view, taken(first, 0), None if second is None else taken(second, 1))


def _pressed(case: Mapping[str, Any], values: Mapping[str, float], view: View, store: str) -> Any:
    result = simulate_once(dict(case), values, store)
    volume = result.get("volume")
    if result["status"] != "done" or volume is None:
        raise InputError(
            f"The {view} compression does not converge: {result['reason']}. Select only the other "
            "view with --view."
        )
    return load_volume(open_store(store), volume)
