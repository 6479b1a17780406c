"""Says what follows from a diagnosis: which constants can be quoted, and what to do next."""

from markupsafe import Markup

from service.diagnosis.words import together
from service.formatting import joined, number, percent, signed_error, symbol
from workers.diagnosis.summary import ConstantEstimate, Summary
from workers.diagnosis.verdict import NO_GAP

# A constant that an effect changes by less is the same with and without it.
SAME = 0.05


def quotable(summary: Summary) -> Markup:
    """Return a sentence on which constants may be quoted and which not."""
    if not summary.constants:
        return Markup("")
    before = {name: value.before for name, value in summary.constants.items()}
    if summary.verdict == "no-gap":
        return Markup("Quote {}.{}").format(_values(before), _hidden(summary))
    if summary.verdict == "none-of-these":
        return Markup(
            "Do not quote {}: they were fitted with a model that lacks something unnamed."
        ).format(_names(before))
    after = {n: v.after for n, v in summary.constants.items() if v.after is not None}
    if not after:
        return Markup("Do not quote {}: the cause of the gap is open.").format(_names(before))
    same = {n: v for n, v in after.items() if _change(summary.constants[n]) < SAME}
    if summary.verdict == "cannot-be-told-apart" or _is_lead(summary):
        rest = [n for n in after if n not in same]
        if not rest:
            return Markup(
                "Quote {}: no cause that comes into question changes it by more than {:.0f} %."
            ).format(_values(same), 100 * SAME)
        quote = Markup("Quote {}; do not").format(_values(same)) if same else Markup("Do not")
        return Markup("{} quote {}: they depend on a cause that is not sure.").format(
            quote, _names(rest)
        )
    changes = [
        Markup("{} {}").format(symbol(n, "kPa"), percent(signed_error(v, before[n]), 0))
        for n, v in after.items()
        if n not in same
    ]
    against = Markup(
        " Do not quote those of the nominal model: without {} they are off ({})."
    ).format(together(summary.primary), joined(changes))
    return Markup("Quote {}, fitted with {}.{}{}").format(
        _values(after), together(summary.primary), against if changes else "", _hidden(summary)
    )


def next_step(summary: Summary, command: str) -> Markup:
    """Return what to do next; `command` is what was typed, empty if it is not known."""
    source = command.removeprefix("palpate diagnose").strip()
    if summary.verdict == "no-gap":
        return Markup("Nothing needs to be added to the model.")
    if summary.next_acquisitions:
        return Markup("Measure {}.").format(summary.next_acquisitions[0].name)
    if summary.verdict == "cannot-be-told-apart" and summary.markers is None:
        return Markup(
            "Find the measurement that would tell the causes apart: <code>{}</code>"
        ).format(f"palpate plan {source}".strip())
    if summary.verdict == "none-of-these":
        return Markup("Look where model and data differ, and at what is not in the catalogue.")
    if _is_lead(summary):
        return Markup("Confirm {} by a scan under another load.").format(together(summary.primary))
    return Markup("Put {} into the model, or measure it, and fit again.").format(
        together(summary.primary)
    )


def _is_lead(summary: Summary) -> bool:
    """Return whether there may be no gap, or as large a one on scans that were not fitted to."""
    share = summary.gap_mm.held_out_share
    return NO_GAP in summary.set90 or (share is not None and share.low < 0)


def _change(constant: ConstantEstimate) -> float:
    change = signed_error(constant.after, constant.before)
    return abs(change) if change is not None else 0.0


def _values(constants: dict[str, float]) -> Markup:
    return joined(
        [
            Markup("{} = {}{}").format(
                symbol(n, "kPa"), number(v, 3), " kPa" if n.endswith("_kpa") else ""
            )
            for n, v in constants.items()
        ]
    )


def _names(constants: object) -> Markup:
    return joined([symbol(n, "kPa") for n in constants])  # type: ignore[attr-defined]


def _hidden(summary: Summary) -> str:
    if not summary.absorbed:
        return ""
    return f" They may hide {together(summary.absorbed)}."
