"""How much further constants scatter from piece to piece of the records than their intervals say, where the model lacks something.

A model that lacks something has constants that depend on what the input does. The spread of their estimates over pieces of the
fit's own records, beside the spread that their covariances promise, is the factor by which these are too small (batch means; Carlstein,
Annals of Statistics 14, 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.change_detection.fitted_constants import FittedConstants, read_constants, read_residual
from greybox.change_detection.policy import ScatterPolicy
from greybox.estimation import FitOptions, fit
from greybox.estimation.restore import restore_noise
from greybox.experiment import Experiment
from greybox.linear_algebra import pseudo_inverse
from greybox.result import Fit


@dataclass(frozen=True, eq=False)
class EstimateScatter:
    """For each constant the factor (k,) by which its standard deviation is too small, at least one, with so many ``degrees`` of freedom."""

    factors: np.ndarray
    degrees: int

    def widen(self, constants: FittedConstants) -> FittedConstants:
        """The same estimates, each as uncertain as it scatters, known from few pieces."""
        covariance = constants.covariance * np.outer(self.factors, self.factors)
        return replace(constants, covariance=covariance, degrees=min(constants.degrees, float(self.degrees)))


def measure_scatter(fits: Sequence[Fit], constants: FittedConstants, policy: ScatterPolicy) -> EstimateScatter | None:
    """The scatter of the ``constants`` over pieces of the records of each fit, about its own mean; None where too few determine them."""
    deviations, covariances, means = list[np.ndarray](), list[np.ndarray](), 0
    for whole in fits:
        options = replace(FitOptions.from_data(whole.provenance.options), at_rest=False, progressive=False)
        values = []
        for piece in cut_records([trace.experiment for trace in whole.traces], policy):
            result = fit(whole.model, piece, noise=restore_noise(whole), options=options)
            if not result.success:
                continue
            of_piece = read_constants(result, read_residual(result, 1.0))
            if of_piece.names == constants.names and (of_piece.positive == constants.positive).all():
                values.append(of_piece.scaled)
                covariances.append(of_piece.covariance)
        if values:
            deviations += list(np.array(values) - np.mean(values, axis=0))
            means += 1
    degrees = len(deviations) - means
    if degrees < policy.least_pieces - 1:
        return None
    return EstimateScatter(_compare_spreads(np.array(deviations), np.array(covariances), means, policy), degrees)


def _compare_spreads(deviations: np.ndarray, covariances: np.ndarray, means: int, policy: ScatterPolicy) -> np.ndarray:
    """Spread over what was promised, of each constant and of all together; of deviations (m, k) from so many ``means``,
    with covariances (m, k, k).

    All together count as well: a combination that is determined well may scatter further than any constant by itself.
    """
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    known, factors = np.isfinite(variances), np.ones(deviations.shape[1])
    for k in np.flatnonzero(known.sum(axis=0) >= policy.least_pieces + means - 1):
        rows = known[:, k]
        promised = float(variances[rows, k].mean())
        spread = float((deviations[rows, k] ** 2).sum() / (rows.sum() - means))
        factors[k] = np.sqrt(max(spread / promised, 1.0)) if promised > 0 else 1.0
    whole = np.flatnonzero(known.all(axis=0))
    if not len(whole):
        return factors
    block = np.ix_(whole, whole)
    forms = [d[whole] @ pseudo_inverse(c[block]) @ d[whole] for d, c in zip(deviations, covariances, strict=True)]
    return np.maximum(factors, np.sqrt(sum(forms) / ((len(forms) - means) * len(whole))))


def cut_records(records: Sequence[Experiment], policy: ScatterPolicy) -> list[Experiment]:
    """The records, each cut into equal pieces so that there are as many as the policy asks for."""
    each = -(-policy.pieces // len(records))
    pieces = []
    for record in records:
        rows = record.rows // each
        if rows >= policy.least_rows:
            pieces += [record.window(k * rows, (k + 1) * rows) for k in range(each)]
        else:
            pieces.append(record)
    return pieces
