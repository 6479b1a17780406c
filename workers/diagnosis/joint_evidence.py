"""Evidence of all hypotheses in the linear model, from one table of inner products.

Every hypothesis frees some of the same columns, so its curvature and gradient are a part
of the full ones. That makes hundreds of hypotheses, with the smooth field and for many
vectors of residuals, cost little more than one.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.special import logsumexp

from storage.errors import InputError
from storage.values import BoolArray, FloatArray, IntArray
from workers.diagnosis.discrepancy import Discrepancy
from workers.diagnosis.effect_sensitivity import EffectSensitivity
from workers.diagnosis.evidence import Quadratic, log_marginal
from workers.diagnosis.hypotheses import Hypothesis
from workers.diagnosis.linearisation import Linearised


class JointEvidence:
    """Log evidences on the scale of `workers.diagnosis.evidence.log_evidence`.

    Parameters
    ----------
    problem : Linearised
        At the fit of the nominal parameters.
    sensitivities : sequence of EffectSensitivity
        With different names.
    discrepancy : Discrepancy, optional
        Of the same residuals; without it no smooth field is tried.
    replicates : ndarray, shape (m, n), optional
        Other residuals in place of those of the problem, whitened, of parameters at their
        prior means.

    Raises
    ------
    InputError
        If names repeat or numbers of residuals differ.
    """

    def __init__(
        self,
        problem: Linearised,
        sensitivities: Sequence[EffectSensitivity],
        discrepancy: Discrepancy | None = None,
        replicates: FloatArray | None = None,
    ) -> None:
        names = [f.name for f in sensitivities]
        if len(set(names)) < len(names):
            raise InputError(f"Each effect is listed once, found {names}.")
        if discrepancy is not None and discrepancy.size != problem.size:
            raise InputError(
                f"The discrepancy was made for {discrepancy.size} residuals, the problem has "
                f"{problem.size}. Make one for its points."
            )
        p = len(problem.nominal_sd)
        blocks: list[FloatArray] = [problem.scaled_nominal]
        sided: list[BoolArray] = [np.zeros(p, dtype=bool)]
        self._columns: dict[str, list[IntArray]] = {}
        for sensitivity in sensitivities:
            self._columns[sensitivity.name] = []
            for place in sensitivity.whitened(problem):
                start = sum(block.shape[1] for block in blocks)
                stop = start + place.shape[1]
                self._columns[sensitivity.name].append(np.arange(start, stop, dtype=np.int32))
                blocks.append(place)
                sided.append(sensitivity.one_sided)
        self._nominal = np.arange(p, dtype=np.int32)
        self._sided = np.concatenate(sided)
        self._offset = np.zeros(len(self._sided))
        if replicates is None:
            replicates = problem.whitened_residual[:, None]
            self._offset[:p] = problem.scaled_offset
        A = np.hstack(blocks)
        self._plain = [Quadratic((replicates**2).sum(axis=0), A.T @ replicates, A.T @ A)]
        self._field = [] if discrepancy is None else discrepancy.quadratics(A, replicates)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(self._columns)

    def log_evidence(self, effects: tuple[str, ...]) -> FloatArray:
        """Return that of some effects together, averaged over their places, shape (n,)."""
        return self._average(self._plain, effects)

    def discrepancy_gain(self, effects: tuple[str, ...]) -> FloatArray | None:
        """Return by how much the smooth field raises it, shape (n,); None without a field."""
        if not self._field:
            return None
        return self._average(self._field, effects) - self.log_evidence(effects)

    def hypothesis(self, effects: tuple[str, ...]) -> Hypothesis:
        """Return the evidence of some effects together, with and without the smooth field."""
        gain = self.discrepancy_gain(effects)
        plain = float(self.log_evidence(effects)[0])
        return Hypothesis(effects, plain, None if gain is None else float(gain[0]))

    def _average(self, quadratics: Sequence[Quadratic], effects: tuple[str, ...]) -> FloatArray:
        found = []
        for places in product(*(self._columns[name] for name in effects)):
            which = np.concatenate([self._nominal, *places])
            sided, offset = self._sided[which], self._offset[which]
            found += [log_marginal(q.of(which), offset, sided) for q in quadratics]
        return np.asarray(logsumexp(found, axis=0) - np.log(len(found)))
