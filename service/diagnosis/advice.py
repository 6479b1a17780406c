"""Which further measurement would decide most of what a diagnosis leaves open."""

from collections.abc import Mapping
from itertools import combinations
from typing import Any

from service.diagnosis.words import NOT_EFFECTS, listed, spoken, together

Json = dict[str, Any]
# Measurements that are worth a line.
SHOWN = 4


def undecided(told: Mapping[str, Any]) -> bool:
    """Whether several causes are left."""
    return bool(told["verdict"] == "cannot-be-told-apart")


def next_acquisitions(told: Mapping[str, Any], plan: Mapping[str, Any]) -> list[Json]:
    """Measurements that were tried in a plan, the one that decides most first.

    First counts which pairs of the suspects of the 90 % set are told apart, then how many
    effects that hide in the constants come to light, then the order of the plan.

    Parameters
    ----------
    told : mapping
        See `workers.diagnosis.summary.summary`.
    plan : mapping
        Of the same scans, see `workers.planning.summary.plan`.

    Returns
    -------
    list of dict
        ``name``; ``separates``, pairs of suspects; ``reveals``, effects that hide now;
        ``minimum_ratio``, what becomes of the magnitudes that are found.
    """
    suspects = {frozenset(p) for p in combinations(_suspects(told), 2)}
    hidden = set(told["absorbed"])
    found = [
        {
            "name": a["name"],
            "separates": [pair for pair in a["separates"] if frozenset(pair) in suspects],
            "reveals": [name for name in a["reveals"] if name in hidden],
            "minimum_ratio": a["minimum_ratio"],
        }
        for a in plan["acquisitions"]
    ]
    return sorted(found, key=lambda a: (-len(a["separates"]), -len(a["reveals"])))[:SHOWN]


def worth(option: Mapping[str, Any]) -> str:
    """What one of them would decide, in a phrase.

    Examples
    --------
    >>> option = {"separates": [["gravity_change", "fibre_fan"]], "reveals": []}
    >>> worth(option | {"minimum_ratio": 0.62})
    'tells gravity change from fibre fan; the smallest magnitudes found become 0.62 times as large'
    """
    pairs = [f"{spoken(a)} from {spoken(b)}" for a, b in option["separates"]]
    said = [f"tells {listed(pairs)}"] if pairs else []
    if option["reveals"]:
        said.append(f"brings {together(option['reveals'])} to light")
    said.append(
        f"the smallest magnitudes found become {option['minimum_ratio']:.2f} times as large"
    )
    return "; ".join(said)


def _suspects(told: Mapping[str, Any]) -> list[str]:
    return [name for name in told["set90"] if name not in NOT_EFFECTS]
