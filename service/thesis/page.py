"""What a chapter of the book is made of; `book.html.j2` knows nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from palpate.service.report.drawing.pictures import Picture

Text = str | Markup


@dataclass(frozen=True)
class Table:
    """A table of the thesis beside ours.

    Parameters
    ----------
    title : str
    headings : sequence of str
    rows : sequence of sequence of str
    words : sequence of int
        Columns of text, which may break.
    note : str
        Below it.
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[Text]]
    words: Sequence[int] = ()
    note: str = ""


@dataclass(frozen=True)
class Chapter:
    """One experiment.

    Parameters
    ----------
    anchor, title, where : str
        Name of the experiment, its title, its section of the thesis.
    verdict : str
        What came out, in one or two sentences.
    thesis, palpate : str
        What each did.
    tables, pictures : sequence
    differences : sequence of str
        Why the numbers differ.
    costs : sequence of (str, str)
    """

    anchor: str
    title: str
    where: str
    verdict: Text
    thesis: Text
    palpate: Text
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    differences: Sequence[Text] = field(default=())
    costs: Sequence[tuple[str, Text]] = ()
