"""Plug-in for scans of a breast under known loads."""

from palpate.workers.organs.plugin import SourcePlugin

SCANS_PLUGIN = SourcePlugin(
    kinds={
        "scanned case": "palpate.workers.organs.breast.case.source:ScannedCaseSource",
        "planned case": "palpate.workers.organs.breast.case.source:PlannedCaseSource",
    },
    reader="palpate.workers.organs.breast.case.files:READER",
    file="diagnosis",
    keys="palpate.workers.organs.breast.case.spec:CaseFile",
)
