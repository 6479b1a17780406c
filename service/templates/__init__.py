"""Holds files to start from, with a comment on every key."""

from importlib import resources


def template(kind: str, name: str) -> str:
    """Return the text of a study, a diagnosis or an experiment.

    Parameters
    ----------
    kind : {"breast", "breast-images", "cornea", "diagnosis", "experiment"}
    name : str
        Stands in place of NAME.
    """
    text = resources.files(__name__).joinpath(f"{kind}.yaml").read_text(encoding="utf-8")
    return text.replace("NAME", name)
