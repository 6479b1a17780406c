"""The breast as a plug-in."""

from palpate.workers.organs.plugin import Fact, OrganPlugin

BREAST_PLUGIN = OrganPlugin(
    name="breast",
    spec="palpate.workers.organs.breast.organ_spec:SPEC",
    organ="palpate.workers.organs.breast.organ:ORGAN",
    checks="palpate.workers.organs.breast.study_checks:CHECKS",
    study_kind="breast study",
    study_source="palpate.workers.organs.breast.study_source:StudySource",
    effects="palpate.workers.organs.breast.effects:CATALOGUE",
    load_direction="The plates press along y.",
    facts=(
        Fact("Volume of the body", "volume_ml", "ml"),
        Fact("Glandular share", "glandular_fraction", "%", 100),
        Fact("Nodes of the mesh", "nodes"),
        Fact("Tetrahedra", "tets"),
        Fact("Meshes, coarse to fine", "levels"),
        Fact("Element size", "element_size_mm", "mm"),
    ),
    templates={
        "breast": "palpate.service.templates:breast.yaml",
        "breast-images": "palpate.service.templates:breast-images.yaml",
    },
)
