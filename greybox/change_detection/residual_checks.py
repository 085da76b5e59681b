"""Is today's residual like that of the fit: as large, and as white? Where it is not, more than constants have changed."""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from greybox.change_detection.findings import ChangeRule
from greybox.change_detection.fitted_constants import FittedResidual
from greybox.change_detection.policy import ChangeTestPolicy
from greybox.findings import Check
from greybox.noise import join_series
from greybox.residuals.statistics import ljung_box_test


def check_residual(
    before: FittedResidual, after: FittedResidual, level: float, policy: ChangeTestPolicy
) -> tuple[Check, ...]:
    """p-values of each output's residual against their limit, which shares ``level`` out; none without a yardstick.

    The size by the ratio of variances, with fewer degrees of freedom where the residual is coloured (Bartlett 1935) or has heavier tails
    than normal noise (Box 1953); the colour by Ljung and Box where it was white before.
    """
    if not before.adequate:
        return ()
    shared = [name for name in before.outputs if name in after.outputs]
    tests: list[tuple[ChangeRule, str, float]] = []
    for name in shared:
        i, j = before.outputs.index(name), after.outputs.index(name)
        tests.append((ChangeRule.RESIDUAL_AS_LARGE, name, _compare_variances(before, i, after, j)))
        if not before.colour.models[i].order:
            series = join_series(after.series[j])
            lags = min(policy.lags, int(np.isfinite(series).sum()) // policy.rows_per_lag)
            if lags:
                tests.append((ChangeRule.RESIDUAL_AS_WHITE, name, ljung_box_test(series, lags)[1]))
    limit = level / max(len(tests), 1)
    return tuple(Check.at_least(rule, p, limit, name) for rule, name, p in tests)


def _compare_variances(before: FittedResidual, i: int, after: FittedResidual, j: int) -> float:
    one, other = before.colour.variance[i], after.colour.variance[j]
    if not one > 0:
        return 1.0
    kurtosis = max(
        before.kurtosis[i], 3.0
    )  # of the fit's residual: an effect that has appeared gives today's heavy tails
    tails = 2 / (kurtosis - 1)
    return float(fdtrc(after.degrees[j] * tails, before.degrees[i] * tails, other / one))
