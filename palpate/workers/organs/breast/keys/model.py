"""Keys of the mesh and of the model of the tissue."""

from typing import Annotated, ClassVar

from pydantic import (
    Field,
)

from palpate.workers.missing_keys import Pairs
from palpate.workers.organs.breast import default_physics as physics
from palpate.workers.organs.breast.laws import Laws, TissueLaws
from palpate.workers.spec import (
    Door,
    Positive,
)


class MeshSpec(Door):
    """Resolution of the mesh: the number of nodes, or the size of the elements.

    Parameters
    ----------
    nodes
        Approximate number of nodes.
    element_size_mm
        Edge length of the elements, in mm.
    """

    exactly_one: ClassVar[Pairs] = (("nodes", "element_size_mm"),)

    nodes: Annotated[int, Field(ge=100, le=5_000_000)] | None = None
    element_size_mm: Positive | None = None


class ModelSpec(Door):
    """Model of the tissue.

    Parameters
    ----------
    skin
        ``none`` (skin counts as fat), ``membrane`` (without bending stiffness) or ``layer`` (solid
        elements; needs a fine mesh).
    skin_thickness_mm
        Thickness of the skin, in mm.
    fibres
        ``tension-only``, or ``literal``: the published formula, also in compression.
    fibre_invariant
        ``I4``, or ``isochoric``: the stretch without the volume change.
    law : str or mapping
        Law of the tissue without its fibres, such as yeoh: one for all tissues, or
        {fat: yeoh, glandular: neo-hookean}. Its shape constants, such as yeoh_c2_fat, can be held
        or searched; `palpate parameters --law yeoh` lists them.
    """

    later_keys: ClassVar[tuple[str, ...]] = ("law",)

    skin: physics.Skin = physics.SKIN
    skin_thickness_mm: Positive = physics.SKIN_THICKNESS_MM
    fibres: physics.Fibres = physics.FIBRES
    fibre_invariant: physics.FibreInvariant = physics.FIBRE_INVARIANT
    law: Laws = TissueLaws()
