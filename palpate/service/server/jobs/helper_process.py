"""Helper processes of a service, which import nothing from users' folders."""

import os
import sys
from pathlib import Path

from palpate.workers import WORKER_ENVIRONMENT


def helper_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a Palpate module without importing from users' folders."""
    return [sys.executable, "-P", "-m", module, *arguments]


def helper_environment() -> dict[str, str]:
    """Return the environment of a helper process, which may run in any folder."""
    environment = os.environ | WORKER_ENVIRONMENT | {"PYTHONSAFEPATH": "1"}
    if given := environment.get("PYTHONPATH"):
        places = [str(Path(place).absolute()) for place in given.split(os.pathsep) if place]
        environment["PYTHONPATH"] = os.pathsep.join(places)
    return environment
