"""The elements of a chapter, as used by `book.html.j2`."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from palpate.service.report.drawing.pictures import Picture

Text = str | Markup


@dataclass(frozen=True)
class Table:
    """A table that compares the thesis with Palpate.

    Parameters
    ----------
    title : str
    headings : sequence of str
    rows : sequence of sequence of str
    words : sequence of int
        Columns of text, which may wrap.
    note : str
        Text below the table.
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[Text]]
    words: Sequence[int] = ()
    note: str = ""


@dataclass(frozen=True)
class Chapter:
    """A chapter on one experiment.

    Parameters
    ----------
    anchor, title, where : str
        Name of the experiment, its title, its section of the thesis.
    verdict : str
        The result, in one or two sentences.
    thesis, palpate : str
        Methods of the thesis and of Palpate.
    tables, pictures : sequence
    differences : sequence of str
        Reasons for differences between the numbers.
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
