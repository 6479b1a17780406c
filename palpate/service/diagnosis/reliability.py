"""How often a first cause was right on bodies of other solvers, by the gain of its fit.

``reliability.json`` holds the counts, written by `tests.benchmarks.foreign_bodies --reliability`.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from palpate.service.diagnosis.diagnosis_words import strength
from palpate.storage.json_digests import from_json

FILE = Path(__file__).with_name("reliability.json")
# Fewer bodies say nothing about the next one.
FEWEST = 10


@dataclass(frozen=True, slots=True)
class Band:
    """Counts of the bodies whose first cause had evidence of one strength.

    Parameters
    ----------
    word : str
        See `strength`.
    named, right, unlisted : int
        Bodies for which a cause was named with it, those of them where that cause acts, and those
        whose cause is not in the catalogue.
    """

    word: str
    named: int
    right: int
    unlisted: int


@cache
def bands() -> Sequence[Band]:
    """Return the counts, the weakest evidence first."""
    return [from_json(Band, row) for row in json.loads(FILE.read_text(encoding="utf-8"))]


def reliability(gain: float) -> str:
    """Return how often a cause named with such a gain was right; empty after too few bodies.

    Bands with few bodies are counted together.
    """
    counted = [one for one in bands() if one.word == strength(gain)]
    if any(one.named < FEWEST for one in counted):
        counted = [one for one in bands() if one.named < FEWEST]
    named, right = sum(one.named for one in counted), sum(one.right for one in counted)
    if named < FEWEST:
        return ""
    words = " or ".join(one.word for one in counted)
    unlisted = sum(one.unlisted for one in counted)
    others = f"; the cause of {unlisted} others is not in the catalogue" if unlisted else ""
    return (
        f"Of {named} bodies of another solver with {words} evidence, the cause named first was "
        f"right in {right}{others}."
    )
