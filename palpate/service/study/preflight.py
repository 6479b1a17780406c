"""Checks of a study before its first task: its plug-ins on the workers, and plausibility.

Workers must have the plug-ins of other distributions that the study uses.

An implausible study is rejected, with all reasons, unless the user insists; an unusual one runs
with a warning.
"""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

from palpate.service.errors_and_interrupts import ClusterError
from palpate.service.number_formatting import listed, number
from palpate.service.search.search_keys import strategy_named
from palpate.service.study.study_keys import StudySpec
from palpate.storage.backends.store_paths import Place, place_of
from palpate.workers.common_keys import validated
from palpate.workers.mechanics.effects.effect import plugins_of_parameters
from palpate.workers.mechanics.model_parameters import Bounds, Parameter
from palpate.workers.organs.plausibility_rule import Finding, accept, refused
from palpate.workers.plugins import Plugin, lacking_plugins, plugin
from palpate.workers.tasks.plausibility import study_findings


def used_plugins(spec: StudySpec) -> list[Plugin]:
    """Return the plug-ins that evaluations of a study need, except Palpate's own."""
    parameters = spec.case.parameters
    stated = (*spec.search.parameters, *spec.case.constants, *(spec.target.constants or {}))
    names = {parameters.at_door(name).name for name in stated}
    used = [
        plugin("organs", spec.case.organ),
        plugin("scores", spec.score.objective),
        *plugins_of_parameters(names),
    ]
    return [one for one in used if not one.is_own]


