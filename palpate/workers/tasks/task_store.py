"""The part of the store that tasks fill: bodies, meshes, and results under their digest.

The record and the arrays of a task are named after everything that they depend on. A part is
written completely or not at all, so a name exists only once its part is finished, and the same name
means the same content everywhere. Records are frozen dataclasses; see `storage.json_digests`.

A body or a mesh is made once, cached in each process, and named after its content. A small record
maps the digest of a request, and of the code that fulfils it, to that content; so a code change
that leaves the content unchanged makes nothing else stale.
"""

import threading
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from numpy.typing import NDArray

from palpate.storage.backends.store_paths import Location, Place
from palpate.storage.errors import InputError, StoreError
from palpate.storage.json_digests import array_digest, digest, file_digest, from_json, to_json
from palpate.storage.store import Store, open_store
from palpate.storage.stored_arrays import (
    Arrays,
    find_volume,
    has_arrays,
    has_mesh,
    has_volume,
    load_arrays,
    load_mesh,
    load_meta,
    load_volume,
    save_arrays,
    save_mesh,
    save_volume,
    volume_meta,
)
from palpate.storage.values import Volume
from palpate.workers.common_keys import CaseSpec, Door, ScoreSpec
from palpate.workers.comparison.score_objective import objective_named
from palpate.workers.input_files import check_regular
from palpate.workers.organs.organ_plugins import organ_modules
from palpate.workers.organs.organ_protocol import Facts, Organ
from palpate.workers.resources import CACHE
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.pipeline import Setup, Watch

R = TypeVar("R")
T = TypeVar("T")


