"""What a fit says of its constants, on the scale on which their estimates are nearest to normal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.estimation.options import FitOptions
from greybox.estimation.restore import restore_noise
from greybox.estimation.sandwich import ResidualColour, estimate_residual_colour
from greybox.noise import AutoRegression
from greybox.result import Fit, IntervalKind, Trace


@dataclass(frozen=True, eq=False)
class FittedConstants:
    """Estimated constants of one fit: the logarithm of a positive one, the value of any other.

    Parameters
    ----------
    names, units
        Of each constant (k,).
    values : array (k,)
        Estimates in their units.
    covariance : array (k, k)
        On the scale of the comparison; infinite on the diagonal where the records leave a constant open, NaN at a bound.
    positive : array (k,)
        Which of them are compared by their logarithm.
    at_bound
        Names of those that were stopped by a bound.
    degrees
        Degrees of freedom of the variance behind the covariance.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    positive: np.ndarray
    at_bound: tuple[str, ...]
    degrees: float

    def index(self, names: Sequence[str]) -> list[int]:
        """Positions of these constants."""
        return [self.names.index(name) for name in names]

    @property
    def scaled(self) -> np.ndarray:
        """The estimates (k,) on the scale of the comparison."""
        return np.where(self.positive, np.log(np.where(self.positive, self.values, 1.0)), self.values)

    @property
    def variances(self) -> np.ndarray:
        """Variances (k,) on that scale."""
        return np.diag(self.covariance)


@dataclass(frozen=True, eq=False)
class FittedResidual:
    """The residual of a fit over its noise.

    Parameters
    ----------
    outputs
        Names of the measured outputs (ny,).
    series
        For each output its residual over the noise, whitened where the noise's colour is known, one array for each record.
    colour
        Autoregression and variance of each.
    degrees : array (ny,)
        Independent samples behind each variance, less the share of the unknowns.
    kurtosis : array (ny,)
        Of each; 3 for normal noise.
    adequate
        Whether nothing but noise is left of it.
    """

    outputs: tuple[str, ...]
    series: tuple[tuple[np.ndarray, ...], ...]
    colour: ResidualColour
    degrees: np.ndarray
    kurtosis: np.ndarray
    adequate: bool


def read_constants(fit: Fit, residual: FittedResidual) -> FittedConstants:
    """The constants of ``fit`` that can be compared: estimated for all its records together, and no intensities of noise."""
    excluded = {*fit.model.noise_parameters, *fit.constraints.per_experiment}
    quantities = {q.name: q for q in fit.model.all_parameters}
    names = tuple(name for name in fit.uncertainty.free if name not in excluded and name in fit.parameters)
    places = [fit.uncertainty.free.index(name) for name in names]
    values = np.array([fit.parameters[name].value for name in names])
    positive = np.array([quantities[name].positive and fit.parameters[name].value > 0 for name in names], bool)
    slopes = np.where(positive, 1 / np.where(positive, values, 1.0), 1.0)
    # A colour that a short record shows by chance may make an interval narrower than a white residual would: not here.
    slopes /= np.array([min(_positive_or_one(fit.uncertainty.inflation.get(name, 1.0)), 1.0) for name in names])
    covariance = fit.uncertainty.covariance[np.ix_(places, places)] * np.outer(slopes, slopes)
    units = tuple(fit.parameters[name].unit for name in names)
    at_bound = tuple(name for name in names if fit.parameters[name].at_bound)
    open_ones = [k for k, name in enumerate(names) if fit.parameters[name].std is None and name not in at_bound]
    covariance[open_ones, open_ones] = np.inf
    return FittedConstants(names, units, values, covariance, positive, at_bound, _degrees(fit, residual))


def read_residual(fit: Fit, adequate_ratio: float) -> FittedResidual:
    """The residual of ``fit``; of a fit with process noise there is none to compare, as its runs follow the measurement."""
    noise, policy = restore_noise(fit), FitOptions.from_data(fit.provenance.options).policy
    names = [o.name for o in fit.model.outputs]
    measured = tuple(name for name in names if name in fit.misfit and name in fit.noise.std)
    series = tuple(
        tuple(
            _whitened_residual(trace, name, fit.noise.std[name], noise.colour[names.index(name)])
            for trace in fit.traces
        )
        for name in measured
    )
    rows = [(np.column_stack(each), np.empty((len(each[0]), 0, 0))) for each in zip(*series, strict=True)]
    unknowns = len(fit.uncertainty.free) + len(fit.traces) * len(fit.model.system.state_names)
    colour = estimate_residual_colour(rows, unknowns, False, None, policy.intervals, policy.noise)
    total = max(sum(colour.counts), 1)
    degrees, kurtosis = [], []
    for j, (count, (_, squares)) in enumerate(zip(colour.counts, colour.times, strict=True)):
        degrees.append(max((count - unknowns * count / total) / squares, 1.0))
        everything = np.concatenate(series[j])
        centred = everything - np.nanmean(everything)
        variance = float(np.nanmean(centred**2))
        kurtosis.append(float(np.nanmean(centred**4)) / variance**2 if variance > 0 else 3.0)
    ratios = [fit.misfit[name].noise_ratio for name in measured]
    adequate = not colour.coloured or max(ratios, default=0.0) <= adequate_ratio
    return FittedResidual(measured, series, colour, np.array(degrees), np.array(kurtosis), adequate)


def _positive_or_one(factor: float) -> float:
    return factor if factor > 0 else 1.0


def _whitened_residual(trace: Trace, output: str, std: float, colour: AutoRegression) -> np.ndarray:
    """The residual over the noise (N,), NaN where the record lacks the output."""
    if output not in trace.measured or output not in trace.simulated:
        return np.full(len(trace.time), np.nan)
    return colour.whiten(trace.residual(output) / std)


def _degrees(fit: Fit, residual: FittedResidual) -> float:
    """Degrees of freedom behind the intervals of ``fit``, by the rule that the estimation made them with."""
    if fit.prediction.process_noise:
        return float(np.inf)
    count = sum(residual.colour.counts)
    if fit.uncertainty.kind is IntervalKind.SANDWICH:
        return max(float(residual.degrees.sum()), 1.0)
    squares = sum(float(np.nansum(s**2)) for series in residual.series for s in series)
    left = max(count - residual.colour.unknowns, 1)
    return float(np.inf) if restore_noise(fit).known and squares <= left else float(left)
