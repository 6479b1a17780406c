"""Helpers of a test room are imported by name from the room's own folder."""

import sys
from pathlib import Path

for room in sorted(Path(__file__).parent.rglob("*")):
    if room.is_dir() and not room.name.startswith(("_", ".")):
        sys.path.append(str(room))
