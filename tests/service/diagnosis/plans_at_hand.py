"""Hand-made plans."""

from typing import Any

from palpate.workers.diagnosis.plan_summary import FurtherMeasurement, PlanSummary


def option(name: str, **changes: Any) -> FurtherMeasurement:
    """Return a further measurement of a plan."""
    nothing: dict[str, Any] = {
        "told_apart": 0,
        "more_told_apart": 0,
        "separates": (),
        "reveals": (),
        "silent": (),
        "minimum_ratio": 0.9,
        "not_simulated": (),
    }
    return FurtherMeasurement(name=name, **nothing | changes)


def plan_of(*options: FurtherMeasurement) -> PlanSummary:
    """Return a plan with only further measurements."""
    return PlanSummary(
        case="by-hand",
        scans=(),
        points=0,
        noise_mm=0.3,
        travel_mm={},
        named_above=10.0,
        apart_above=5.0,
        effects=(),
        cosines=(),
        log_evidence=(),
        pairs=0,
        told_apart=0,
        confusable=(),
        silent=(),
        not_simulated=(),
        loose=(),
        without_columns=(),
        acquisitions=options,
    )
