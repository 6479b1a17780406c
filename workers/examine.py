"""What a diagnosis sends to Dask: a small record in, a small record out.

::

    build_case         a case               > nothing: this process has its meshes and maps
    calibrate_case     a case               > constants, points and noise in the store
    print_effect       one effect, one scan > what it would do to the residuals
    refit_effects      one effect or a pair > the most probable constants and magnitudes
    weigh_case         all of these         > the refits still wanted, or the verdict

Every task is idempotent: what the store has is not made again. `workers.casebook`
knows what lies where. Nothing depends on which process runs which task.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from storage.values import BoolArray, FloatArray
from workers.casebook import Casebook, Request
from workers.diagnosis.calibrate import calibrate
from workers.diagnosis.diagnosis import (
    Diagnosis,
    Look,
    RefitMany,
    diagnose,
    discrepancy_of,
    threshold_of,
)
from workers.diagnosis.fingerprint import Fingerprint
from workers.diagnosis.fingerprints import acts, fingerprints, grid
from workers.diagnosis.refit import Refit, refit
from workers.diagnosis.screen import screen
from workers.diagnosis.subject import Subject
from workers.diagnosis.summary import summary
from workers.diagnosis.views import view
from workers.effects.base import Effect
from workers.observation.interface import InterfacePoints

Record = dict[str, Any]


def build_case(request: Request) -> Record:
    """Make what every task of a case needs, while another process calibrates it.

    Returns
    -------
    dict
        ``points``, how many the interfaces carry.
    """
    return {"points": len(Casebook(request).built.points)}


def calibrate_case(request: Request) -> Record:
    """Find the nominal constants, the points that can be trusted and their noise.

    Parameters
    ----------
    request : Request
        See `workers.casebook.named`.

    Returns
    -------
    dict
        ``points``, how many are kept; ``constants_kpa``; ``scans``, how many; ``seconds``.

    Raises
    ------
    InputError
        If the nominal model cannot be simulated.
    """
    book = Casebook(request)
    if not book.has("calibration"):
        begun = time.perf_counter()
        built = book.built
        subject, fit = calibrate(built, book.finer())
        arrays = {
            "kept": kept_of(built.points, subject.points),
            "covariance": subject.covariance,
            "bias": subject.bias,
            "z": fit.z,
            "jacobian": fit.jacobian,
        }
        told = {
            "points": len(subject.points),
            "constants_kpa": {name: 1e3 * value for name, value in fit.values().items()},
            "scans": len(subject.scans),
            "cost": fit.cost,
            "converged": fit.converged,
            "iterations": fit.iterations,
            "seconds": time.perf_counter() - begun,
        }
        book.save(arrays, told, "calibration")
    return book.told("calibration")


def print_effect(request: Request, name: str, scan: int) -> Record:
    """What one effect would do to the residuals of one scan.

    Returns
    -------
    dict
        ``acts``: whether it does anything there and could be simulated; ``idle``: whether
        it does nothing there; ``seconds``.
    """
    book = Casebook(request)
    if not book.has("print", name, scan):
        begun = time.perf_counter()
        subject, nominal = book.subject, book.nominal
        alone = replace(subject, scans=[subject.scans[scan]])
        there = replace(nominal, views=(nominal.views[scan],))
        acting = book.effect(name)
        prints, _ = fingerprints(alone, there, [acting])
        arrays = _arrays(prints[0]) if prints else {}
        told = {
            "acts": bool(prints),
            "idle": not prints and not acts(alone, there, acting),
            "seconds": time.perf_counter() - begun,
        }
        book.save(arrays, told, "print", name, scan)
    return book.told("print", name, scan)


def refit_effects(request: Request, names: list[str]) -> Record:
    """Fit the constants and the parameters of one effect or of a pair.

    Returns
    -------
    dict
        ``found``: whether a start could be simulated; then ``log_evidence``,
        ``converged`` and ``iterations``; ``seconds``.
    """
    book = Casebook(request)
    if not book.has("refit", names):
        begun = time.perf_counter()
        seen = look_of(book)
        effects = [book.effect(name) for name in names]
        found = refit(
            seen.subject, book.nominal, effects, seen.by_name, seen.prints, seen.places
        )  # fmt: skip
        book.keep_refit(names, found, time.perf_counter() - begun)
    return book.told("refit", names)


def weigh_case(request: Request) -> Record:
    """Go through the diagnosis with the refits that the store has.

    Returns
    -------
    dict
        ``wanted``: refits that are missing, as lists of effects. If none is missing
        also ``summary``, see `workers.diagnosis.summary`; it is then in the store,
        with the residuals on the interfaces.
    """
    book = Casebook(request)
    if book.has("verdict"):
        return {"wanted": [], "summary": book.told("verdict")}
    seen = look_of(book)
    try:
        found = diagnose(seen, book.effects, _stored(book))
    except _WantedError as missing:
        return {"wanted": missing.combinations}
    told = summary(found, book.effects, book.source.name)
    drawn, rows = book.source.pictures(found, _moved(book, found))
    book.save(_maps(found) | drawn, told | rows, "verdict")
    return {"wanted": [], "summary": book.told("verdict")}


class _WantedError(Exception):
    """Refits that the store has not."""

    def __init__(self, combinations: list[list[str]]) -> None:
        super().__init__(f"{len(combinations)} refits are missing")
        self.combinations = combinations


def _stored(book: Casebook) -> RefitMany:
    def run(asked: Sequence[tuple[Effect, ...]]) -> Iterable[Refit | None]:
        combinations = [[e.name for e in effects] for effects in asked]
        missing = [names for names in combinations if not book.has("refit", names)]
        if missing:
            raise _WantedError(missing)
        return [book.refit(effects) for effects in asked]

    return run


def look_of(book: Casebook) -> Look:
    """What the nominal fit and the prints of all effects tell; made once by each process."""
    return book.cached("look", lambda: _look(book))


def _look(book: Casebook) -> Look:
    subject, nominal = book.subject, book.nominal
    linear = nominal.linearised(subject)
    prints = [p for e in book.effects if (p := _print(book, e, subject)) is not None]
    field = discrepancy_of(subject, nominal)
    if not book.has("threshold"):
        book.save({}, {"threshold": threshold_of(subject, linear, prints, field)}, "threshold")
    return Look(
        subject,
        nominal,
        linear,
        {p.name: p for p in prints},
        grid(subject),
        screen(linear, prints),
        field,
        book.told("threshold")["threshold"],
    )


def _print(book: Casebook, acting: Effect, subject: Subject) -> Fingerprint | None:
    """The columns of all scans, one after another; zero where the effect does nothing.

    None if it does nothing anywhere, or could not be simulated in some scan.
    """
    parts = [book.load("print", acting.name, scan) for scan in range(len(subject.scans))]
    stacks = [arrays for arrays, told in parts if told["acts"]]
    if not stacks or not all(told["acts"] or told["idle"] for _, told in parts):
        return None
    nothing = np.zeros_like(stacks[0]["columns"])
    columns = [arrays["columns"] if told["acts"] else nothing for arrays, told in parts]
    return Fingerprint(
        acting.name,
        acting.family,
        np.concatenate(columns, axis=-2),
        stacks[0]["prior_sd"],
        stacks[0]["one_sided"],
    )


def _arrays(found: Fingerprint) -> dict[str, Any]:
    return {
        "columns": found.columns,
        "prior_sd": found.prior_sd,
        "one_sided": found.one_sided,
    }


def _moved(book: Casebook, found: Diagnosis) -> dict[str, list[FloatArray]]:
    """Displacements of the nodes before, and after where an effect is accused and simulated.

    What the store has of a refit are its points; the body is solved once more.
    """
    subject, nominal = book.subject, book.nominal
    moved = {"before": [v.at.solution.displacement_mm for v in nominal.views]}
    if found.best is not None:
        fit = found.best.fit
        again = [
            view(subject, scan, fit.unknowns, fit.z, v.at)
            for scan, v in zip(subject.scans, nominal.views, strict=True)
        ]
        solved = [v.at.solution.displacement_mm for v in again if v is not None]
        if len(solved) == len(again):
            moved["after"] = solved
    return moved


def _maps(found: Diagnosis) -> dict[str, Any]:
    """Residuals on the interfaces, (scans, points) in mm, before and after, and their noise.

    Also where the points go, ``moved_``, and the observed normals there.
    """
    subject = found.look.subject
    shape = (len(subject.scans), len(subject.points))
    noise = np.sqrt((found.look.linear.covariance_factor**2).sum(axis=1))
    maps = {
        "points": subject.points.points,
        "interface": subject.points.interface,
        "before": found.look.linear.residual.reshape(shape),
        "noise": noise.reshape(shape),
        "moved_before": np.stack([v.points for v in found.look.nominal.views]),
        "normals_before": np.stack([v.normals for v in found.look.nominal.views]),
    }
    if found.best is not None:
        fit = found.best.fit
        maps["after"] = fit.linearised(subject).residual.reshape(shape)
        maps["moved_after"] = np.stack([v.points for v in fit.views])
        maps["normals_after"] = np.stack([v.normals for v in fit.views])
    return maps


def kept_of(before: InterfacePoints, after: InterfacePoints) -> BoolArray:
    """Which points of `before` are still in `after`, shape (k,).

    Raises
    ------
    ValueError
        If `after` is not a part of `before`, in its order.
    """
    rows = {(int(i), *p): n for n, (i, p) in enumerate(_rows(before))}
    index = np.array([rows[(int(i), *p)] for i, p in _rows(after)], dtype=np.intp)
    if (np.diff(index) <= 0).any():
        raise ValueError("calibration must keep points in their order")
    kept = np.zeros(len(before), np.bool_)
    kept[index] = True
    return kept


def _rows(points: InterfacePoints) -> Iterable[tuple[int, list[float]]]:
    return zip(points.interface.tolist(), points.points.tolist(), strict=True)
