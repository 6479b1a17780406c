"""The body of an organ from flat keys, simulated in this process or by a client's workers.

Flat keys such as ``nodes=2000, force_n=50, E_fat_kpa=8`` are checked as in a file.
"""

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

from distributed import Client

from palpate.service.cluster.worker_failures import prepare_workers
from palpate.service.simulation.simulation_record import LoadedModel, SimulationRecord
from palpate.storage.backends.store_paths import Location
from palpate.storage.errors import InputError
from palpate.storage.store import Store, open_store
from palpate.storage.stored_arrays import load_field
from palpate.storage.values import EvaluationResult, FloatArray, Volume
from palpate.workers.common_keys import CaseSpec, Door, validated
from palpate.workers.mechanics.model_parameters import Vocabulary, unknown_name
from palpate.workers.organs.organ_plugins import catalogue_of, organ_named, organ_spec
from palpate.workers.organs.organ_protocol import Organ
from palpate.workers.organs.plausibility_rule import Finding, accept
from palpate.workers.tasks.plausibility import case_findings
from palpate.workers.tasks.study_tasks import prepare_case, simulate_once
from palpate.workers.tasks.task_store import BodyStore


def case_from_keys(organ: str, keys: Mapping[str, Any]) -> CaseSpec:
    """Return the case described by flat keys.

    Parameters
    ----------
    organ : str
    keys : mapping
        Sections of a case (``mesh``), keys of its sections (``nodes``, ``force_n``), and held
        constants (``E_fat_kpa``). Missing keys have the defaults of a study file.

    Raises
    ------
    InputError
        If a key is not valid; the message names each one, with the expected value or the
        nearest known key.

    Examples
    --------
    >>> keys = {"phantom": {"spacing_mm": 2}, "nodes": 900, "force_n": 40, "E_fat_kpa": 8}
    >>> case = case_from_keys("breast", keys)
    >>> case.mesh.nodes, case.load.force_n, case.constants
    (900, 40.0, {'E_fat_kpa': 8.0})
    """
    spec = organ_spec(organ)
    sections = _sections(spec.case)
    homes = {key: name for name, door in sections.items() for key in door.model_fields}
    data: dict[str, Any] = {"organ": organ}
    constants: dict[str, Any] = dict(keys.get("constants") or {})
    for key, value in keys.items():
        if key in homes and key not in sections:
            data.setdefault(homes[key], {})[key] = value
        elif key in sections:
            data[key] = {**value, **data.get(key, {})} if isinstance(value, Mapping) else value
        elif key != "constants":
            constants[key] = value
    known = set(spec.parameters.door_names)
    uncertain = {key for key in constants if key not in known}
    certain = {key: value for key, value in constants.items() if key not in uncertain}
    case = validated(spec.case, data | {"constants": certain}, "The model")
    for key in sorted(uncertain - set(case.vocabulary.door_names)):
        raise InputError(unknown_name("key", key, [*sections, *homes, *case.parameters.door_names]))
    return validated(spec.case, data | {"constants": constants}, "The model")


def stated_constants(case: CaseSpec, given: Mapping[str, float]) -> dict[str, float]:
    """Return constants with internal names and units.

    Raises
    ------
    InputError
        If a name is unknown or not used by the case, or a value is not admissible.
    """
    parameters = case.parameters
    for name in given:
        if name not in parameters.door_names:
            unused = case.unused_parameter(name)
            reason = f" ({unused})" if unused else ""
            raise InputError(f"{unknown_name('constant', name, parameters.door_names)}{reason}")
    return stated_in(parameters, given)


def stated_in(vocabulary: Vocabulary, given: Mapping[str, float]) -> dict[str, float]:
    """Return constants of a vocabulary with internal names and units.

    Raises
    ------
    InputError
        If a name is unknown, or a value is not a number or not admissible.
    """
    return vocabulary.from_door({name: _as_number(name, value) for name, value in given.items()})


