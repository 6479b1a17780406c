"""The diagnosis for which a set is sealed: its code and all its settings."""

import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from palpate import workers
from palpate.service.blind.case_truth import CATALOGUE
from palpate.service.installed_packages import palpate_version
from palpate.storage.json_digests import digest
from palpate.workers.diagnosis.diagnosis_settings import SETTINGS
from palpate.workers.mechanics.effects.effect import Effect
from palpate.workers.tasks.diagnosis_store import diagnosis_code

# The source kind of a blind case.
SCANNED_CASE = "scanned case"


@dataclass(frozen=True, slots=True)
class FrozenDiagnosis:
    """The current diagnosis.

    Parameters
    ----------
    version : str
        Version of Palpate.
    commit : str or None
        None outside a repository.
    code : str
        Digest of all source that a diagnosis depends on.
    settings : mapping
        All of `diagnosis_settings`, by its groups, and the ``effects`` with their priors.
    settings_digest : str
        Digest of the settings.
    """

    version: str
    commit: str | None
    code: str
    settings: Mapping[str, Any]
    settings_digest: str = ""


def frozen(nodes: int = SETTINGS.mesh.nodes) -> FrozenDiagnosis:
    """Return the current diagnosis.

    Parameters
    ----------
    nodes : int
        Nodes of the working mesh.
    """
    meshed = replace(SETTINGS, mesh=replace(SETTINGS.mesh, nodes=nodes))
    settings = asdict(meshed) | {"effects": [_effect(e) for e in CATALOGUE.effects]}
    return FrozenDiagnosis(
        palpate_version(), _commit(), diagnosis_code(SCANNED_CASE), settings, digest(settings)
    )


def differences(sealed: Mapping[str, Any], now: FrozenDiagnosis) -> list[str]:
    """Return the parts of the diagnosis that have changed since the seal; empty if none.

    Parameters
    ----------
    sealed : mapping
        As in a manifest.
    now : FrozenDiagnosis
    """
    found = ["code"] if sealed["code"] != now.code else []
    if sealed.get("settings_digest") == now.settings_digest:
        return found
    before, after = sealed["settings"], now.settings
    named = {
        k for k in before.keys() | after.keys() if digest(before.get(k)) != digest(after.get(k))
    }
    return found + sorted(named)


def _effect(effect: Effect) -> dict[str, object]:
    return {
        "name": effect.name,
        "family": effect.family,
        "prior_sd": dict(zip(effect.names, effect.prior_sd, strict=True)),
    }


def _commit() -> str | None:
    """Return the commit of the code's repository, with a plus if files have changed."""
    here = Path(workers.__file__ or "").parent
    command = ["git", "-C", str(here), "describe", "--always", "--exclude=*", "--dirty=+"]
    try:
        answer = subprocess.run(
            [*command, "--abbrev=40"], capture_output=True, text=True, timeout=20, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip() or None
