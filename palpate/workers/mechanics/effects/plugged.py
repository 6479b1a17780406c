"""Effects from plug-ins."""

from collections.abc import Container, Mapping

from palpate.workers.mechanics.effects.base import Effect
from palpate.workers.plugins import Plugin, plugins


def plugged_effects(organ: str) -> tuple[Effect, ...]:
    """Return the effects that plug-ins add to an organ, sorted by name.

    Raises
    ------
    InputError
        If a plug-in cannot be imported.
    """
    loaded: list[Effect] = [p.load() for p in plugins("effects").values() if not p.is_own]
    return tuple(effect for effect in loaded if organ in effect.organs)


def acting_plugins(values: Mapping[str, float]) -> tuple[Plugin, ...]:
    """Return the plug-ins whose effects change something at these values.

    Parameters
    ----------
    values : mapping of str to float
        Internal names and units.
    """
    return tuple(
        plugin
        for plugin, effect in _foreign()
        if any(values.get(name, neutral) != neutral for name, neutral in effect.neutral.items())
    )


def plugins_of_parameters(names: Container[str]) -> tuple[Plugin, ...]:
    """Return the plug-ins whose effects have any of these parameters, internal names."""
    return tuple(plugin for plugin, e in _foreign() if any(name in names for name in e.names))


def without_idle_plugins(values: Mapping[str, float]) -> dict[str, float]:
    """Return the values without plug-in effects that change nothing.

    The digest of an evaluation thus does not depend on plug-ins that it does not use.
    """
    idle = {
        name
        for _, effect in _foreign()
        if all(values.get(n, neutral) == neutral for n, neutral in effect.neutral.items())
        for name in effect.names
    }
    return {name: value for name, value in values.items() if name not in idle}


def _foreign() -> list[tuple[Plugin, Effect]]:
    return [(p, p.load()) for p in plugins("effects").values() if not p.is_own]
