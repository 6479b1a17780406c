"""Constants and effects that a study can hold fixed or search."""

from palpate.workers.mechanics.parameters import Parameter
from palpate.workers.organs.registry import DEFAULT, organ_spec


def parameters(organ: str = DEFAULT) -> dict[str, Parameter]:
    """Return the parameters of an organ's model by their names in a study, units included.

    Parameters
    ----------
    organ : str
        Name of the organ, such as ``"breast"``.

    Raises
    ------
    InputError
        If the organ is unknown.
    """
    return {parameter.door_name: parameter for parameter in organ_spec(organ).parameters}
