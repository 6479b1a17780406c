"""What a set is sealed against: the code of the diagnosis and all that it was told."""

import subprocess
from dataclasses import asdict
from pathlib import Path
from typing import Any

import workers
from service.versions import palpate_version
from storage.digest import digest, file_digest
from workers.casebook import FINER, ROOMS
from workers.cases.build import NODES, POINT_SPACING_MM
from workers.diagnosis.detectability import HIDDEN, SUNK
from workers.diagnosis.diagnosis import FALSE_ALARMS, LEAST_ALARM, NULL_DRAWS
from workers.diagnosis.hypotheses import EXPLAINED, FORM, PriorOdds
from workers.diagnosis.verdict import CREDIBLE
from workers.effects.base import Effect
from workers.effects.catalogue import BREAST_EFFECTS
from workers.library import code_version

Json = dict[str, Any]


def frozen(nodes: int = NODES) -> Json:
    """The diagnosis as it stands.

    Parameters
    ----------
    nodes : int
        Of the working mesh.

    Returns
    -------
    dict
        ``version``, ``commit`` (None outside of a repository), ``code`` (a digest of the
        source) and ``settings``: effects with their priors, prior odds, alarm rate, mesh.
    """
    return {
        "version": palpate_version(),
        "commit": _commit(),
        "code": diagnosis_code(),
        "settings": {
            "effects": [_effect(e) for e in BREAST_EFFECTS],
            "prior_odds": asdict(PriorOdds()),
            "alarm": {
                "rate": FALSE_ALARMS,
                "replicates": NULL_DRAWS,
                "least": {str(n): least for n, least in LEAST_ALARM.items()},
            },
            "verdict": {
                "hidden": HIDDEN,
                "sunk": SUNK,
                "explained": EXPLAINED,
                "credible": CREDIBLE,
                "form": FORM,
            },
            "mesh": {"nodes": nodes, "finer": FINER, "point_spacing_mm": POINT_SPACING_MM},
        },
    }


def differences(sealed: Json, now: Json) -> list[str]:
    """What of the diagnosis is not as it was sealed, in words; empty if nothing."""
    found = ["code"] if sealed["code"] != now["code"] else []
    before, after = sealed["settings"], now["settings"]
    return found + sorted(k for k in before.keys() | after.keys() if before.get(k) != after.get(k))


def diagnosis_code() -> str:
    """A digest of all source that a diagnosis depends on."""
    here = Path(workers.__file__ or "").parent
    tasks = [file_digest(here / name) for name in ("casebook.py", "examine.py")]
    return digest(code_version(*ROOMS), *tasks)


def _effect(effect: Effect) -> Json:
    return {
        "name": effect.name,
        "family": effect.family,
        "prior_sd": dict(zip(effect.names, effect.prior_sd, strict=True)),
    }


def _commit() -> str | None:
    """Of the repository that the code lies in, with a plus if it has changed since."""
    here = Path(workers.__file__ or "").parent
    asked = ["git", "-C", str(here), "describe", "--always", "--exclude=*", "--dirty=+",
             "--abbrev=40"]  # fmt: skip
    try:
        said = subprocess.run(asked, capture_output=True, text=True, timeout=20, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return said.stdout.strip() or None
