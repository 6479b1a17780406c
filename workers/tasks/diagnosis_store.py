"""What the store holds of a diagnosis, and what a process makes of it once.

::

    source         what was imaged or measured; see `workers.tasks.sources`
    preparation    points, body, distances; see `workers.diagnosis.problem.preparation`
    calibration    points kept, noise, constants, derivatives
    sensitivity    columns of one effect in one scan
    joint fit      of some effects with the constants
    reading        noise, constants and derivatives, read again where an effect puts the points
    outcome        the summary, and residuals on the interfaces

The mesh is made from the source and the preparations; a process builds it once. A process that
works alone makes the preparations for itself, and keeps none.
The nominal equilibria are solved again from rest at the stored constants, those of another
reading of the noise from there, in every process alike: what a joint fit finds does not depend on
who computes it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from palpate.storage.digest import digest
from palpate.storage.errors import StoreError
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.fits.gauss_newton import Fit, SolvedFit
from palpate.workers.diagnosis.fits.sensitivity_analysis import ScanSensitivity, joined_sensitivity
from palpate.workers.diagnosis.outcome.source import PreparedSource, Source
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem, unknowns
from palpate.workers.diagnosis.problem.preparation import Prepared
from palpate.workers.diagnosis.problem.scan_poses import registered
from palpate.workers.diagnosis.problem.scan_prediction import ComparedScan, predict_scan
from palpate.workers.diagnosis.schema.summary import Summary
from palpate.workers.diagnosis.screening.nominal_analysis import NominalAnalysis
from palpate.workers.diagnosis.settings.values import SETTINGS
from palpate.workers.diagnosis.verdict.joint_fit import JointFit
from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.mechanics.fem.elements.model import Model
from palpate.workers.mechanics.fem.equilibrium.solve import Equilibrium
from palpate.workers.organs.source_registry import source_module
from palpate.workers.plugins import foreign_plugins
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.learnt_noise import with_stored_noise
from palpate.workers.tasks.sources import SourceName, stored_source
from palpate.workers.tasks.task_store import Part, TaskStore

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class DiagnosisRequest:
    """What is asked of a diagnosis: all that a task needs to find the rest in the store.

    Parameters
    ----------
    store : str
        Folder that all workers see.
    source : SourceName
        What is diagnosed; see `workers.tasks.sources.add_source`.
    nodes : int
        Of the mesh.
    spacing_mm : float
        Between points on the interfaces.
    effects : tuple of str
        Those of the source's catalogue that are suspected.
    name : str
        Digest of all of these and of the code; see `named`.
    """

    store: str
    source: SourceName
    nodes: int
    spacing_mm: float
    effects: tuple[str, ...]
    name: str = ""


@dataclass(frozen=True, slots=True)
class PreparationRecord:
    """How long it took."""

    seconds: float


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """What the nominal fit has found.

    `points` are kept on the interfaces, `left_out` are those that some scan does not show clearly,
    `scans` is the number of scans; `cost` is minus twice the log posterior.
    """

    points: int
    left_out: int
    constants: Mapping[str, float]
    scans: int
    cost: float
    converged: bool
    iterations: int
    seconds: float


@dataclass(frozen=True, slots=True)
class SensitivityRecord:
    """Whether an effect acts on a scan and could be simulated, or does nothing there."""

    acts: bool
    idle: bool
    seconds: float


@dataclass(frozen=True, slots=True)
class JointFitRecord:
    """How a joint fit has ended; without numbers if no start could be simulated."""

    simulated: bool
    seconds: float
    log_evidence: float | None = None
    cost: float | None = None
    converged: bool | None = None
    iterations: int | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """A diagnosis that has ended: its summary, and the names of its loaded scans."""

    summary: Summary
    scans: tuple[str, ...]


def named(request: DiagnosisRequest) -> DiagnosisRequest:
    """Return the request under the digest of all that its result depends on, code included."""
    code = diagnosis_code(request.source.kind)
    how = [request.nodes, request.spacing_mm, list(request.effects)]
    return replace(request, name=digest("diagnosis", request.source.digest, *how, code))


def diagnosis_code(kind: str) -> str:
    """Return a digest of all source code that a diagnosis of a kind of source depends on."""
    return code_version("palpate.workers.tasks.diagnosis", source_module(kind), *plugged_modules())


def plugged_modules() -> list[str]:
    """Return the modules of all effects and laws of other distributions.

    A diagnosis may suspect the effects; its model may have the laws.
    """
    return [p.module for p in foreign_plugins() if p.group in ("effects", "laws")]


class DiagnosisStore:
    """One diagnosis in its store.

    Parameters
    ----------
    request : DiagnosisRequest
        With its name; see `named`.
    read_at : tuple of str
        Effects at whose joint fit the noise is read; none where the nominal model puts the
        points. What the store has of joint fits is that under this reading.

    Raises
    ------
    StoreError
        If this process would give it another name.
    """

    def __init__(self, request: DiagnosisRequest, read_at: Sequence[str] = ()) -> None:
        here = named(request).name
        if here != request.name:
            raise StoreError(
                f"The driver calls this diagnosis {request.name}, this worker {here}: they run "
                "different versions. `palpate doctor` shows which; install the same everywhere."
            )
        self.request, self.read_at = request, tuple(read_at)
        self.parts = TaskStore(request.store)

    def read_again_at(self, effects: Sequence[str]) -> "DiagnosisStore":
        """Return the same diagnosis with the noise read where a joint fit puts the points."""
        return DiagnosisStore(self.request, effects)

    # What was diagnosed

    @property
    def source(self) -> Source:
        """What was imaged or measured."""
        return stored_source(self.request.source, self.parts)

    @property
    def effects(self) -> list[Effect]:
        """The part of the catalogue that is suspected."""
        return [e for e in self.source.effects if e.name in self.request.effects]

    def combination(self, names: Sequence[str]) -> list[Effect]:
        """Return some effects of the catalogue by their names."""
        known = {e.name: e for e in self.effects}
        return [known[name] for name in names]

    @property
    def uncalibrated(self) -> InverseProblem:
        """The body with its scans, before any fit."""
        if self.read_at:
            return self._first.uncalibrated
        nodes, spacing_mm = self.request.nodes, self.request.spacing_mm
        return self._cached(
            "uncalibrated",
            lambda: self.source.inverse_problem(nodes, spacing_mm, self.read_prepared),
        )

    def finer(self) -> Model | None:
        """Return a finer mesh of the same body; None where it would tell nothing new."""
        nodes = round(SETTINGS.mesh.finer_ratio * self.request.nodes)
        return self.source.finer(nodes, self.read_prepared)

    @property
    def preparations(self) -> Sequence[str]:
        """Names of what `prepare` can make."""
        source = self.source
        return source.preparations if isinstance(source, PreparedSource) else ()

    def prepare(self, name: str) -> Prepared:
        """Make what has this name in `workers.diagnosis.problem.preparation`."""
        source = self.source
        if not isinstance(source, PreparedSource):
            raise KeyError(name)
        return source.prepare(name, self.request.spacing_mm)

    def read_prepared(self, name: str) -> Prepared:
        """Return what has this name, from the store or made now."""
        part = self.preparation(name)
        return part.load(PreparationRecord)[1] if part.is_finished else self.prepare(name)

    # The parts

    def preparation(self, name: str) -> Part:
        """Return what is made of the scans before anything is fitted."""
        return self._part("preparation", name)

    @property
    def calibration(self) -> Part:
        """Points kept, noise, constants and derivatives."""
        return self._part("calibration")

    def sensitivity(self, effect: str, scan: int) -> Part:
        """Return columns of one effect in one scan."""
        return self._part("sensitivity", effect, scan)

    @property
    def reading(self) -> Part:
        """Noise, constants and derivatives; those of the calibration unless read again."""
        return self._part("reading", *self.read_at) if self.read_at else self.calibration

    def joint_fit(self, effects: Sequence[str]) -> Part:
        """Return the joint fit of some effects."""
        return self._part("joint fit", " ".join(self.read_at), *effects)

    @property
    def outcome(self) -> Part:
        """The summary, and residuals on the interfaces."""
        return self._part("outcome")

    # What they are together

    @property
    def inverse(self) -> InverseProblem:
        """The body with the points of the calibration and the noise as it was read."""
        return self._cached("inverse", self._inverse)

    @property
    def nominal(self) -> SolvedFit:
        """The nominal fit, its equilibria solved from rest."""
        return self._cached("nominal", self._nominal)

    @property
    def analysis(self) -> NominalAnalysis:
        """The nominal fit, see `nominal`, with the sensitivities of all effects."""
        nominal = self.nominal
        return self._cached("analysis", lambda: self._analysis(nominal))

    def has_joint_fit(self, effects: Sequence[Effect]) -> bool:
        """Return whether a joint fit has ended."""
        return self.joint_fit([e.name for e in effects]).is_finished

    def load_joint_fit(self, effects: Sequence[Effect]) -> JointFit | None:
        """Return a stored joint fit; None if no start could be simulated."""
        record, arrays = self.joint_fit([e.name for e in effects]).load(JointFitRecord)
        if record.log_evidence is None:
            return None
        stacks = (arrays[key] for key in ("points", "residual", "normals"))
        scans = tuple(ComparedScan(*one) for one in zip(*stacks, strict=True))
        fit = Fit(
            unknowns=unknowns(self.inverse.free, effects),
            z=arrays["z"],
            predictions=scans,
            jacobian=arrays["jacobian"],
            cost=record.cost or 0.0,
            converged=bool(record.converged),
            iterations=record.iterations or 0,
        )
        return JointFit(tuple(effects), fit, record.log_evidence)

    def single_fits(self) -> list[JointFit]:
        """Return all single effects that were fitted under the first reading."""
        stored = [[e] for e in self.effects if self._first.has_joint_fit([e])]
        found = [self._first.load_joint_fit(one) for one in stored]
        return [one for one in found if one is not None]

    def save_joint_fit(
        self, effects: Sequence[str], fitted: JointFit | None, seconds: float
    ) -> None:
        """Keep a joint fit; None says that no start could be simulated."""
        part = self.joint_fit(effects)
        if fitted is None:
            part.save(JointFitRecord(False, seconds), {})
            return
        fit = fitted.fit
        arrays = {
            "z": fit.z,
            "jacobian": fit.jacobian,
            "residual": np.stack([scan.residual for scan in fit.predictions]),
            "normals": np.stack([scan.normals for scan in fit.predictions]),
            "points": np.stack([scan.points for scan in fit.predictions]),
        }
        record = JointFitRecord(
            True, seconds, fitted.log_evidence, fit.cost, fit.converged, fit.iterations
        )
        part.save(record, arrays)

    @property
    def _first(self) -> "DiagnosisStore":
        """The same diagnosis with the noise read where the nominal model puts the points."""
        return DiagnosisStore(self.request)

    def _inverse(self) -> InverseProblem:
        _, points = self.calibration.load(CalibrationRecord)
        _, noise = self.reading.load(CalibrationRecord)
        kept = self.uncalibrated.keeping(points["kept"])
        return with_stored_noise(replace(kept, bias=points["bias"]), noise)

    def _nominal(self) -> SolvedFit:
        record, arrays = self.reading.load(CalibrationRecord)
        inverse, z = self.inverse, arrays["z"]
        free = unknowns(inverse.free, [])
        rest: Sequence[Equilibrium | None] = [None] * len(inverse.scans)
        starts = self._first.nominal.starts() if self.read_at else rest
        predicted = [
            predict_scan(inverse, scan, free, z, start)
            for scan, start in zip(inverse.scans, starts, strict=True)
        ]
        solved = tuple(one for one in predicted if one is not None)
        if len(solved) < len(predicted):
            raise StoreError(
                "The calibrated constants were not solved again from rest. Remove "
                f"{self.reading.path} and run the diagnosis again."
            )
        return SolvedFit(
            unknowns=free,
            z=z,
            predictions=registered(inverse, free, z, solved),
            jacobian=arrays["jacobian"],
            cost=record.cost,
            converged=record.converged,
            iterations=record.iterations,
        )

    def _analysis(self, nominal: SolvedFit) -> NominalAnalysis:
        found = [self._joined(effect) for effect in self.effects]
        begun = {one.names[0]: one.fit.values() for one in self.single_fits()}
        return NominalAnalysis(
            self.inverse,
            nominal,
            [one for one in found if one is not None],
            begun if self.read_at else {},
        )

    def _joined(self, effect: Effect) -> EffectSensitivity | None:
        scans = []
        for number in range(len(self.inverse.scans)):
            record, arrays = self.sensitivity(effect.name, number).load(SensitivityRecord)
            scans.append(ScanSensitivity(arrays.get("columns"), record.idle))
        return joined_sensitivity(effect, scans)

    def _part(self, kind: str, *which: str | int) -> Part:
        return Part(self.parts, digest("diagnosis", self.request.name, kind, *which))

    def _cached(self, what: str, make: Callable[[], T]) -> T:
        return self.parts.cached(("diagnosis", self.request.name, self.read_at, what), make)
