"""Checks of organs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palpate.storage.json_digests import digest, to_plain
from palpate.storage.values import FreeParameter, Volume
from palpate.testing.plugin_claims import claim
from palpate.workers.common_keys import CaseSpec, validated
from palpate.workers.organs.organ_plugins import (
    OrganPlugin,
    organ_names,
    organ_of,
    organ_plugin,
    resolve,
)
from palpate.workers.organs.organ_protocol import Organ, OrganSpec

REFERENCES = ("spec", "organ", "checks", "findings", "study_source", "effects")
# A Gauss-Newton step from constants with 30 % error must reduce the cost below this fraction.
GAIN = 0.3


def check_organ(plugin: OrganPlugin, case: Mapping[str, Any], free: Sequence[str] = ()) -> None:
    """Check the contract of an organ on one case.

    Everything that the plug-in names can be imported; no other organ uses its study kind or the
    names of its templates; parameters are unique; body and mesh are stored and loaded unchanged;
    facts are plain values; solving the same case twice gives the same displacement, bit for bit;
    against itself the deformed body scores better than the undeformed one; nuisances are stated if
    and only if there is a fit; a fit finds the same displacement as a plain solution, and a
    Gauss-Newton step with its derivatives reduces the residuals.

    Parameters
    ----------
    plugin : OrganPlugin
    case : mapping
        Keys under ``case`` in a study file; it should be solvable in seconds.
    free : sequence of str
        Internal names of the constants with respect to which the fit is differentiated. Empty: no
        fit.

    Raises
    ------
    AssertionError
        Naming the first violated condition.
    """
    _check_references(plugin)
    organ = organ_of(plugin)
    name = plugin.name
    claim(organ.name == name, f"The organ is named {organ.name!r}, but its plug-in {name!r}.")
    _check_names(plugin)
    stated: OrganSpec = resolve(plugin.spec)
    spec = validated(stated.case, {"organ": name, **case}, "The case")
    claim(spec.organ == name, f"A case of {name} has the organ {spec.organ!r}.")
    doors = [p.door_name for p in stated.parameters]
    claim(len(set(doors)) == len(doors), f"{name} has duplicate parameters.")
    body = organ.make_body(spec.reference)
    mesh = organ.make_mesh(body, spec)
    _check_store(organ, body, mesh)
    facts = organ.facts(body, mesh)
    digest(to_plain(dict(facts)))
    organ.check(spec, body, facts)
    claim(isinstance(organ.picture(body), Volume), f"{name} has no picture of its body.")
    _check_solution(organ, stated, spec, body, mesh)
    fits = type(organ).fit is not Organ.fit
    claim(
        fits == stated.has_derivatives,
        f"{name} needs both a fit and nuisances in its specification, or neither.",
    )
    if free:
        claim(fits, f"{name} has no derivatives.")
        _check_fit(organ, spec, body, mesh, free)


def _check_references(plugin: OrganPlugin) -> None:
    for what in REFERENCES:
        reference = getattr(plugin, what)
        try:
            referent = resolve(reference) if reference else True
        except (ImportError, AttributeError, TypeError) as error:
            raise AssertionError(f"{plugin.name}.{what}: {error}") from error
        claim(referent is not None, f"{plugin.name}.{what} is None.")
    claim(
        bool(plugin.study_kind) == bool(plugin.study_source),
        f"{plugin.name} needs both study_kind and study_source, or neither.",
    )


def _check_names(plugin: OrganPlugin) -> None:
    for name in organ_names():
        other = organ_plugin(name)
        if name == plugin.name:
            continue
        kind = plugin.study_kind
        claim(not kind or kind != other.study_kind, f"{name} already uses the study kind {kind!r}.")
        shared = sorted(plugin.templates.keys() & other.templates.keys())
        claim(not shared, f"{name} already has a template named {', '.join(shared)}.")


def _check_store(organ: Organ[Any, Any, Any], body: Any, mesh: Any) -> None:
    arrays = organ.body_to_arrays(body)
    again = organ.body_to_arrays(organ.body_from_arrays(arrays))
    claim(_equal(arrays, again), f"A body of {organ.name} is changed by the store.")
    kept = organ.mesh_to_arrays(mesh)
    claim(
        _equal(kept, organ.mesh_to_arrays(organ.mesh_from_arrays(kept))),
        f"A mesh of {organ.name} is changed by the store.",
    )


def _check_solution(
    organ: Organ[Any, Any, Any], stated: OrganSpec, spec: CaseSpec, body: Any, mesh: Any
) -> None:
    name = organ.name
    constants, where = spec.complete(), organ.landmarks(body, spec)

    def solve() -> Any:
        model = organ.prepare(mesh)
        return organ.solve(model, organ.problem(model, spec, constants, where))

    first, second = solve(), solve()
    reason = first.outcome.reason
    claim(first.outcome.converged, f"No equilibrium was found for the case of {name}: {reason}.")
    claim(
        np.array_equal(first.displacement_mm, second.displacement_mm),
        f"{name} gives a different displacement when the same case is solved again.",
    )
    claim(np.abs(first.displacement_mm).max() > 0, f"The load of the case moves no node of {name}.")
    deformed = organ.deform(body, mesh, first.displacement_mm)
    scorer = organ.scorer(deformed, stated.score())
    own, before = (scorer.score(shape).as_dict()["gsf"] for shape in (deformed, body))
    claim(
        own < before,
        f"The deformed {name} scores no better against itself (GSF {own:g}) than the undeformed "
        f"one does ({before:g}).",
    )


def _check_fit(
    organ: Organ[Any, Any, Any], spec: CaseSpec, body: Any, mesh: Any, free: Sequence[str]
) -> None:
    model, where = organ.prepare(mesh), organ.landmarks(body, spec)
    constants = spec.complete()
    away = {**constants, **{name: 1.3 * constants[name] for name in free}}
    moved = organ.solve(model, organ.problem(model, spec, away, where)).displacement_mm
    target = organ.deform(body, mesh, moved)
    seen = organ.observation(body, mesh, target, False)
    asked: list[FreeParameter] = [
        {"name": n, "lower": 0.2 * constants[n], "upper": 5 * constants[n]} for n in free
    ]

    def fitted(values: Mapping[str, float]) -> Any:
        return organ.fit(model, spec, values, asked, where, None, seen)

    here = fitted(constants)
    plain = organ.solve(model, organ.problem(model, spec, constants, where)).displacement_mm
    claim(
        np.allclose(here.solution.displacement_mm, plain, atol=1e-6),
        f"A fit of {organ.name} finds a different displacement from a plain solution.",
    )
    claim(here.residuals is not None, f"A fit of {organ.name} has no residuals.")
    equations = here.residuals.equations
    step = -np.linalg.solve(equations.hessian, equations.gradient)  # of logarithms
    nearer = {n: constants[n] * float(np.exp(step[k])) for k, n in enumerate(free)}
    left = fitted({**constants, **nearer}).residuals.equations.cost
    claim(
        left < GAIN * equations.cost,
        f"{organ.name}: a Gauss-Newton step from {equations.cost:.4g} leads to {left:.4g}; its "
        "derivatives or residuals are wrong.",
    )


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, Volume):
        return bool(np.array_equal(a.values, b.values)) and a.spacing_mm == b.spacing_mm
    return a.keys() == b.keys() and all(np.array_equal(a[key], b[key]) for key in a)
