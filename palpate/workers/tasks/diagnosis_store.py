"""The stored parts of a diagnosis, and objects built from them once per process.

::

    source         the scans or measurements; see `workers.tasks.diagnosis_sources`
    preparation    points, body, distances; see `workers.diagnosis.problem.preparation`
    calibration    points kept, noise, constants, derivatives
    sensitivity    columns of one effect in one scan
    joint fit      some effects fitted with the constants
    outcome        the summary, and residuals on the interfaces

The learnt noise of a calibration is converted to arrays and back.

Each process builds the mesh once from the source and the preparations. A process that works alone
makes the preparations itself and does not store them. Every process solves the nominal equilibria
again from rest at the stored constants, so a joint fit does not depend on the process that computes
it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from palpate.storage.errors import StoreError
from palpate.storage.json_digests import digest
from palpate.storage.stored_arrays import Arrays
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.diagnosis.fits.effect_screening import NominalAnalysis
from palpate.workers.diagnosis.fits.effect_sensitivities import ScanSensitivity, joined_sensitivity
from palpate.workers.diagnosis.fits.gauss_newton import Fit, SolvedFit
from palpate.workers.diagnosis.fits.nominal_calibration import with_anchored_scans
from palpate.workers.diagnosis.linearisation import EffectSensitivity
from palpate.workers.diagnosis.noise.noise_components import LearntNoise
from palpate.workers.diagnosis.outcome.diagnosis_source import PreparedSource, Source
from palpate.workers.diagnosis.outcome.diagnosis_summary import Summary
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem, unknowns
from palpate.workers.diagnosis.problem.prepared_parts import Prepared
from palpate.workers.diagnosis.problem.scan_noise import stated_covariance, with_pressed_points
from palpate.workers.diagnosis.problem.scan_prediction import ComparedScan, predict_scan, registered
from palpate.workers.diagnosis.verdict.joint_fit import JointFit
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.mechanics.fem.discretisation import Model
from palpate.workers.organs.source_registry import source_module
from palpate.workers.plugins import foreign_plugins
from palpate.workers.tasks.code_version import code_version
from palpate.workers.tasks.diagnosis_sources import SourceName, stored_source
from palpate.workers.tasks.task_store import Part, TaskStore


def noise_arrays(inverse: InverseProblem) -> Arrays:
    """Return the parts of the learnt noise not determined by the points and the given noise.

    Raises
    ------
    ValueError
        If the problem has not been calibrated.
    """
    learnt = inverse.learnt
    if learnt is None:
        raise ValueError("the noise is only known after the calibration")
    anchors = {"noise_anchors": np.stack(inverse.anchors)} if inverse.anchors else {}
    return {
        **anchors,
        "noise_pressed": np.stack([inverse.followed(scan).pressed for scan in inverse.scans]),
        "noise_fixed": learnt.fixed,
        "noise_numerical": learnt.numerical,
        "noise_scales": learnt.scales,
    }


def with_stored_noise(inverse: InverseProblem, arrays: Arrays) -> InverseProblem:
    """Return a problem, already reduced to its calibrated points, with its stored noise."""
    inverse = with_pressed_points(inverse, list(arrays["noise_pressed"]))
    learnt = LearntNoise(
        stated=stated_covariance(inverse),
        groups=np.tile(inverse.points.interface, len(inverse.scans)),
        fixed=arrays["noise_fixed"],
        numerical=arrays["noise_numerical"],
        scales=arrays["noise_scales"],
    )
    known = replace(inverse, learnt=learnt, covariance=learnt.covariance)
    return (
        with_anchored_scans(known, list(arrays["noise_anchors"])) if inverse.is_segmented else known
    )


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class DiagnosisRequest:
    """Request for a diagnosis: everything a task needs to find the rest in the store.

    Parameters
    ----------
    store : str
        Folder visible to all workers.
    source : SourceName
        The source to diagnose; see `workers.tasks.diagnosis_sources.add_source`.
    nodes : int
        Number of nodes of the mesh.
    spacing_mm : float
        Distance between points on the interfaces.
    effects : tuple of str
        Suspected effects from the source's catalogue.
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
    """Duration of a preparation."""

    seconds: float


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """Result of the nominal fit.

    `points` is the number of points kept on the interfaces, `left_out` the number of points not
    clearly visible in some scan, `scans` the number of scans; `cost` is minus twice the log
    posterior.
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
    """Sensitivity to an effect in one scan, unless it is idle there or cannot be simulated."""

    acts: bool
    idle: bool
    seconds: float


@dataclass(frozen=True, slots=True)
class JointFitRecord:
    """Result of a joint fit; its numbers are None if no starting point could be simulated."""

    simulated: bool
    seconds: float
    log_evidence: float | None = None
    cost: float | None = None
    converged: bool | None = None
    iterations: int | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """A finished diagnosis: its summary, and the names of its loaded scans."""

    summary: Summary
    scans: tuple[str, ...]


def named(request: DiagnosisRequest) -> DiagnosisRequest:
    """Return the request, named after a digest of everything its result depends on."""
    code = diagnosis_code(request.source.kind)
    how = [request.nodes, request.spacing_mm, list(request.effects)]
    return replace(request, name=digest("diagnosis", request.source.digest, *how, code))


def diagnosis_code(kind: str) -> str:
    """Return a digest of all code that a diagnosis of this kind of source depends on."""
    return code_version(
        "palpate.workers.tasks.diagnosis_tasks", source_module(kind), *plugged_modules()
    )


def plugged_modules() -> list[str]:
    """Return the modules of all effects and laws from other distributions.

    A diagnosis may consider any of these effects, and its model may use any of the laws.
    """
    return [p.module for p in foreign_plugins() if p.group in ("effects", "laws")]


class DiagnosisStore:
    """The stored parts of one diagnosis.

    Parameters
    ----------
    request : DiagnosisRequest
        The request, with its name; see `named`.

    Raises
    ------
    StoreError
        If this process derives a different name for the diagnosis.
    """

    def __init__(self, request: DiagnosisRequest) -> None:
        here = named(request).name
        if here != request.name:
            raise StoreError(
                f"The driver and this worker run different versions: they compute the digests "
                f"{request.name} and {here}. `palpate doctor` lists the versions; install the "
                "same one everywhere."
            )
        self.request = request
        self.parts = TaskStore(request.store)

    # The source

    @property
    def source(self) -> Source:
        """The scans or measurements."""
        return stored_source(self.request.source, self.parts)

    @property
    def effects(self) -> list[Effect]:
        """The suspected effects from the catalogue."""
        return [e for e in self.source.effects if e.name in self.request.effects]

    def combination(self, names: Sequence[str]) -> list[Effect]:
        """Return some effects from the catalogue by their names."""
        known = {e.name: e for e in self.effects}
        return [known[name] for name in names]

    @property
    def uncalibrated(self) -> InverseProblem:
        """The body with its scans, before any fit."""
        nodes, spacing_mm = self.request.nodes, self.request.spacing_mm
        return self._cached(
            "uncalibrated",
            lambda: self.source.inverse_problem(nodes, spacing_mm, self.read_prepared),
        )

    def finer(self) -> Model | None:
        """Return a finer mesh of the same body; None if it would add no information."""
        nodes = round(SETTINGS.mesh.finer_ratio * self.request.nodes)
        return self.source.finer(nodes, self.read_prepared)

    @property
    def preparations(self) -> Sequence[str]:
        """Names accepted by `prepare`."""
        source = self.source
        return source.preparations if isinstance(source, PreparedSource) else ()

    def prepare(self, name: str) -> Prepared:
        """Make a preparation, by its name in `workers.diagnosis.problem.prepared_parts`."""
        source = self.source
        if not isinstance(source, PreparedSource):
            raise KeyError(name)
        return source.prepare(name, self.request.spacing_mm)

    def read_prepared(self, name: str) -> Prepared:
        """Return a preparation, from the store or made now."""
        part = self.preparation(name)
        return part.load(PreparationRecord)[1] if part.is_finished else self.prepare(name)

    # The parts

    def preparation(self, name: str) -> Part:
        """Return the part that stores a preparation of the scans, made before any fit."""
        return self._part("preparation", name)

    @property
    def calibration(self) -> Part:
        """The points kept, noise, constants and derivatives."""
        return self._part("calibration")

    def sensitivity(self, effect: str, scan: int) -> Part:
        """Return the sensitivity columns of one effect in one scan."""
        return self._part("sensitivity", effect, scan)

    def joint_fit(self, effects: Sequence[str]) -> Part:
        """Return the joint fit of some effects."""
        return self._part("joint fit", *effects)

    @property
    def outcome(self) -> Part:
        """The summary, and residuals on the interfaces."""
        return self._part("outcome")

    # Objects built from the parts

    @property
    def inverse(self) -> InverseProblem:
        """The body with the points of the calibration and the estimated noise."""
        return self._cached("inverse", self._inverse)

    @property
    def nominal(self) -> SolvedFit:
        """The nominal fit, with its equilibria solved from rest."""
        return self._cached("nominal", self._nominal)

    @property
    def analysis(self) -> NominalAnalysis:
        """The nominal fit (see `nominal`) with the sensitivities of all effects."""
        nominal = self.nominal
        return self._cached("analysis", lambda: self._analysis(nominal))

    def has_joint_fit(self, effects: Sequence[Effect]) -> bool:
        """Return True if a joint fit has finished."""
        return self.joint_fit([e.name for e in effects]).is_finished

    def load_joint_fit(self, effects: Sequence[Effect]) -> JointFit | None:
        """Return a stored joint fit; None if no starting point could be simulated."""
        record, arrays = self.joint_fit([e.name for e in effects]).load(JointFitRecord)
        if record.log_evidence is None:
            return None
        stacks = (arrays[key] for key in ("points", "residual", "normals"))
        scans = tuple(ComparedScan(*slices) for slices in zip(*stacks, strict=True))
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

    def save_joint_fit(
        self, effects: Sequence[str], fitted: JointFit | None, seconds: float
    ) -> None:
        """Save a joint fit; None means that no starting point could be simulated."""
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

    def _inverse(self) -> InverseProblem:
        _, arrays = self.calibration.load(CalibrationRecord)
        kept = self.uncalibrated.keeping(arrays["kept"])
        return with_stored_noise(replace(kept, bias=arrays["bias"]), arrays)

    def _nominal(self) -> SolvedFit:
        record, arrays = self.calibration.load(CalibrationRecord)
        inverse, z = self.inverse, arrays["z"]
        free = unknowns(inverse.free, [])
        predicted = [predict_scan(inverse, scan, free, z, None) for scan in inverse.scans]
        solved = tuple(prediction for prediction in predicted if prediction is not None)
        if len(solved) < len(predicted):
            raise StoreError(
                "The calibrated constants were not solved again from rest. Remove "
                f"{self.calibration.path} and run the diagnosis again."
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
        return NominalAnalysis(self.inverse, nominal, [one for one in found if one is not None])

    def _joined(self, effect: Effect) -> EffectSensitivity | None:
        scans = []
        for number in range(len(self.inverse.scans)):
            record, arrays = self.sensitivity(effect.name, number).load(SensitivityRecord)
            scans.append(ScanSensitivity(arrays.get("columns"), record.idle))
        return joined_sensitivity(effect, scans)

    def _part(self, kind: str, *which: str | int) -> Part:
        return Part(self.parts, digest("diagnosis", self.request.name, kind, *which))

    def _cached(self, what: str, make: Callable[[], T]) -> T:
        return self.parts.cached(("diagnosis", self.request.name, what), make)