class Everywhere(Protocol):
    """An object that can run a task on each worker, such as a `Dispatcher`."""

    def everywhere(self, task: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Run one task on each current worker and return the records by worker address."""


def require_plugins(dispatcher: Everywhere, wanted: Iterable[Plugin]) -> None:
    """Check that every worker has the given plug-ins, before any work starts.

    Raises
    ------
    ClusterError
        If a worker lacks one; the message names each worker and what it lacks.
    """
    used = list(wanted)
    if not used:
        return
    missing = dispatcher.everywhere(lacking_plugins, used)
    lacking = [f"the worker {where} {text}" for where, texts in missing.items() for text in texts]
    if lacking:
        raise ClusterError(
            f"{'; '.join(lacking)}. Install the same distributions on every worker; "
            "`palpate doctor` lists the plug-ins of each."
        )


# An interval that differs by this factor is in another unit: kPa instead of Pa or MPa.
OTHER_UNIT = 30.0
# The thesis' search has 84 x 15 evaluations; the second limit takes 100 cores a year.
MANY_EVALUATIONS = 20_000
TOO_MANY_EVALUATIONS = 1_000_000
# Settings that determine the size of a search.
_SIZES = ("population", "generations", "starts", "fit_evaluations")
GIB = 1024**3
SCARCE_BYTES = GIB
# Bytes of a displacement in double precision, and of an evaluation's record.
NODE_BYTES = 24
RECORD_BYTES = 4096
USUAL_NODES = 20_000


def preflight(
    spec: StudySpec, store: Place, *, anyway: bool = False, elsewhere: bool = False
) -> list[Finding]:
    """Check a study before its first run.

    Parameters
    ----------
    spec : StudySpec
    store : Path or ObjectPath
        Location of volumes and evaluations; images are imported into it.
    anyway : bool
        Whether to accept an implausible study.
    elsewhere : bool
        Whether the workers run on other machines, where files missing here may exist.

    Returns
    -------
    list of Finding
        Remarks for the user. `workers.organs.plausibility_rule.caveats_of` returns the statements
        that belong in the record of a study that was run anyway.

    Raises
    ------
    InputError
        If the study is rejected; the message lists every reason.
    StoreError
        If the store cannot be used.
    """
    findings = list(_of_the_file(spec, store))
    if not refused(findings, anyway):
        findings += study_findings(
            spec.case,
            spec.target,
            spec.score,
            str(store),
            searched=spec.case.parameters.bounds_from_door(spec.search.parameters),
            elsewhere=elsewhere,
        )
    return accept(findings, f"The study {spec.name}", anyway=anyway)


def _of_the_file(spec: StudySpec, store: Place) -> Iterator[Finding]:
    yield from _intervals(spec)
    yield from _evaluations(spec)
    yield from _idle_settings(spec)
    yield from _space(spec, store)
    if spec.identifiable == "ratio":
        yield Finding(
            "warning",
            "The plates are at a given distance and no stiffness is held: only ratios of the "
            "stiffnesses can be found, and their scale is arbitrary. Hold one under "
            "case.constants, such as E_fat_kpa: 10, or give case.load.force_n.",
        )


def _intervals(spec: StudySpec) -> Iterator[Finding]:
    parameters = spec.case.parameters
    searched = spec.search.parameters
    held = {"case.constants": spec.case.constants, "target.constants": spec.target.constants or {}}
    for name, bounds in searched.items():
        parameter = parameters.at_door(name)
        where = f"search.parameters.{name}: [{bounds[0]:g}, {bounds[1]:g}]"
        if _in_another_unit(parameter, bounds):
            yield Finding("implausible", _far(where, parameter, bounds))
        elif _apart(parameter, bounds):
            yield Finding("warning", _far(where, parameter, bounds))
    for place, constants in held.items():
        for name, value in constants.items():
            parameter = parameters.at_door(name)
            if value and _in_another_unit(parameter, (value, value)):
                where = f"{place}.{name}: {value:g}"
                yield Finding("implausible", _far(where, parameter, (value, value)))


def _known(parameter: Parameter) -> Bounds:
    low, high = (parameter.unit.to_door(value) for value in parameter.bounds)
    return low, high


def _in_another_unit(parameter: Parameter, bounds: Bounds) -> bool:
    low, high = _known(parameter)
    too_large = high > 0 and bounds[0] >= OTHER_UNIT * high
    too_small = low > 0 and bounds[1] <= low / OTHER_UNIT
    return too_large or too_small or (low < 0 and bounds[1] <= OTHER_UNIT * low)


def _apart(parameter: Parameter, bounds: Bounds) -> bool:
    low, high = _known(parameter)
    return bounds[0] > high or bounds[1] < low


def _far(where: str, parameter: Parameter, bounds: Bounds) -> str:
    low, high = _known(parameter)
    unit = f" {parameter.unit.symbol}".rstrip()
    ratio = bounds[0] / high if bounds[0] > high else bounds[1] / low
    times = f"about {number(ratio, 2)} times" if ratio > 0 else "far from"
    return (
        f"{where}{unit} is {times} the known interval of {low:g} to {high:g}{unit} "
        f"({parameter.description}). Write values in {parameter.unit.symbol or 'plain numbers'}."
    )


def _evaluations(spec: StudySpec) -> Iterator[Finding]:
    most = spec.most_evaluations
    if most <= MANY_EVALUATIONS:
        return
    used = strategy_named(spec.search.strategy).settings
    sizes = [name for name in _SIZES if name in used]
    yield Finding(
        "implausible" if most > TOO_MANY_EVALUATIONS else "warning",
        f"search: {most:,} evaluations at most, in {spec.most_generations:,} generations; a "
        f"typical search has about 1,000. Lower {listed(sizes or _SIZES)}.",
    )


def _idle_settings(spec: StudySpec) -> Iterator[Finding]:
    """Report keys that were given but are not used by the strategy."""
    search = spec.search
    used = strategy_named(search.strategy).settings
    idle = [
        name
        for name in type(search).model_fields
        if name in search.model_fields_set - {"parameters", "strategy", *used}
    ]
    if idle:
        yield Finding(
            "warning",
            f"search: strategy {search.strategy} does not use {listed(idle)}. It uses "
            f"{listed(used)}.",
        )


def _space(spec: StudySpec, store: Place) -> Iterator[Finding]:
    if not isinstance(store, Path):
        return  # the free space of a bucket is unknown
    there = store
    while not there.exists():
        there = there.parent
    free = shutil.disk_usage(there).free
    stated = spec.case.model_dump(mode="json").get("mesh", {})
    nodes = stated.get("nodes") or USUAL_NODES
    needed = spec.search.settings.most_evaluations * (NODE_BYTES * nodes + RECORD_BYTES)
    if needed > free:
        yield Finding(
            "implausible",
            f"The store {store} has {free / GIB:.1f} GiB free; up to {needed / GIB:.1f} GiB are "
            "needed for the displacements of all candidates. Free some space, or give another "
            "--store.",
        )
    elif free < SCARCE_BYTES:
        yield Finding("warning", f"The store {store} has only {free / GIB:.2f} GiB free.")


def preflight_task(spec: Mapping[str, Any], store: str, anyway: bool) -> list[Finding]:
    """Run `preflight` on a worker, where the images of the study are read.

    Raises
    ------
    InputError, StoreError
        As for `preflight`.
    """
    study = validated(StudySpec, spec, "The study")
    return preflight(study, place_of(store), anyway=anyway)
