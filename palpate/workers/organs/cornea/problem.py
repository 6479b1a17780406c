"""Construction of the solver's input from the constants of a study."""

from collections.abc import Mapping

import numpy as np

from palpate.workers.organs.cornea.material.constants import CorneaConstants
from palpate.workers.organs.cornea.material.load import CorneaLoad
from palpate.workers.organs.cornea.material.model import CorneaModel
from palpate.workers.organs.cornea.parameters import TERMS
from palpate.workers.organs.cornea.section.outline import Section
from palpate.workers.organs.cornea.solver.candidate import Candidate
from palpate.workers.organs.cornea.solver.model_cache import MeshForModels
from palpate.workers.organs.cornea.spec import CorneaCase


def candidate_of(
    meshes: MeshForModels, case: CorneaCase, values: Mapping[str, float], middle_mm: float
) -> Candidate:
    """Return the candidate for given parameter values.

    Parameters
    ----------
    meshes : MeshForModels
    case : CorneaCase
    values : mapping of str to float
        Every parameter in `workers.organs.cornea.parameters.CORNEA`, in internal units.
    middle_mm : float
        See `middle_of`.

    Raises
    ------
    InputError
        If constants or load are inconsistent.
    """
    return Candidate(
        prepared=meshes.prepared(model_of(case, values)),
        constants=constants_of(case, values),
        load=load_of(case, values, middle_mm),
    )


def model_of(case: CorneaCase, values: Mapping[str, float]) -> CorneaModel:
    """Return the options of the simulation."""
    compliance = values["limbus_compliance"]
    return CorneaModel(
        kind=case.model.kind,
        prestress=case.model.prestress,
        limbus_mpa_per_mm=1 / compliance if compliance > 0 else None,
        depth_gradient=values["depth_gradient"],
        side_gradient=values["side_gradient"],
    )


def constants_of(case: CorneaCase, values: Mapping[str, float]) -> CorneaConstants:
    """Return the law; terms with a zero modulus are left out, unless all are zero."""
    numbers = [n for n in range(1, TERMS + 1) if values[f"mu{n}"] > 0] or [1]
    return CorneaConstants(
        mu_mpa=tuple(values[f"mu{n}"] for n in numbers),
        alpha=tuple(values[f"alpha{n}"] for n in numbers),
        bulk_mpa=values["bulk"],
        convention=case.model.convention,
    )


def load_of(case: CorneaCase, values: Mapping[str, float], middle_mm: float) -> CorneaLoad:
    """Return pressures and motion of the eye."""
    jet = case.load.jet
    return CorneaLoad(
        iop_mpa=values["iop"],
        jet_pressure_mpa=values["jet_pressure"],
        jet_centre_mm=middle_mm + values["jet_centre"],
        jet_diameter_mm=jet.diameter_mm,
        jet_profile=None if jet.profile is None else jet.profile.profile,
        jet_width_factor=values["jet_width"],
        iop_rise_mpa=values["iop_rise"],
        eye_shift_mm=(values["eye_shift_x"], values["eye_shift_y"]),
        eye_tilt_rad=float(np.radians(values["eye_tilt"])),
    )


def middle_of(section: Section) -> float:
    """Return the x midway between the ends of the anterior surface, in mm."""
    return float(section.anterior_mm[[0, -1], 0].mean())


def jet_nodes_x_mm(section: Section, case: CorneaCase) -> tuple[float, ...]:
    """Return the required nodes of the mesh: edges and centre of the jet, and the middle."""
    middle, jet = middle_of(section), case.load.jet
    centre = middle + jet.centre_mm
    return tuple(sorted({middle, centre, centre - jet.reach_mm, centre + jet.reach_mm}))
