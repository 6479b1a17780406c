"""The cornea as a plug-in."""

from palpate.workers.organs.organ_plugins import Fact, OrganPlugin

CORNEA_PLUGIN = OrganPlugin(
    name="cornea",
    spec="palpate.workers.organs.cornea.cornea_keys:SPEC",
    organ="palpate.workers.organs.cornea.cornea_organ:ORGAN",
    checks="palpate.workers.organs.cornea.cornea_checks:CHECKS",
    findings="palpate.workers.organs.cornea.cornea_findings",
    study_kind="cornea study",
    study_source="palpate.workers.organs.cornea.cornea_study_source:CorneaStudySource",
    effects="palpate.workers.organs.cornea.cornea_effects:CATALOGUE",
    load_direction="The air jet presses against y, into the eye.",
    facts=(
        Fact("Chord of the cornea", "chord_mm", "mm"),
        Fact("Central thickness", "central_thickness_um", "µm"),
        Fact("Nodes of the mesh", "nodes"),
        Fact("6-node triangles", "triangles"),
    ),
    templates={"cornea": "palpate.service.templates:cornea.yaml"},
)
