"""The plug-ins of other distributions that a study uses, and the workers that lack them."""

from collections.abc import Callable, Iterable
from typing import Any, Protocol

from palpate.service.errors import ClusterError
from palpate.service.study.spec import StudySpec
from palpate.workers.mechanics.effects.plugged import plugins_of_parameters
from palpate.workers.plugins import Plugin, lacking_plugins, plugin


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
    found = dispatcher.everywhere(lacking_plugins, used)
    lacking = [f"the worker {where} {text}" for where, texts in found.items() for text in texts]
    if lacking:
        raise ClusterError(
            f"{'; '.join(lacking)}. Install the same distributions on every worker; "
            "`palpate doctor` lists the plug-ins of each."
        )
