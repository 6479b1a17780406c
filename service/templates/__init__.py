"""Study files to start from, with a comment on every key."""

from importlib import resources


def template(kind: str, name: str) -> str:
    """The text of a study file.

    Parameters
    ----------
    kind : {"breast", "breast-images"}
    name : str
        Of the study, put in place of NAME.
    """
    text = resources.files(__name__).joinpath(f"{kind}.yaml").read_text(encoding="utf-8")
    return text.replace("NAME", name)
