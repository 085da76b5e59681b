"""When something is missing, when an effect is accepted, when it may be named: every threshold in one place."""

from __future__ import annotations

import math

from greybox.discovery.problem import CandidateFit
from greybox.noise import AutoRegression

# A first effect must lower the cost by this much more than its constants cost (Schwarz).
STRONG = 20.0
# It must close this share of the excess over the noise; a further one this share of the first excess.
FIRST_SHARE, FURTHER_SHARE = 0.1, 0.01
# A child effect must beat its parent by this much, or by this share of what the parent gained.
CHILD, CHILD_SHARE = 10.0, 0.003
# Rivals within this much cost explain the data as well.
TIE = 10.0
# Allowance of the noise floor for an inexact standard deviation, and for the integrator.
FLOOR = 0.05
# A remainder this small a share of the first excess is clean enough to give a name, up to this cost per sample.
REMAINDER, MOST = 0.003, 1.6
# A gap on the judging records counts from this multiple of the noise.
VISIBLE = 1.05
# Lags of the noise's autocorrelation that count.
MEMORY = 500
# Held out, a named effect must close this share of the gap; below the second it explains nothing there.
HELD_OUT, PARTLY = 0.9, 0.5


def noise_cost_limit(count: int) -> float:
    """Cost per sample that noise of exactly known level hardly ever exceeds."""
    return 1 + 4 * math.sqrt(2 / count)


def clean_cost_limit(count: int) -> float:
    """Cost per sample above which something other than noise is left."""
    return noise_cost_limit(count) + FLOOR


def visible_rms_limit(samples: int, colour: AutoRegression) -> float:
    """Rms over noise above which a record of ``samples`` shows more than noise; a coloured one holds fewer independent samples."""
    autocorrelation = colour.autocorrelation(min(samples, MEMORY))
    independent = samples / (1 + 2 * float(autocorrelation[1:] @ autocorrelation[1:]))
    return VISIBLE + 4 / math.sqrt(2 * independent)


def excess_cost(trial: CandidateFit) -> float:
    """What the model leaves beyond the noise, in units of cost."""
    return max(trial.cost - trial.count, 0.0)


def criterion_gain(smaller: CandidateFit, larger: CandidateFit) -> float:
    """How much the criterion falls from the smaller model to the larger."""
    return smaller.criterion - larger.criterion


def is_effect_accepted(base: CandidateFit, smaller: CandidateFit, larger: CandidateFit) -> bool:
    """Whether the effect that leads from ``smaller`` to ``larger`` is in the data.

    Beside a strong effect a weak one is a small share of the whole, and yet plain to see: it is accepted if only noise is left.
    """
    closed = smaller.cost - larger.cost
    if criterion_gain(smaller, larger) <= STRONG:
        return False
    if smaller is base:
        return closed >= FIRST_SHARE * excess_cost(base)
    last = larger.per_sample <= noise_cost_limit(larger.count) < smaller.per_sample
    return last or closed >= FURTHER_SHARE * excess_cost(base)


def is_residual_clean(base: CandidateFit, trial: CandidateFit) -> bool:
    """Whether nothing visible is left, so that a name may be given."""
    if trial.per_sample <= clean_cost_limit(trial.count):
        return True
    return excess_cost(trial) <= REMAINDER * excess_cost(base) and trial.per_sample < MOST
