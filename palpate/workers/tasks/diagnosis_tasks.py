"""Dask tasks of a diagnosis: a small request in, a small record out.

::

    prepare_scan       a case               > points, body, shapes or distances in the store
    calibrate_nominal  a case               > constants, points and noise in the store
    analyse_effect     one effect, one scan > its change in the residuals
    fit_effects        up to three effects  > the most probable constants and magnitudes
    weigh_hypotheses   all of these         > the fits still missing, or the outcome

Every task is idempotent: stored results are not computed again. A request names digests, so
workers need only the store; its contents are described in `workers.tasks.diagnosis_store`.
Nothing depends on which process runs which task.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from distributed import get_worker

from palpate.storage.stored_arrays import Arrays
from palpate.storage.values import BoolArray
from palpate.workers.comparison.observation.interface_residual import InterfacePoints
from palpate.workers.diagnosis.fits.effect_sensitivities import scan_sensitivity
from palpate.workers.diagnosis.fits.gauss_newton import Listener, SolvedFit, heard_by
from palpate.workers.diagnosis.fits.nominal_calibration import calibrate
from palpate.workers.diagnosis.outcome.body_pictures import Displacements
from palpate.workers.diagnosis.outcome.summarising import summarise
from palpate.workers.diagnosis.problem.inverse_problem import InverseProblem
from palpate.workers.diagnosis.problem.scan_prediction import predict_scan
from palpate.workers.diagnosis.verdict.diagnosis_course import (
    Course,
    Diagnosis,
    advance,
    base_of,
    diagnose,
)
from palpate.workers.diagnosis.verdict.joint_fit import fit_jointly
from palpate.workers.kernels_and_threads import Each, scan_threads
from palpate.workers.tasks.diagnosis_store import (
    CalibrationRecord,
    DiagnosisRequest,
    DiagnosisStore,
    JointFitRecord,
    Outcome,
    PreparationRecord,
    SensitivityRecord,
    noise_arrays,
)
from palpate.workers.tasks.task_store import Part


@dataclass(frozen=True, slots=True)
class WeighingRecord:
    """The parts of a diagnosis that are still missing.

    Parameters
    ----------
    wanted : tuple of tuple of str
        Joint fits, by the names of their effects.
    """

    wanted: tuple[tuple[str, ...], ...] = ()

    @property
    def is_open(self) -> bool:
        """True if anything is missing."""
        return bool(self.wanted)


def prepare_scan(request: DiagnosisRequest, name: str) -> PreparationRecord:
    """Make one preparation named in `prepared_parts`, for all processes."""
    store = DiagnosisStore(request)
    part = store.preparation(name)
    if not part.is_finished:
        begun = time.perf_counter()
        arrays = store.prepare(name)
        part.save(PreparationRecord(time.perf_counter() - begun), arrays)
    return part.record(PreparationRecord)


def calibrate_nominal(request: DiagnosisRequest, threads: int = 1) -> CalibrationRecord:
    """Find the nominal constants, the reliable points and their noise.

    Parameters
    ----------
    request : DiagnosisRequest
        See `workers.tasks.diagnosis_store.named`.
    threads : int
        Number of threads that would otherwise be idle.

    Raises
    ------
    InputError
        If the nominal model cannot be simulated.
    """
    store = DiagnosisStore(request)
    part = store.calibration
    if not part.is_finished:
        begun = time.perf_counter()
        whole = store.uncalibrated
        with scan_threads(threads) as each, heard_by(announcer(request, "")):
            inverse, fit = calibrate(whole, store.finer(), each)
        points = {"kept": kept_of(whole.points, inverse.points), "bias": inverse.bias}
        _save_calibration(part, inverse, fit, points, time.perf_counter() - begun)
    return part.record(CalibrationRecord)


def _save_calibration(
    part: Part, inverse: InverseProblem, fit: SolvedFit, arrays: Arrays, seconds: float
) -> None:
    """Save the constants and the noise that was learnt at them."""
    record = CalibrationRecord(
        points=len(inverse.points),
        left_out=inverse.left_out,
        constants={
            f.unit.name_at_door(f.name): f.unit.to_door(fit.values()[f.name]) for f in inverse.free
        },
        scans=len(inverse.scans),
        cost=fit.cost,
        converged=fit.converged,
        iterations=fit.iterations,
        seconds=seconds,
    )
    fit_arrays = {"z": fit.z, "jacobian": fit.jacobian}
    part.save(record, arrays | fit_arrays | noise_arrays(inverse))


def analyse_effect(request: DiagnosisRequest, effect: str, scan: int) -> SensitivityRecord:
    """Compute the change in the residuals of one scan due to one effect."""
    store = DiagnosisStore(request)
    part = store.sensitivity(effect, scan)
    if not part.is_finished:
        begun = time.perf_counter()
        (suspect,) = store.combination([effect])
        sensitivity = scan_sensitivity(store.inverse, store.nominal, scan, suspect)
        arrays = {} if sensitivity.columns is None else {"columns": sensitivity.columns}
        spent = time.perf_counter() - begun
        part.save(
            SensitivityRecord(sensitivity.columns is not None, sensitivity.idle, spent), arrays
        )
    return part.record(SensitivityRecord)


def fit_effects(
    request: DiagnosisRequest, effects: tuple[str, ...], threads: int = 1
) -> JointFitRecord:
    """Fit the constants and the parameters of up to three effects.

    Parameters
    ----------
    request : DiagnosisRequest
    effects : tuple of str
    threads : int
        Number of threads that would otherwise be idle.
    """
    store = DiagnosisStore(request)
    part = store.joint_fit(effects)
    if not part.is_finished:
        begun = time.perf_counter()
        wanted = store.combination(effects)
        first = store.combination(base_of(wanted))
        base = store.load_joint_fit(first) if first and store.has_joint_fit(first) else None
        about = announcer(request, " with ".join(effects))
        with scan_threads(threads) as each, heard_by(about):
            fitted = fit_jointly(store.analysis, wanted, each, base)
        store.save_joint_fit(effects, fitted, time.perf_counter() - begun)
    return part.record(JointFitRecord)


def fit_topic(request: DiagnosisRequest) -> str:
    """Return the topic of the cluster's events on iterations: the fit and its iteration."""
    return f"palpate-fit-{request.name}"


