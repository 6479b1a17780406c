"""Problems of the small breast of `palpate.testing`."""

from palpate.storage.values import Tissue
from palpate.testing.plugin_claims import HALF_MM, NU
from palpate.testing.plugin_claims import small_breast as volume
from palpate.workers.mechanics.fem.boundary_value_problem import Constants, Membrane, Problem
from palpate.workers.mechanics.fem.loads_and_regions import Device, ForceControl, Load, Plate, Wall

__all__ = ["HALF_MM", "busy", "plain", "problem", "volume"]


def problem(load: Load, **options: object) -> Problem:
    """Return a problem of fat and gland with fibres, loosely held at the chest wall."""
    return Problem(
        constants={
            Tissue.FAT: Constants(0.010, NU, 0.02),
            Tissue.GLANDULAR: Constants(0.030, NU, 0.03),
        },
        load=load,
        **options,
    )


def plain() -> Problem:
    """Return a problem with two flat plates and nothing else."""
    return problem(ForceControl(20.0, -33.0, 33.0))


def busy() -> Problem:
    """Return a problem with nearly all fields off their defaults, which effects must keep."""
    tilted = Plate(tilt_deg=(1.0, -2.0), bow_per_mm=(1e-3, 2e-3))
    return problem(
        ForceControl(20.0, -33.0, 33.0, Device(upper=tilted, friction=0.1, lower_share=0.3)),
        membrane=Membrane(0.5, 1.5),
        wall=Wall((False, False, False), (1e-4, 2e-4, 3e-3)),
        gravity_g=(0.1, 0.2, 0.3),
        imaged_gravity_g=(0.0, 0.1, 0.2),
    )