def _as_number(name: str, value: Any) -> float:
    """Return the value of a constant as a float.

    Raises
    ------
    InputError
        If it is not a number.
    """
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a number, found {value!r}.") from None


def _sections(case: type[CaseSpec]) -> dict[str, type[Door]]:
    """Return the sections of a case by name."""
    found = {name: field.annotation for name, field in case.model_fields.items()}
    return {n: t for n, t in found.items() if isinstance(t, type) and issubclass(t, Door)}


def solved_on(
    client: Client, store: Store, task: Callable[..., EvaluationResult], *arguments: Any
) -> tuple[FloatArray, str, Mapping[str, Any]]:
    """Return displacement, reason and outcome of a simulation by a worker.

    Parameters
    ----------
    client : distributed.Client
    store : Store
        Where the worker saves the result.
    task : callable
        Simulates, with the location of the store as its last argument.
    *arguments
        The others.

    Raises
    ------
    ClusterError
        If the workers have another version of Palpate.
    """
    prepare_workers(client)
    result = client.submit(task, *arguments, str(store), pure=False).result()
    return load_field(store, result["digest"]), result["reason"], result["outcome"]


class OrganModel:
    """A body, its mesh and its model; nothing is stored unless a client simulates it.

    Parameters
    ----------
    case : CaseSpec
    kind : type
        Class of its simulations.
    given : object, optional
        The body itself, if ``case.reference`` only describes its labels. Default: the body
        that the case describes.
    shown : callable, optional
        Converts the picture of a deformed body for the caller. Default: the body itself.

    Raises
    ------
    InputError
        If the body does not exist.
    """

    def __init__(
        self,
        case: Any,
        kind: type[SimulationRecord],
        given: Volume | None = None,
        shown: Callable[[Volume], Volume] | None = None,
    ) -> None:
        self.case: Any = case
        self.organ: Organ[Any, Any, Any] = organ_named(case.organ)
        self._kind, self._given, self._shown = kind, given, shown
        if given is None:
            self.body = self.organ.make_body(case.reference)
        else:
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

    def simulate(
        self, constants: Mapping[str, float], client: Client | None, place: Location
    ) -> Any:
        """Load the body in this process, or on a worker, which reads it from a store.

        Parameters
        ----------
        constants : mapping of str to float
            Constants with the names and units of a study file.
        client : distributed.Client or None
            None for this process.
        place : str or Path
            Location of the store.

        Raises
        ------
        InputError
            If a constant is unknown or not admissible.
        ClusterError
            If the workers have another version of Palpate.
        StoreError
            If the store cannot be used.
        """
        stated = stated_constants(self.case, constants)
        if client is None:
            return self._loaded.simulate(stated)
        bodies = BodyStore(open_store(place), self.organ)
        case = self.case.model_dump(mode="json")
        if self._given is not None:
            case["reference"] = {"volume": bodies.add(self.body, {"kind": "generated"})}
        found = solved_on(client, bodies.store, simulate_once, case, stated)
        self.__dict__["mesh"] = bodies.mesh(prepare_case(case, str(bodies.store))["mesh"])
        return self._loaded.result(stated, *found)

    @cached_property
    def _loaded(self) -> LoadedModel[Any]:
        return LoadedModel(
            kind=self._kind,
            model=self.model,
            vocabulary=self.case.vocabulary,
            complete=self.case.complete,
            problem=self.problem,
            follows_path=self._follows_path,
            deform=self._deformed,
        )

    def _follows_path(self, name: str) -> bool:
        effects = catalogue_of(self.case.organ).effects
        return any(name in effect.names for effect in effects if effect.follows_path)

    def _deformed(self, displacement_mm: FloatArray) -> Any:
        deformed = self.organ.deform(self.body, self.mesh, displacement_mm)
        return deformed if self._shown is None else self._shown(self.organ.picture(deformed))