class TaskStore:
    """The results of tasks in one store.

    Parameters
    ----------
    location : str or Path
        Location of the store, which is created if missing.

    Raises
    ------
    StoreError
        If the store cannot be used.
    """

    def __init__(self, location: Location) -> None:
        self.store = open_store(location)

    def path(self, name: str) -> Place:
        """Return the path of the part with this digest."""
        return self.store.layout.field(name)

    def has(self, name: str) -> bool:
        """Return True if a part is finished."""
        return has_arrays(self.path(name))

    def save(self, name: str, record: object, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write a finished part, unless it already exists.

        Parameters
        ----------
        name : str
            Digest of everything the part depends on.
        record : dataclass
        arrays : mapping of str to ndarray

        Raises
        ------
        StoreError
            If the store cannot be written.
        """
        save_arrays(self.path(name), arrays, to_json(record))

    def record(self, name: str, kind: type[R]) -> R:
        """Read the record of a part, without its arrays.

        Raises
        ------
        StoreError
            If the part is missing or damaged, or its record is of another type.
        """
        return self._typed(name, kind, load_meta(self.path(name)))

    def load(self, name: str, kind: type[R]) -> tuple[R, Arrays]:
        """Read the record and the arrays of a part.

        Raises
        ------
        StoreError
            If the part is missing or damaged, or its record is of another type.
        """
        arrays, meta = load_arrays(self.path(name))
        return self._typed(name, kind, meta), arrays

    def add_volume(self, volume: Volume) -> str:
        """Store a volume under the digest of its content, and return the digest."""
        place = [list(volume.spacing_mm), list(volume.origin_mm), *volume.frame_facts]
        name = digest("image", array_digest(volume.values), place)
        if not has_volume(self.store, name):
            save_volume(self.store, name, volume, meta={"kind": "image"})
        return name

    def volume(self, name: str) -> Volume:
        """Return a stored volume, cached in this process."""
        return self.cached(("volume", name), lambda: load_volume(self.store, name))

    def cached(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return a value, computed once for this store in this process."""
        return CACHE.get(("task", str(self.store.root), key), make)

    def _typed(self, name: str, kind: type[R], meta: Mapping[str, Any]) -> R:
        try:
            return from_json(kind, meta)
        except ValueError as error:
            raise StoreError(
                f"{self.path(name)} has unexpected content: {error}. Remove that folder and run "
                "the same command again to recreate it."
            ) from error


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a task store, finished or not.

    Parameters
    ----------
    store : TaskStore
    name : str
        Digest of everything the part depends on.
    """

    store: TaskStore
    name: str

    @property
    def path(self) -> Place:
        """Path of the part."""
        return self.store.path(self.name)

    @property
    def is_finished(self) -> bool:
        """True if the part is in the store."""
        return self.store.has(self.name)

    def save(self, record: object, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write the part; see `TaskStore.save`."""
        self.store.save(self.name, record, arrays)

    def record(self, kind: type[R]) -> R:
        """Read the record; see `TaskStore.record`."""
        return self.store.record(self.name, kind)

    def load(self, kind: type[R]) -> tuple[R, Arrays]:
        """Read the record and the arrays; see `TaskStore.load`."""
        return self.store.load(self.name, kind)


class BodyStore:
    """The bodies and meshes of one organ in one store.

    Parameters
    ----------
    store : Store
    organ : Organ
    """

    def __init__(self, store: Store, organ: Organ[Any, Any, Any]) -> None:
        self.store = store
        self.organ = organ

    def bring_body(self, spec: Door) -> str:
        """Add the body of a specification to the store if missing, and return its digest.

        Raises
        ------
        InputError
            If the body cannot be made, or is neither a file nor in the store.
        """
        given = self.organ.stored_name(spec)
        if given is not None:
            return self._stored(given, spec)
        files = self.organ.body_files(spec)
        for file in files:
            check_regular(file)
        settings = self.organ.body_settings(spec)
        request = self._request("body", settings, [file_digest(file) for file in files])

        def make() -> str:
            kind = "image" if files else "generated"
            about = {"file": files[0].name} if files else {"settings": settings}
            return self.add(self.organ.make_body(spec), {"kind": kind} | about)

        return self._made(request, self.has_body, make)

    def bring_aligned(self, target: str, reference: str, case: CaseSpec) -> tuple[str, Facts]:
        """Return the digest of a stored target after alignment, and the motion that aligned it."""
        body, motion = self.organ.aligned(self.body(target), self.body(reference), case)
        return self.add(body, {"kind": "image", "motion": dict(motion)}), motion

    def bring_mesh(self, body: str, case: CaseSpec) -> tuple[str, dict[str, Any]]:
        """Add the mesh of a stored body to the store; return its digest and facts about both."""
        request = self._request("mesh", body, self.organ.mesh_settings(case))

        def make() -> str:
            watch = Watch()
            loaded = self.body(body)
            with watch.stage("mesh"):
                mesh = self.organ.make_mesh(loaded, case)
            arrays = self.organ.mesh_to_arrays(mesh)
            name = digest("mesh", body, {key: array_digest(a) for key, a in arrays.items()})
            facts = {**self.organ.facts(loaded, mesh), "seconds": watch.seconds}
            save_mesh(self.store, name, arrays, {"volume": body, "facts": facts})
            return name

        name = self._made(request, lambda made: has_mesh(self.store, made), make)
        return name, load_meta(self.store.layout.mesh(name))["facts"]

    def add(self, body: Any, meta: Mapping[str, Any]) -> str:
        """Store a body under the digest of its content and its origin, image or simulation."""
        name = self._body_digest(body, meta.get("kind") == "image")
        if not self.has_body(name):
            self.save_body(name, body, meta)
        return name

    def has_body(self, name: str) -> bool:
        """Return True if a body is complete in the store."""
        return has_volume(self.store, name)

    def save_body(self, name: str, body: Any, meta: Mapping[str, Any]) -> None:
        """Store a body under a known digest, such as the digest of an evaluation."""
        arrays = self.organ.body_to_arrays(body)
        if isinstance(arrays, Volume):
            save_volume(self.store, name, arrays, meta=meta)
        else:
            save_arrays(self.store.layout.volume(name), arrays, meta)

    def body(self, name: str) -> Any:
        """Return a stored body."""
        return self._cached("body", name, lambda: self._load_body(name))

    def mesh(self, name: str) -> Any:
        """Return a stored mesh."""
        return self._cached(
            "mesh", name, lambda: self.organ.mesh_from_arrays(load_mesh(self.store, name)[0])
        )

    def model(self, name: str) -> Any:
        """Return a stored mesh, prepared for the solver."""
        return self._cached("model", name, lambda: self.organ.prepare(self.mesh(name)))

    def landmarks(self, name: str, case: CaseSpec) -> Any:
        """Return the landmarks of a stored body that a load needs."""
        what = f"landmarks {digest(case.simulated)}"
        return self._cached(what, name, lambda: self.organ.landmarks(self.body(name), case))

    def scorer(self, target: str, spec: ScoreSpec) -> Any:
        """Return a scorer of bodies against a stored target; each thread has its own."""
        what = f"scorer {spec.model_dump_json()} {threading.get_ident()}"
        return self._cached(what, target, lambda: self.organ.scorer(self.body(target), spec))

    def coarse(self, name: str, spacing_mm: float) -> str:
        """Return the digest of a body resampled to coarser voxels; its own if already as coarse."""
        request = self._request("coarse body", name, spacing_mm)

        def make() -> str:
            body = self.body(name)
            coarse = self.organ.coarse(body, spacing_mm)
            if coarse is body:
                return name
            return self.add(coarse, {"kind": volume_meta(self.store, name).get("kind", "image")})

        return self._made(request, self.has_body, make)

    def observation(self, body: str, mesh: str, target: str) -> Any:
        """Return the data of a body and its target needed for residuals."""
        return self._cached(
            f"observation {body} {mesh}",
            target,
            lambda: self.organ.observation(
                self.body(body), self.mesh(mesh), self.body(target), self.imaged(target)
            ),
        )

    def imaged(self, name: str) -> bool:
        """Return True if a stored body comes from an image, False if from a simulation."""
        return volume_meta(self.store, name).get("kind") not in ("simulated", "evaluation")

    def setup(
        self,
        case: CaseSpec,
        prepared: Mapping[str, str],
        target: str | None = None,
        score: ScoreSpec | None = None,
        observed: bool = False,
    ) -> Setup:
        """Return the inputs of an evaluation other than the constants.

        Parameters
        ----------
        case : CaseSpec
        prepared : mapping
            Digests: ``volume`` of the undeformed body and ``mesh``.
        target : str, optional
            Digest of the target body.
        score : ScoreSpec, optional
            Settings of the comparison; without them, nothing is compared.
        observed : bool
            Whether residuals are needed too.
        """
        body, mesh = prepared["volume"], prepared["mesh"]
        imaged = target is not None and self.imaged(target)
        return Setup(
            organ=self.organ,
            case=case,
            body=self.body(body),
            mesh=self.mesh(mesh),
            target=None if target is None else self.body(target),  # now everything is read
            model=self.model(mesh),
            landmarks=self.landmarks(body, case),
            target_landmarks=self.landmarks(target, case) if target and imaged else None,
            scorer=None if target is None or score is None else self.scorer(target, score),
            observation=self.observation(body, mesh, target) if target and observed else None,
            **({} if target is None or score is None else self._objective(target, score)),
        )

    def _objective(self, target: str, score: ScoreSpec) -> dict[str, Any]:
        """Return the objective of a study, and the function that measures a deformed body."""
        objective = objective_named(score.objective)
        make = objective.measure
        if make is None:
            return {"objective": objective}
        what = f"objective {objective.name} {threading.get_ident()}"
        measure = self._cached(what, target, lambda: make(self.body(target)))
        return {"objective": objective, "measure": measure}

    def _stored(self, given: str, spec: Door) -> str:
        name = self._find(given)
        adapted = self.organ.adapt_stored(self.body(name), spec)
        return name if adapted is None else self.add(adapted, {"kind": "image"})

    def _find(self, given: str) -> str:
        """Return the digest of the stored volume with this digest or name."""
        found = find_volume(self.store, given)
        if found is not None:
            return found
        raise InputError(
            f"{given} is neither a file or folder (relative to {Path.cwd()}) nor a volume in "
            f"the store {self.store.root}. Check the path, or import the image first."
        )

    def _load_body(self, name: str) -> Any:
        if "spacing_mm" in volume_meta(self.store, name):
            return self.organ.body_from_arrays(load_volume(self.store, name))
        return self.organ.body_from_arrays(load_arrays(self.store.layout.volume(name))[0])

    def _body_digest(self, body: Any, imaged: bool) -> str:
        arrays = self.organ.body_to_arrays(body)
        kind = "image" if imaged else "volume"
        if isinstance(arrays, Volume):
            place = [list(arrays.spacing_mm), list(arrays.origin_mm), *arrays.frame_facts]
            return digest(kind, array_digest(arrays.values), place)
        return digest(kind, {key: array_digest(a) for key, a in arrays.items()})

    def _request(self, kind: str, *parts: Any) -> str:
        return digest(f"{kind} request", *parts, code_version(*organ_modules(self.organ.name)))

    def _made(self, request: str, has: Callable[[str], bool], make: Callable[[], str]) -> str:
        """Return the digest of the result of a request; compute it unless it is stored."""
        path = self.store.layout.field(request)
        if has_arrays(path):
            name = str(load_meta(path)["made"])
            if has(name):
                return name
        name = make()
        if not has_arrays(path):
            nothing: Arrays = {}
            save_arrays(path, nothing, {"made": name})
        return name

    def _cached(self, kind: str, name: str, make: Callable[[], T]) -> T:
        return CACHE.get((kind, self.organ.name, str(self.store.root), name), make)
