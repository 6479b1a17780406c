"""An organ: a phantom of gel in the shape of a breast."""

from dataclasses import replace
from typing import Literal

from palpate.workers.organs.breast.breast_keys import SPEC as BREAST_SPEC
from palpate.workers.organs.breast.breast_keys import BreastCase, MeshSpec
from palpate.workers.organs.breast.breast_organ import Breast
from palpate.workers.organs.organ_plugins import Fact, OrganPlugin


class GelCase(BreastCase):
    """A body of gel, its mesh and its load."""

    organ: Literal["gel"] = "gel"
    mesh: MeshSpec = MeshSpec(nodes=5_000)


class Gel(Breast):
    """A breast under another name, with defaults of its own."""

    name = "gel"


ORGAN = Gel()
SPEC = replace(BREAST_SPEC, case=GelCase)

GEL = OrganPlugin(
    name="gel",
    spec="palpate_example.organ:SPEC",
    organ="palpate_example.organ:ORGAN",
    effects="palpate.workers.organs.breast.breast_effects:CATALOGUE",
    load_direction="The plates press along y.",
    facts=(Fact("Gel", "volume_ml", "ml"), Fact("Nodes of the mesh", "nodes")),
    templates={"gel": "palpate_example:gel.yaml"},
)
