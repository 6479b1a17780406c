"""Bench experiments as a plug-in."""

from palpate.workers.organs.plugin import SourcePlugin

BENCH_PLUGIN = SourcePlugin(
    kinds={"specimen": "palpate.workers.organs.specimen.source:SpecimenSource"},
    reader="palpate.workers.organs.specimen.experiment_files:READER",
    file="experiment",
    keys="palpate.workers.organs.specimen.spec:SpecimenSpec",
)
