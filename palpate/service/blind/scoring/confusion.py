"""Counts of truths and answers."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from palpate.service.blind.sealed.records import FAILED, CaseRecord
from palpate.service.blind.sealed.truth import GROUPS
from palpate.workers.diagnosis.verdict.verdict import NO_GAP, NONE_OF_THESE

ORDER = tuple(GROUPS)
ENDS = (NONE_OF_THESE, FAILED)


@dataclass(frozen=True)
class Confusion:
    """Counts of cases.

    Parameters
    ----------
    rows : tuple of str
        Kinds of truth: nothing detectable, single effects, pairs and triples, and causes outside
        the catalogue.
    columns : tuple of str
        First effects named, and answers without an effect.
    counts : tuple of tuple of int
        One tuple for each row.
    right : frozenset of (int, int)
        Row and column of correct answers.
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    right: frozenset[tuple[int, int]]


def confusion(records: Sequence[CaseRecord]) -> Confusion:
    """Return the counts of answers by truth."""
    ranked = sorted(records, key=lambda r: (ORDER.index(r.group), true_name(r)))
    rows = tuple(dict.fromkeys(true_name(r) for r in ranked))
    answers = {said_name(r) for r in records}
    effects = [name for r in ranked for name in r.effects if name in answers]
    others = sorted(answers - set(effects) - {NO_GAP, *ENDS})
    columns = (NO_GAP, *dict.fromkeys(effects), *others, *(e for e in ENDS if e in answers))
    count = Counter((true_name(r), said_name(r)) for r in records)
    right = {(rows.index(true_name(r)), columns.index(said_name(r))) for r in records if r.right}
    counts = tuple(tuple(count[row, column] for column in columns) for row in rows)
    return Confusion(rows, columns, counts, frozenset(right))


def true_name(record: CaseRecord) -> str:
    """Return the row of a case."""
    if record.group == "single":
        return record.effects[0]
    if record.group in ("pair", "triple"):
        return " + ".join(record.effects)
    return record.kind


def said_name(record: CaseRecord) -> str:
    """Return the column of a case."""
    return record.first or record.answer
