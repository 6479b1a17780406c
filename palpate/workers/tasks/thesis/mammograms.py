"""Mammograms of the pressed phantoms (thesis section 4.4, Fig. 4.18), as tasks."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from palpate.workers.comparison.mammogram.dicom_image import dicom_bytes, mammogram_dataset
from palpate.workers.tasks.thesis.meshes import Press, pressed
from palpate.workers.tasks.thesis.parts import Request, Spent, Watch
from palpate.workers.thesis.compression import View
from palpate.workers.thesis.mammogram import PIXEL_MM, mammogram_pair


@dataclass(frozen=True)
class Expose(Request):
    """Request for mammograms of a phantom, already pressed, on both meshes."""

    MODULE: ClassVar[str] = __name__

    phantom: int
    view: View


@dataclass(frozen=True, slots=True)
class ExposedPhantom:
    """Result of taking two mammograms; stored with pictures and DICOM files as bytes.

    Parameters
    ----------
    spent : Spent
    converged : bool
        Whether both compressions converged; if not, there are no pictures.
    attenuation_rms, quantum_rms : float
        See `workers.thesis.mammogram.MammogramPair`; nan without pictures.
    """

    spent: Spent
    converged: bool
    attenuation_rms: float
    quantum_rms: float


def take_mammograms(request: Expose) -> Spent:
    """Take mammograms of one phantom on both meshes, and store them with their difference."""
    if not request.part.is_finished:
        watch = Watch()
        adaptive, homogeneous = (
            pressed(
                Press(request.store, request.scale, request.phantom, mesh, "neo-Hookean",
                      request.view)
            )
            for mesh in ("adaptive", "homogeneous")
        )  # fmt: skip
        if adaptive.labels is None or homogeneous.labels is None:
            request.part.save(ExposedPhantom(watch.spent(), False, np.nan, np.nan), {})
            return request.spent
        pixel_mm = PIXEL_MM[request.scale]
        pair = mammogram_pair(adaptive, homogeneous, request.view, pixel_mm, seed=request.phantom)
        name = f"PHANTOM^{request.phantom}"
        files = {
            mesh: dicom_bytes(mammogram_dataset(taken, request.view, body_name=name))
            for mesh, taken in (("adaptive", pair.adaptive), ("homogeneous", pair.homogeneous))
        }
        arrays = {
            "adaptive": pair.adaptive_picture,
            "homogeneous": pair.homogeneous_picture,
            "difference": pair.difference,
        }
        for mesh, content in files.items():
            arrays[f"{mesh}_dicom"] = np.frombuffer(content, np.uint8)
        rms = pair.attenuation_rms, pair.quantum_rms
        request.part.save(ExposedPhantom(watch.spent(), True, *rms), arrays)
    return request.spent
