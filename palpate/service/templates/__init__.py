"""Files to start from, with a comment on every key."""

from importlib import resources

from palpate.workers.organs.organ_plugins import organ_names, organ_plugin

# What `palpate diagnose` takes; the other files are studies of an organ.
DIAGNOSED = ("diagnosis", "experiment")


def template_names() -> tuple[str, ...]:
    """Return the names of all templates: organs first, then diagnoses and experiments."""
    return (*_of_organs(), *DIAGNOSED)


def template(kind: str, name: str) -> str:
    """Return the text of a study, a diagnosis or an experiment.

    Parameters
    ----------
    kind : str
        One of `template_names`.
    name : str
        Replaces NAME.
    """
    package, _, file = _of_organs().get(kind, f"{__name__}:{kind}.yaml").partition(":")
    text = resources.files(package).joinpath(file).read_text(encoding="utf-8")
    return text.replace("NAME", name)


def _of_organs() -> dict[str, str]:
    """Return ``"package:file"`` by the name of each organ's templates."""
    return {
        name: place
        for organ in organ_names()
        for name, place in organ_plugin(organ).templates.items()
    }
