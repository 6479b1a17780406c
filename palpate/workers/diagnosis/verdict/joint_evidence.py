"""Evidence for all hypotheses in the linear model, from one table of inner products.

Every hypothesis frees a subset of the same columns, so its curvature and gradient are parts of the
full arrays. Hundreds of hypotheses, with the smooth field and for many vectors of residuals,
therefore cost little more than one.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.special import logsumexp

from palpate.storage.errors import InputError
from palpate.storage.values import BoolArray, FloatArray, IntArray
from palpate.workers.diagnosis.algebra.effect_sensitivity import EffectSensitivity
from palpate.workers.diagnosis.algebra.evidence import Quadratic, log_marginal
from palpate.workers.diagnosis.noise.evidence import LinearHypothesis, NoiseModel, with_pose_scales
from palpate.workers.diagnosis.verdict.hypotheses import Hypothesis

AT_ONCE = 512  # number of places whose curvatures take a few megabytes


class JointEvidence:
    """Log evidences of effects at the nominal fit.

    Parameters
    ----------
    nominal : LinearHypothesis
        Linearisation at the fit of the nominal parameters.
    sensitivities : sequence of EffectSensitivity
        Sensitivities with distinct names.
    noise : NoiseModel
        Noise of the same residuals.

    Raises
    ------
    InputError
        If a name is repeated or the numbers of residuals differ.
    """

    def __init__(
        self,
        nominal: LinearHypothesis,
        sensitivities: Sequence[EffectSensitivity],
        noise: NoiseModel,
    ) -> None:
        names = [f.name for f in sensitivities]
        if len(set(names)) < len(names):
            raise InputError(f"Each effect must be listed once, found {names}.")
        if noise.size != len(nominal.residual):
            raise InputError(
                f"The noise model is for {noise.size} residuals, but the fit has "
                f"{len(nominal.residual)}. Create the noise model from the points of the fit."
            )
        p = nominal.columns.shape[1]
        blocks: list[FloatArray] = [nominal.columns]
        sided: list[BoolArray] = [nominal.one_sided]
        self._columns: dict[str, list[IntArray]] = {}
        for sensitivity in sensitivities:
            self._columns[sensitivity.name] = []
            for place in sensitivity.places:
                start = sum(block.shape[1] for block in blocks)
                stop = start + place.shape[1]
                self._columns[sensitivity.name].append(np.arange(start, stop, dtype=np.int32))
                blocks.append(place * sensitivity.prior_sd)
                sided.append(sensitivity.one_sided)
        self._nominal = np.arange(p, dtype=np.int32)
        self._sided = np.concatenate(sided)
        self._offset = np.zeros(len(self._sided))
        self._offset[:p] = nominal.offset
        self._is_pose = np.zeros(len(self._sided), np.bool_)
        self._is_pose[:p] = nominal.is_pose
        products = noise.products(np.hstack(blocks), nominal.residual)
        self._plain = noise.plain(products)
        self._field = noise.with_field(products) if noise.has_field else None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(self._columns)

    def log_evidence(self, effects: tuple[str, ...]) -> float:
        """Return the log evidence for effects acting together, averaged over places and noise."""
        return self._average(self._plain, effects)

    def hypothesis(self, effects: tuple[str, ...]) -> Hypothesis:
        """Return the evidence for effects acting together, with and without the smooth field."""
        alone = self.log_evidence(effects)
        if self._field is None:
            return Hypothesis(effects, alone)
        return Hypothesis(effects, alone, self._average(self._field, effects) - alone)

    def _average(self, q: Quadratic, effects: tuple[str, ...]) -> float:
        places = list(product(*(self._columns[name] for name in effects)))
        found = [self._at(q, places[i : i + AT_ONCE]) for i in range(0, len(places), AT_ONCE)]
        return float(logsumexp(found) - np.log(len(places)))

    def _at(self, q: Quadratic, places: Sequence[tuple[IntArray, ...]]) -> float:
        """Return the log of the evidence summed over places, noise states and pose scales."""
        which = np.array([np.concatenate([self._nominal, *place]) for place in places])
        any_place = which[0]
        freed = with_pose_scales(q.of(which), self._is_pose[any_place])
        found = log_marginal(freed, self._offset[any_place], self._sided[any_place])
        return float(logsumexp(found))
