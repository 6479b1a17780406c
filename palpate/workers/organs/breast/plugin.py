"""The breast as a plug-in, and scans of a breast under known loads as another."""

from palpate.workers.organs.organ_plugins import Fact, OrganPlugin, SourcePlugin

BREAST_PLUGIN = OrganPlugin(
    name="breast",
    spec="palpate.workers.organs.breast.breast_keys:SPEC",
    organ="palpate.workers.organs.breast.breast_organ:ORGAN",
    checks="palpate.workers.organs.breast.breast_study_checks:CHECKS",
    study_kind="breast study",
    study_source="palpate.workers.organs.breast.breast_study_source:BreastStudySource",
    effects="palpate.workers.organs.breast.breast_effects:CATALOGUE",
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


SCANS_PLUGIN = SourcePlugin(
    kinds={
        "scanned case": "palpate.workers.organs.breast.scanned_case_source:ScannedCaseSource",
        "planned case": "palpate.workers.organs.breast.scanned_case_source:PlannedCaseSource",
    },
    reader="palpate.workers.organs.breast.scanned_case_files:READER",
    file="diagnosis",
    keys="palpate.workers.organs.breast.scanned_case_keys:CaseFile",
)
