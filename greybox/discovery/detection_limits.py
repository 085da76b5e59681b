"""What could still hide: the smallest amplitude of each effect that these records would have shown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.discovery.problem import CandidateFit

# Standard deviations that an amplitude must exceed to be found nine times out of ten at a false-alarm rate of one per cent.
POWER = 3.3


def hidden(singles: Sequence[CandidateFit]) -> list[str]:
    """One sentence for each effect that was tried on a complete model."""
    return [sentence for t in singles if (sentence := _limit(t))]


def _limit(trial: CandidateFit) -> str:
    bound = trial.model.bound_effects[-1]
    own, variables = bound.model_names, trial.variables
    amplitudes = [own[name] for name in bound.effect.amplitudes if own[name] in variables.names]
    if not amplitudes:
        return ""
    covariance = np.linalg.pinv(trial.evaluation.hessian / 2, rcond=1e-12, hermitian=True)
    k = variables.names.index(amplitudes[0])
    std = float(np.sqrt(covariance[k, k]) * variables.spans[k])
    unit = trial.model.parameter(amplitudes[0]).unit
    return f"{bound.effect.name} could still hide below {amplitudes[0]} = {POWER * std:.2g} {unit}"
