"""Diagnose a case in a process that records every file it opens.

::

    python open_files.py CASE STORE OTHER

writes the lists to standard output as JSON. OTHER is opened at the end, to check that the lists
would show it.
"""

import json
import os
import sys
from pathlib import Path

OPENED: list[str] = []
EVENTS = ("open", "os.listdir", "os.scandir")


def note(event: str, arguments: tuple[object, ...]) -> None:
    """Record opened files and listed folders; an audit hook."""
    if event in EVENTS and isinstance(arguments[0], str | os.PathLike):
        OPENED.append(os.path.realpath(arguments[0]))


sys.addaudithook(note)

from palpate.service.blind.diagnosed_case import diagnose_alone  # noqa: E402
from palpate.service.diagnosis.diagnosis_run import request_for  # noqa: E402

if __name__ == "__main__":
    case, store, other = (Path(argument) for argument in sys.argv[1:])
    diagnose_alone(request_for(case, store, 600, 12.0, ["plate_tilt", "segmentation_offset"]))
    before = list(OPENED)
    other.read_bytes()
    json.dump({"by_the_diagnosis": before, "by_us": OPENED[len(before) :]}, sys.stdout)
