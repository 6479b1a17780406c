"""The cornea as a plug-in."""

from palpate.workers.organs.plugin import Fact, OrganPlugin

CORNEA_PLUGIN = OrganPlugin(
    name="cornea",
    spec="palpate.workers.organs.cornea.organ_spec:SPEC",
    organ="palpate.workers.organs.cornea.organ:ORGAN",
    checks="palpate.workers.organs.cornea.study_checks:CHECKS",
    findings="palpate.workers.organs.cornea.findings.study",
    study_kind="cornea study",
    study_source="palpate.workers.organs.cornea.diagnosis.study_source:CorneaStudySource",
    effects="palpate.workers.organs.cornea.effects:CATALOGUE",
    load_direction="The air jet presses against y, into the eye.",
    facts=(
        Fact("Chord of the cornea", "chord_mm", "mm"),
        Fact("Central thickness", "central_thickness_um", "µm"),
        Fact("Nodes of the mesh", "nodes"),
        Fact("6-node triangles", "triangles"),
    ),
    templates={"cornea": "palpate.service.templates:cornea.yaml"},
)
