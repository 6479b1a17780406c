"""Processes that help a service: they import nothing from the folders that users write to."""

import os
import sys
from pathlib import Path

from palpate.workers import WORKER_ENVIRONMENT


def helper_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module of Palpate, with no folder of a user to import from."""
    return [sys.executable, "-P", "-m", module, *arguments]


def helper_environment() -> dict[str, str]:
    """Return the environment of such a process, which may run in any folder."""
    environment = os.environ | WORKER_ENVIRONMENT | {"PYTHONSAFEPATH": "1"}
    if given := environment.get("PYTHONPATH"):
        places = [str(Path(place).absolute()) for place in given.split(os.pathsep) if place]
        environment["PYTHONPATH"] = os.pathsep.join(places)
    return environment
