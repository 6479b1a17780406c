"""What the store holds of a diagnosis, and what a process makes of it once.

::

    fields/<digest>.zarr     calibration   points kept, noise, constants, derivatives
                             print         columns of one effect in one scan
                             threshold     of the alarm
                             refit         of some effects
                             verdict       the summary, and residuals on the interfaces

A group is written whole or not at all, so what has its name is finished. The body,
its mesh and its distance maps come from the folder of the case; a process builds
them once. The nominal equilibria are solved again from rest at the stored constants,
in every process alike: what a refit finds does not depend on who computes it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, TypeVar, cast

import numpy as np

from storage.arrays import Arrays, Meta, exists, load_arrays, load_meta, save_arrays
from storage.digest import digest, file_digest
from storage.errors import StoreError
from storage.stores import open_store
from storage.values import FloatArray
from workers.cases.source import Source
from workers.diagnosis.fit import Fit
from workers.diagnosis.refit import Refit
from workers.diagnosis.subject import Subject, unknowns
from workers.diagnosis.views import View, view
from workers.effects.base import Effect
from workers.fem.model import Model
from workers.fem.solve import Equilibrium
from workers.library import code_version
from workers.resources import CACHE
from workers.sources import open_source

ROOMS = (
    "cases", "diagnosis", "effects", "fem", "images", "imaging", "materials", "mesh",
    "observation", "organs", "pictures", "similarity", "specimen",
)  # fmt: skip
# Nodes of the mesh that says what the working mesh gets wrong, over those of that one.
FINER = 2.8


T = TypeVar("T")
Modes = list[list[Any]]


class Request(TypedDict):
    """What is asked of a diagnosis, small enough to travel.

    ``store`` and ``source`` are absolute paths that all workers see; ``spacing_mm`` lies
    between points on the interfaces; ``effects`` are names of the source's catalogue.
    """

    store: str
    source: str
    nodes: int
    spacing_mm: float
    effects: list[str]
    name: str


def named(request: Request) -> Request:
    """The request under the name of all that its result depends on, the code included.

    Only the files that the source names count.

    Raises
    ------
    InputError
        If the source cannot be diagnosed.
    """
    content = [file_digest(file) for file in _source(Path(request["source"])).files]
    how = [request["nodes"], request["spacing_mm"], FINER, request["effects"]]
    name = digest("diagnosis", content, *how, code_version(*ROOMS))
    return {**request, "name": name}


class Casebook:
    """One diagnosis in its store.

    Parameters
    ----------
    request : Request
        With its name; see `named`.

    Raises
    ------
    StoreError
        If this process would give it another name.
    """

    def __init__(self, request: Request) -> None:
        self.request = request
        self.name = request["name"]
        here = named(request)["name"]
        if here != self.name:
            raise StoreError(
                f"The driver calls this diagnosis {self.name}, this worker {here}: they see "
                "other files of the case or run different versions. `palpate doctor` shows which; "
                "install the same everywhere and give a folder that all workers share."
            )
        self.store = open_store(request["store"])

    @property
    def source(self) -> Source:
        """What was imaged or measured."""
        return _source(Path(self.request["source"]))

    @property
    def effects(self) -> list[Effect]:
        """The part of the catalogue that is suspected."""
        asked = set(self.request["effects"])
        return [e for e in self.source.effects if e.name in asked]

    def effect(self, name: str) -> Effect:
        """One of them."""
        return next(e for e in self.effects if e.name == name)

    def path(self, kind: str, *which: Any) -> Path:
        """Where a part of the diagnosis lies."""
        return self.store.layout.field(digest("diagnosis", self.name, kind, *which))

    def has(self, kind: str, *which: Any) -> bool:
        """Whether a part is finished."""
        return exists(self.path(kind, *which))

    def load(self, kind: str, *which: Any) -> tuple[Arrays, Meta]:
        """A finished part."""
        return load_arrays(self.path(kind, *which))

    def told(self, kind: str, *which: Any) -> Meta:
        """What is said of a finished part, without its arrays."""
        return load_meta(self.path(kind, *which))

    def save(self, arrays: Arrays, meta: Meta, kind: str, *which: Any) -> None:
        """Keep a part that is finished."""
        save_arrays(self.path(kind, *which), arrays, meta)

    def cached(self, what: str, make: Callable[[], T]) -> T:
        """A value that this process makes once."""
        return CACHE.get(("diagnosis", str(self.store.root), self.name, what), make)

    @property
    def built(self) -> Subject:
        """The body with its scans, before any fit."""
        nodes, spacing = self.request["nodes"], self.request["spacing_mm"]
        return self.cached("built", lambda: self.source.subject(nodes, spacing))

    def finer(self) -> Model | None:
        """A finer mesh of the same body; None where it would tell nothing new."""
        return self.source.finer(round(FINER * self.request["nodes"]))

    @property
    def subject(self) -> Subject:
        """The body with the points and the noise of the calibration."""
        return self.cached("subject", self._subject)

    @property
    def nominal(self) -> Fit:
        """The nominal fit, its equilibria solved from rest, and as if nobody had used them.

        A level remembers its stiffest mode from one tangent to the next, which would make
        the last digits of a task depend on those before it.
        """
        fit, modes = self.cached("nominal", self._nominal)
        for solved, kept in zip(fit.views, modes, strict=True):
            for level, mode in zip(solved.at.levels, kept, strict=True):
                level.stiffest_mode = mode
        return fit

    def _subject(self) -> Subject:
        arrays, _ = self.load("calibration")
        kept = self.built.keeping(arrays["kept"])
        return replace(kept, covariance=arrays["covariance"], bias=arrays["bias"])

    def _nominal(self) -> tuple[Fit, Modes]:
        arrays, told = self.load("calibration")
        subject, z = self.subject, arrays["z"]
        free = unknowns(subject.free, [])
        views = [view(subject, scan, free, z, None) for scan in subject.scans]
        solved = [v for v in views if v is not None]
        if len(solved) < len(views):
            raise StoreError(
                f"The calibrated constants of {self.request['source']} were not solved again from "
                f"rest. Remove {self.path('calibration')} and run the diagnosis again."
            )
        modes = [[level.stiffest_mode for level in v.at.levels] for v in solved]
        return _fit(free.effects, subject, z, solved, arrays["jacobian"], told), modes

    def keep_refit(self, names: Sequence[str], found: Refit | None, seconds: float) -> None:
        """Store a refit; None says that no start could be simulated."""
        if found is None:
            self.save({}, {"found": False, "seconds": seconds}, "refit", list(names))
            return
        fit = found.fit
        arrays = {"z": fit.z, "jacobian": fit.jacobian}
        arrays["residual"] = np.stack([v.residual for v in fit.views])
        arrays["normals"] = np.stack([v.normals for v in fit.views])
        arrays["points"] = np.stack([v.points for v in fit.views])
        told = {
            "found": True,
            "log_evidence": found.log_evidence,
            "cost": fit.cost,
            "converged": fit.converged,
            "iterations": fit.iterations,
            "seconds": seconds,
        }
        self.save(arrays, told, "refit", list(names))

    def refit(self, effects: Sequence[Effect]) -> Refit | None:
        """A stored refit; None if no start could be simulated."""
        arrays, told = self.load("refit", [e.name for e in effects])
        if not told["found"]:
            return None
        # How the bodies were solved is not kept: what weighs asks for residuals only.
        at = cast(Equilibrium, None)
        stacks = (arrays[key] for key in ("points", "residual", "normals"))
        views = [View(at, *one) for one in zip(*stacks, strict=True)]
        fit = _fit(effects, self.subject, arrays["z"], views, arrays["jacobian"], told)
        return Refit(tuple(effects), fit, told["log_evidence"])


def _fit(
    effects: Sequence[Effect],
    subject: Subject,
    z: FloatArray,
    views: Sequence[View],
    jacobian: FloatArray,
    told: Meta,
) -> Fit:
    return Fit(
        unknowns(subject.free, effects),
        z,
        tuple(views),
        jacobian,
        told["cost"],
        told["converged"],
        told["iterations"],
    )


def _source(path: Path) -> Source:
    """Opened once, and again if a file has changed."""
    return CACHE.get(("source", str(path), *_stamps(path)), lambda: open_source(path))


def _stamps(path: Path) -> list[tuple[str, int, int]]:
    """Name, time and size of the files there, none of which is opened."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    stats = [(file.name, file.stat()) for file in files if file.is_file()]
    return [(name, stat.st_mtime_ns, stat.st_size) for name, stat in stats]