def announcer(request: DiagnosisRequest, fit: str) -> Listener:
    """Return a listener that sends the iterations of a fit to whoever subscribes to its topic.

    Outside a worker of a cluster it does nothing.
    """

    def announce(iteration: int) -> None:
        try:
            worker = get_worker()
        except ValueError:
            return
        worker.log_event(fit_topic(request), {"fit": fit, "iteration": iteration})

    return announce


def weigh_hypotheses(request: DiagnosisRequest, threads: int = 1) -> WeighingRecord:
    """Advance the diagnosis as far as the stored parts allow.

    If nothing is missing, the diagnosis ends; its outcome is stored with the residuals on the
    interfaces. `threads` is the number of threads that would otherwise be idle.
    """
    store = DiagnosisStore(request)
    part = store.outcome
    if part.is_finished:
        return WeighingRecord()
    reached = replay(store, diagnose(store.analysis, store.effects))
    if isinstance(reached, WeighingRecord):
        return reached
    summary = summarise(reached, store.effects, store.source.name)
    with scan_threads(threads) as each:
        displacements = model_displacements(reached, each)
        drawn, summary = store.source.describe(
            reached, displacements, summary, store.read_prepared, each
        )
    part.save(Outcome(summary, tuple(store.source.scans)), residual_maps(reached) | drawn)
    return WeighingRecord()


def replay(store: DiagnosisStore, course: Course) -> Diagnosis | WeighingRecord:
    """Run a diagnosis on its stored parts; return it, or the first missing parts."""
    reached = advance(course)
    while not isinstance(reached, Diagnosis):
        missing = [combination for combination in reached if not store.has_joint_fit(combination)]
        if missing:
            names = tuple(tuple(e.name for e in effects) for effects in missing)
            return WeighingRecord(names)
        reached = advance(course, [store.load_joint_fit(effects) for effects in reached])
    return reached


def model_displacements(diagnosis: Diagnosis, each: Each) -> Displacements:
    """Return nodal displacements of the nominal model and, if any, of the best joint fit.

    Only the points of a joint fit are stored, so the body is solved once more.
    """
    inverse, nominal = diagnosis.analysis.inverse, diagnosis.analysis.nominal
    displacements = {
        "before": [prediction.at.solution.displacement_mm for prediction in nominal.predictions]
    }
    if diagnosis.best is not None:
        fit = diagnosis.best.fit
        again = list(
            each(
                lambda scan, one: predict_scan(inverse, scan, fit.unknowns, fit.z, one.at),
                inverse.scans,
                nominal.predictions,
            )
        )
        solved = [
            prediction.at.solution.displacement_mm for prediction in again if prediction is not None
        ]
        if len(solved) == len(again):
            displacements["after"] = solved
    return displacements


def residual_maps(diagnosis: Diagnosis) -> Arrays:
    """Return residuals on the interfaces, (scans, points) in mm, before and after.

    The result also contains their noise, the displaced points ``moved_``, and the observed normals
    at these points.
    """
    analysis = diagnosis.analysis
    inverse, nominal = analysis.inverse, analysis.nominal
    shape = (len(inverse.scans), len(inverse.points))
    noise = np.sqrt((analysis.linear.covariance_factor**2).sum(axis=1))
    maps = {
        "points": inverse.points.points,
        "interface": inverse.points.interface,
        "before": analysis.linear.residual.reshape(shape),
        "noise": noise.reshape(shape),
        "moved_before": np.stack([prediction.points for prediction in nominal.predictions]),
        "normals_before": np.stack([prediction.normals for prediction in nominal.predictions]),
    }
    if diagnosis.best is not None:
        fit = diagnosis.best.fit
        maps["after"] = fit.residual(inverse).reshape(shape)
        maps["moved_after"] = np.stack([prediction.points for prediction in fit.predictions])
        maps["normals_after"] = np.stack([prediction.normals for prediction in fit.predictions])
    return maps


def kept_of(before: InterfacePoints, after: InterfacePoints) -> BoolArray:
    """Return a mask of the points of `before` that are still in `after`, shape (k,).

    Raises
    ------
    ValueError
        If `after` is not a subset of `before`, in its order.
    """
    rows = {(int(i), *p): n for n, (i, p) in enumerate(_rows(before))}
    index = np.array([rows[(int(i), *p)] for i, p in _rows(after)], dtype=np.intp)
    if (np.diff(index) <= 0).any():
        raise ValueError("calibration must keep the points in order")
    kept = np.zeros(len(before), np.bool_)
    kept[index] = True
    return kept


def _rows(points: InterfacePoints) -> Iterable[tuple[int, Sequence[float]]]:
    return zip(points.interface.tolist(), points.points.tolist(), strict=True)
