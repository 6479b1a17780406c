"""Read a text of known phrases, and refuse it at the first phrase that is not known."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from palpate.storage.errors import InputError

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# What stands between phrases, and where a phrase may end.
BETWEEN = re.compile(r"(?:[\s,;:]|\.(?=\s|$)|\band\b)+")
END = r"(?=$|[\s,;:]|\.(?:\s|$))"
UNTIL_NEXT = re.compile(r"[^,;]+")


@dataclass(frozen=True)
class Phrase:
    """One thing that a text may say.

    Parameters
    ----------
    pattern : str
        A regular expression, in which ``#`` stands for a number. Named groups are numbers
        that it states.
    example : str
        As a message shows it; empty for remarks that state nothing.
    states : mapping
        What it states beyond its numbers.
    """

    pattern: str
    example: str = ""
    states: Mapping[str, Any] = field(default_factory=dict)

    def match(self, text: str, start: int) -> re.Match[str] | None:
        """Return the match that begins at a place of a text."""
        pattern = self.pattern.replace("#", NUMBER).replace(" ", r"\s*")
        return re.compile(f"(?:{pattern}){END}", re.IGNORECASE).match(text, start)


def remark(pattern: str) -> Phrase:
    """Return a phrase that may stand there and states nothing."""
    return Phrase(pattern)


def formula(text: str, **states: Any) -> Phrase:
    """Return a formula, blanks in it or not."""
    signs = re.sub(r"\s+", "", text)
    return Phrase(r"\s*".join(re.escape(sign) for sign in signs), text, states)


def read_phrases(text: str, phrases: Sequence[Phrase], where: str) -> dict[str, Any]:
    """Return all that a text states.

    Parameters
    ----------
    text : str
    phrases : sequence of Phrase
        All that it may say.
    where : str
        The file and the key, for messages.

    Raises
    ------
    InputError
        If a phrase is not known, or one thing is stated twice and differently.
    """
    stated: dict[str, Any] = {}
    place = 0
    while place < len(text):
        gap = BETWEEN.match(text, place)
        if gap:
            place = gap.end()
            continue
        matches = [(m, p) for p in phrases if (m := p.match(text, place)) is not None]
        if not matches:
            raise InputError(_unknown(text[place:], phrases, where))
        match, phrase = max(matches, key=lambda one: one[0].end())
        numbers = {key: float(v) for key, v in match.groupdict().items() if v is not None}
        for key, value in (dict(phrase.states) | numbers).items():
            if stated.setdefault(key, value) != value:
                raise InputError(
                    f"{where} says {match.group()!r}, but also {key} = {stated[key]}: found "
                    f"{text!r}."
                )
        place = match.end()
    return stated


def _unknown(rest: str, phrases: Sequence[Phrase], where: str) -> str:
    found = UNTIL_NEXT.match(rest)
    phrase = (found.group() if found else rest).strip()
    known = "; ".join(p.example for p in phrases if p.example)
    return f"{where} says {phrase!r}, which is not understood. Expected: {known}."
