"""The profile of a constant of a fit by its predictions: refits of the likelihood with the constant held."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from greybox.estimation.likelihood_search import fisher_scoring, hold_parameters, maximise_likelihood
from greybox.estimation.options import FitOptions
from greybox.estimation.prediction_error import PredictionErrorObjective
from greybox.transcription import DecisionVector
from greybox.transcription.decision_vector import SHARED

# -2 log L of a profile is minimised to this.
CLOSE = 1e-4


@dataclass(frozen=True)
class HeldLikelihood:
    """The likelihood with the free constant number ``k`` of ``cost`` held elsewhere, everything else estimated anew."""

    cost: PredictionErrorObjective
    k: int
    least: float
    scale: float

    def rise(self, value: float, near: DecisionVector | None) -> tuple[float, DecisionVector]:
        """Rise of the least ``-2 log L`` over ``scale`` with the constant at ``value``, from ``near`` on; infinite without a fit."""
        v = self.cost.unknowns.variables
        name, owner, which = v.quantities[self.k].name, int(v.owner[self.k]), int(v.which[self.k])
        mean, std = v.prior[self.k]
        if owner == SHARED:
            start = self.cost if near is None else self._with(near)
            held = hold_parameters(start, {name: value})
        else:  # of the other experiments it stays a constant of their own
            given = [dict(c) for c in v.conditions or [{}] * v.experiments]
            given[owner][which] = value
            there = v.without(np.arange(len(v.which)) == self.k) if near is None else near
            held = self._with(replace(there, conditions=tuple(given)))
        found = fisher_scoring(held, CLOSE)
        if not found.status.success:
            found = maximise_likelihood(found.cost, FitOptions())
        cost = found.evaluation.cost + ((value - mean) / std) ** 2
        rise = max(cost - self.least, 0.0) / self.scale if np.isfinite(cost) else np.inf
        return rise, found.cost.unknowns.variables

    def _with(self, variables: DecisionVector) -> PredictionErrorObjective:
        return self.cost.at(replace(self.cost.unknowns, variables=variables))
