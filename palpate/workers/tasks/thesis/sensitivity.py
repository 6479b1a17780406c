"""One constant varied, all others at the target (thesis Fig. 4.22), as tasks."""

from dataclasses import dataclass
from typing import ClassVar

from palpate.workers.tasks.evaluation import case_of as read_case
from palpate.workers.tasks.evaluation import evaluate, make_target, prepare_case
from palpate.workers.tasks.thesis.parts import Request, Spent, Watch
from palpate.workers.thesis.identification import TARGETS, TargetName, case_of


@dataclass(frozen=True)
class Vary(Request):
    """Request to compare the target with the body deformed after changing one constant."""

    MODULE: ClassVar[str] = __name__

    target: TargetName
    phantom: int
    constant: str
    value_kpa: float

    @property
    def kind(self) -> str:
        """See `Request.kind`."""
        return f"vary, {self.target}"


@dataclass(frozen=True, slots=True)
class VariedConstant:
    """Scores of the body with one constant changed; None if it diverged."""

    spent: Spent
    jc: float | None
    mhd_mm: float | None
    mhd_voxels: float | None


def vary_constant(request: Vary) -> Spent:
    """Simulate the target and the same body with one constant changed, and compare them."""
    if not request.part.is_finished:
        watch = Watch()
        case = case_of(request.target, request.phantom, request.scale)
        prepared = prepare_case(case, request.store)
        target = make_target(case, {"constants": TARGETS[request.target]}, request.store)
        door = TARGETS[request.target] | {request.constant: request.value_kpa}
        result = evaluate(
            {
                "store": request.store,
                "case": case,
                "prepared": prepared,
                "target": target["target"],
                "constants": read_case(case).parameters.from_door(door),
            }
        )
        score = result.get("score") or {}
        found = (score.get("jc"), score.get("mhd_mm"), score.get("mhd_voxels"))
        request.part.save(VariedConstant(watch.spent(), *found), {})
    return request.spent
