"""Decisions about frequency responses: when a system is called nonlinear, and how a response is fitted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ApproximationPolicy:
    """How a best linear approximation is estimated."""

    excited_share: float = 1e-4
    """Amplitude of a line of the input, over the largest, from which it is excited."""
    period_error: float = 1e-2
    """Change of the input from one period to the next (rms, over its standard deviation), up to which it repeats; a measured input has
    noise."""
    least_periods: int = 2
    """Periods of a record that are needed after the transient: fewer show no noise."""
    false_alarm: float = 1e-3
    """Probability that a linear system is called nonlinear."""


@dataclass(frozen=True)
class ResponseFitPolicy:
    """How a model is fitted to a frequency response."""

    difference: float = 1e-6
    """Step of a parameter for the slope of the response, over its size."""
    log_iterations: int = 100
    """Most steps on the logarithm of the response, whose minimum is wide: resonances far from the data attract."""
    iterations: int = 200
    """Most steps on the response itself."""
    converged: float = 1e-3
    """Predicted decrease of the cost, in squared standard deviations, below which a search that cannot go on has ended well."""
    unknown_std: float = 0.01
    """Standard deviation of a point, over its magnitude, where the response states none; the intervals are then scaled by the residual."""
    exact: float = 1e-6
    """Error of points without a stated variance, over ``unknown_std``, below which it is rounding: beside records they weigh no more."""


DEFAULT_APPROXIMATION = ApproximationPolicy()
DEFAULT_RESPONSE_FIT = ResponseFitPolicy()
