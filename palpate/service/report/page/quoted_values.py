"""The statement on the values of a page that may and may not be quoted."""

from collections.abc import Mapping

from markupsafe import Markup

from palpate.service.number_formatting import joined
from palpate.service.results.quotability_rule import Quotability, names_by_reason


def quote_lines(quote: Markup, answers: Mapping[Markup, Quotability]) -> Markup:
    """Return what to quote, and what not: a sentence, or a line for each of several reasons.

    Parameters
    ----------
    quote : Markup
        The values that may be quoted, as ``Quote E = 10 kPa``; empty if there are none.
    answers : mapping of Markup to Quotability
        All values by name.
    """
    bad = [
        (joined([Markup("{} ({})").format(n, end) if end else n for n, end in names]), reason)
        for names, reason in names_by_reason(answers)
    ]
    if len(bad) == 1:
        start = quote + Markup("; do not quote") if quote else Markup("Do not quote")
        return Markup("{} {} ({}).").format(start, *bad[0])
    lines = [quote + Markup(".")] if quote else []
    lines += [Markup("Do not quote {}: {}.").format(*one) for one in bad]
    return Markup("<br>\n").join(lines)
