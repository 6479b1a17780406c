"""A body of an organ, simulated in this process or by a client's workers."""

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, cast

from distributed import Client

from palpate.service.cluster.foreign_workers import prepare_workers
from palpate.service.forward.case_keys import stated_constants
from palpate.service.forward.simulation import MeshedBody, Simulation
from palpate.storage.backends.places import Location
from palpate.storage.errors import InputError
from palpate.storage.records.tasks import EvaluationResult
from palpate.storage.stores.fields import load_field
from palpate.storage.stores.store import open_store
from palpate.storage.values import FloatArray, Volume
from palpate.workers.mechanics.fem.elements.model import Model
from palpate.workers.mechanics.fem.problem.boundary_value_problem import Problem
from palpate.workers.organs.organ import CheckingOrgan, Organ, StoredOrgan
from palpate.workers.organs.registry import catalogue_of, organ_named
from palpate.workers.organs.study_checks import Finding, accept
from palpate.workers.tasks.body_store import BodyStore
from palpate.workers.tasks.evaluation import prepare_case, simulate_once
from palpate.workers.tasks.study_checks import case_findings


class OrganModel:
    """A body, its mesh and its model; nothing is stored unless a client simulates it.

    Parameters
    ----------
    case : CaseSpec
    given : object, optional
        The body itself, if ``case.reference`` only describes its labels. Default: the body
        that the case describes.

    Raises
    ------
    InputError
        If the body does not exist.
    """

    def __init__(self, case: Any, given: Volume | None = None) -> None:
        self.case: Any = case
        self.organ: Organ[Any, Any, Any] = organ_named(case.organ)
        self._given = given
        if given is None:
            self.body = self.organ.make_body(case.reference)
        else:
            assert isinstance(self.organ, StoredOrgan)
            adapted = self.organ.adapt_stored(given, case.reference)
            self.body = given if adapted is None else adapted

    def check(self, *, anyway: bool) -> list[Finding]:
        """Check that the body is plausible.

        Raises
        ------
        InputError
            If it is not; the message lists every reason.
        """
        imaged = self._given is not None or self.organ.body_files(self.case.reference)
        found = case_findings(self.case, self.body if imaged else None)
        return accept(found, "The model", anyway=anyway)

    @cached_property
    def mesh(self) -> Any:
        """The mesh, generated on first use."""
        mesh = self.organ.make_mesh(self.body, self.case)
        if isinstance(self.organ, CheckingOrgan):
            self.organ.check(self.case, self.body, self.organ.facts(self.body, mesh))
        return mesh

    @cached_property
    def model(self) -> Any:
        """The mesh, prepared for the solver."""
        return self.organ.prepare(self.mesh)

    @cached_property
    def landmarks(self) -> Any:
        """The landmarks of the body that the load needs."""
        return self.organ.landmarks(self.body, self.case)

    def problem(self, constants: Mapping[str, float]) -> Any:
        """Return the problem for all constants, in internal names and units."""
        return self.organ.problem(self.model, self.case, constants, self.landmarks)

    def simulate(self, constants: Mapping[str, float]) -> Simulation:
        """Load the body in this process.

        Parameters
        ----------
        constants : mapping of str to float
            Constants with the names and units of a study file.

        Raises
        ------
        InputError
            If a constant is unknown or not admissible.
        """
        stated = stated_constants(self.case, constants)
        return self._meshed.simulate(stated)

    def simulate_on(
        self, client: Client, constants: Mapping[str, float], place: Location
    ) -> Simulation:
        """Load the body on a worker, which reads it from a store; see `simulate` and `solve_on`."""
        displacement_mm, result = self.solve_on(client, constants, place)
        stated = stated_constants(self.case, constants)
        return self._meshed.result(stated, displacement_mm, result["outcome"])

    def solve_on(
        self, client: Client, constants: Mapping[str, float], place: Location
    ) -> tuple[FloatArray, EvaluationResult]:
        """Return the displacement computed by a worker for this mesh, and its record.

        Raises
        ------
        InputError
            If a constant is unknown or not admissible.
        ClusterError
            If the workers have another version of Palpate.
        StoreError
            If the store cannot be used.
        """
        stated, store = stated_constants(self.case, constants), open_store(place)
        bodies = BodyStore(store, self.organ)
        case = self.case.model_dump(mode="json")
        if self._given is not None:
            case["reference"] = {"volume": bodies.add(self.body, {"kind": "generated"})}
        prepare_workers(client)
        task = client.submit(simulate_once, case, stated, str(store), pure=False)
        result: EvaluationResult = task.result()
        prepared = prepare_case(case, str(store))
        self.__dict__["mesh"] = bodies.mesh(prepared["mesh"])
        return load_field(store, result["digest"]), result

    @cached_property
    def _meshed(self) -> MeshedBody:
        if not isinstance(self.model, Model):
            raise InputError(f"A {self.case.organ} is not a body of tetrahedra.")
        effects = catalogue_of(self.case.organ).effects
        return MeshedBody(
            model=self.model,
            vocabulary=self.case.vocabulary,
            complete=self.case.complete,
            problem=cast(Callable[[Mapping[str, float]], Problem], self.problem),
            path_dependent=frozenset(n for e in effects if e.follows_path for n in e.names),
            deform=self._deformed,
        )

    def _deformed(self, displacement_mm: FloatArray) -> Volume:
        return self.organ.picture(self.organ.deform(self.body, self.mesh, displacement_mm))
