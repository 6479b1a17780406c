"""Forward models: from a body and its constants to a deformation, as arrays."""

import warnings
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.service.simulation.body_simulation import Simulation
from palpate.service.simulation.organ_simulation import OrganModel, case_from_keys
from palpate.storage import values
from palpate.volumes import Volume

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Breast", "Simulation"]

GIVEN = "the given volume"


class Breast:
    """A breast between two plates, ready to be simulated with any constants.

    The mesh is generated for the first simulation and reused. Nothing is written to disk, and no
    cluster is needed.

    Parameters
    ----------
    body : Volume, str, Path or mapping
        Labels as returned by `read_volume` and `phantom`, a file, or the keys of
        ``case.reference`` in a study file.
    anyway : bool
        Simulate even though the body or the load looks implausible.
    **keys
        Keys below ``case`` in a study file, without the name of their section: ``nodes`` or
        ``element_size_mm``; ``force_n`` or ``plate_distance_mm``, ``oblique_deg``, ``moving``,
        ``fixed_plate_holds_x``; ``skin``, ``skin_thickness_mm``, ``fibres``, ``fibre_invariant``,
        ``law``; ``labels`` of a volume; and held constants, such as ``nu=0.48``. The defaults are
        the same as in a study.

    Raises
    ------
    InputError
        If a key is not valid or the body cannot be simulated; the message lists every reason.

    Examples
    --------
    >>> import palpate
    >>> model = palpate.Breast({"phantom": {"spacing_mm": 2}}, nodes=850)
    >>> result = model.simulate(E_fat_kpa=8)
    >>> result.converged, result.displacement_mm.shape == result.nodes_mm.shape
    (True, True)
    """

    def __init__(
        self,
        body: values.Volume | str | Path | Mapping[str, Any],
        *,
        anyway: bool = False,
        **keys: Any,
    ) -> None:
        reference: dict[str, Any] = {}
        given: values.Volume | None = None
        if isinstance(body, Mapping):
            reference |= body
        elif isinstance(body, values.Volume):
            given = values.Volume(**deepcopy(vars(body)))
            reference["volume"] = GIVEN
        else:
            reference["volume"] = str(body)
        case = case_from_keys("breast", {"reference": reference} | keys)
        self._model = OrganModel(case, Simulation, given, shown=Volume.of)
        for finding in self._model.check(anyway=anyway):
            warnings.warn(finding.text, stacklevel=2)

    @property
    def case(self) -> Any:
        """The case as in a study file, including defaults."""
        return self._model.case

    @property
    def body(self) -> Volume:
        """The undeformed body as labels of `Tissue`."""
        return Volume.of(self._model.body)

    def simulate(
        self,
        *,
        client: "Client | None" = None,
        store: str | Path = "runs/store",
        **constants: float,
    ) -> Simulation:
        """Compress the breast once.

        Parameters
        ----------
        client : distributed.Client, optional
            A client with workers for the simulation. Default: this process. Results are stored and
            reused.
        store : str or Path
            Where the workers of `client` find the body: a folder, or ``s3://``, ``gs://`` or
            ``az://BUCKET/PREFIX``, visible to this process and all workers. Not used without a
            client.
        **constants : float
            Names and units of a study file, such as ``E_fat_kpa=8``; `parameters` lists them.
            Other constants keep the values of the model.

        Raises
        ------
        InputError
            If a constant is unknown or its value is not admissible.
        """
        result: Simulation = self._model.simulate(constants, client, store)
        return result
