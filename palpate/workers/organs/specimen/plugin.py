"""Bench experiments as a plug-in."""

from palpate.workers.organs.organ_plugins import SourcePlugin

BENCH_PLUGIN = SourcePlugin(
    kinds={"specimen": "palpate.workers.organs.specimen.specimen_source:SpecimenSource"},
    reader="palpate.workers.organs.specimen.experiment_files:READER",
    file="experiment",
    keys="palpate.workers.organs.specimen.specimen_keys:SpecimenSpec",
)
