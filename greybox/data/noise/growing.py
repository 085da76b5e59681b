"""Noise that grows with the signal: ``sd = a + b |y|``, a share of the reading, or a factor on it; told, or estimated from a residual."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from greybox.base import ModelError

# Least standard deviation of a row over the rms of all rows: a reading of zero is not free of noise, and must not decide a fit alone.
LEAST_SHARE_OF_RMS = 1e-4
# Values that are tried at a time when a part of the noise is looked for, and how often the best one's neighbourhood is divided anew:
# 40 / 2 to the sixth power narrows it by 6e7.
TRIED_VALUES = 41
NARROWINGS = 6


@dataclass(frozen=True)
class GrowingNoise:
    """Standard deviation ``floor + share |y|`` of the noise of one output, ``y`` being the model's run; a part that is None is estimated.

    The scales of measuring ranges, pipettes and flow meters: an error of the zero and one of the gain. The estimate is that of weighted
    least squares with the weights of the run before, in turn with the maximum of the normal likelihood of the residual over the parts that
    are not told (pseudo-likelihood; Carroll and Ruppert, Transformation and weighting in regression, 1988, chapter 3).

    Parameters
    ----------
    floor
        The part that is there without a signal, in the unit of the output; 0 for noise that is a share of the reading alone.
    share
        What comes to it, as a share of the reading. Of ``logarithmic`` noise the standard deviation of ``log(y)``.
    logarithmic
        The noise is a factor on the reading: the error is that of ``log(y)``, whose noise is the same throughout. All readings are
        positive, and there is no floor.
    estimated
        The parts that were estimated; set by a fit.

    Examples
    --------
    >>> GrowingNoise(floor=0.1, share=0.05).std(np.array([0.0, -4.0])).tolist()
    [0.1, 0.30000000000000004]
    >>> relative = GrowingNoise(floor=0.0)  # its share is estimated
    >>> relative.unknown
    ('share',)
    """

    floor: float | None = None
    share: float | None = None
    logarithmic: bool = False
    estimated: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.logarithmic:
            if self.floor:
                raise ModelError(
                    f"noise: a floor of {self.floor:g} with a logarithmic output; the noise of a logarithm has none: leave it out"
                )
            object.__setattr__(self, "floor", 0.0)
        for name in ("floor", "share"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise ModelError(
                    f"noise: {name} is {value}; give a number that is not negative, or leave it out: it is estimated"
                )
        if self.floor == 0 and self.share == 0:
            raise ModelError("noise: floor and share are both zero; give one of them, or leave it out: it is estimated")

    @property
    def unknown(self) -> tuple[str, ...]:
        """The parts that have no value yet."""
        return tuple(name for name in ("floor", "share") if getattr(self, name) is None)

    @property
    def is_told(self) -> bool:
        """Whether no part is estimated."""
        return not (self.unknown or self.estimated)

    def std(self, run: np.ndarray) -> np.ndarray:
        """Standard deviation (N,) of each row, from the run (N,) in the unit of the output; every part has a value."""
        if self.unknown:
            raise ModelError(
                f"noise: {' and '.join(self.unknown)} of a noise that grows with the signal is not known yet; fit first"
            )
        return _bound_below((self.floor or 0.0) + (self.share or 0.0) * np.abs(run))

    def scale_errors(self, measured: np.ndarray, run: np.ndarray) -> np.ndarray:
        """The error (N,) of each row over its noise; NaN where nothing was measured."""
        if self.logarithmic:
            with np.errstate(invalid="ignore", divide="ignore"):
                # ln y = ln f + share e: the error is a share of the reading.
                return (np.log(measured) - np.log(run)) / self.share
        return (measured - run) / self.std(run)

    def estimate(self, measured: np.ndarray, run: np.ndarray, inflation: float = 1.0) -> GrowingNoise:
        """With the parts that are not told at their most likely values; the same where everything is told.

        Parameters
        ----------
        measured, run
            Readings and run (N,), NaN in gaps.
        inflation
            By how much the squares of the residual are too small, since constants were fitted to it: ``N / (N - p)``.
        """
        wanted = self.unknown or self.estimated
        usable = np.isfinite(measured) & np.isfinite(run)
        if not wanted or not usable.any():
            return self
        size = np.abs(run[usable])
        if self.logarithmic:
            # The most likely variance of normal errors is their mean square.
            errors = np.log(measured[usable] / run[usable]) ** 2 * inflation
            return replace(self, share=float(np.sqrt(errors.mean())), estimated=wanted)
        squares = (measured[usable] - run[usable]) ** 2 * inflation
        rms, middle = float(np.sqrt(squares.mean())), float(size.mean())
        if rms == 0 or middle == 0:
            return self
        if len(wanted) == 2:
            # sd = scale (1 - q + q |y| / mean |y|): the scale follows from q, which lies between no growth and no floor.
            def shape(q: np.ndarray) -> np.ndarray:
                return _bound_below(1 - q[:, None] + q[:, None] * size / middle)

            def likelihood(q: np.ndarray) -> np.ndarray:
                g = shape(q)
                # -2 ln L / N at the most likely scale, a constant left out: ln mean(e^2 / g^2) + mean(2 ln g).
                return np.log((squares / g**2).mean(axis=1)) + 2 * np.log(g).mean(axis=1)

            q = _find_least(likelihood, 0.0, 1.0)
            scale = float(np.sqrt((squares / shape(np.array([q]))[0] ** 2).mean()))
            return replace(self, floor=scale * (1 - q), share=scale * q / middle, estimated=wanted)
        # The other part is told: -2 log L / N = mean(e^2 / s^2 + 2 log s).
        is_floor = wanted == ("floor",)
        known = (self.share or 0.0) * size if is_floor else np.full(len(size), self.floor or 0.0)
        slope = np.ones(len(size)) if is_floor else size

        def likelihood_of_part(part: np.ndarray) -> np.ndarray:
            s = np.maximum(_bound_below(known + part[:, None] * slope), LEAST_SHARE_OF_RMS * rms)
            return (squares / s**2 + 2 * np.log(s)).mean(axis=1)

        # More than would explain the largest error alone is less likely than that.
        most = float(
            np.sqrt(squares.max() / np.maximum(slope[squares.argmax()] ** 2, (LEAST_SHARE_OF_RMS * middle) ** 2))
        )
        part = _find_least(likelihood_of_part, 0.0, max(most, 10 * rms / (1.0 if is_floor else middle)))
        return replace(self, floor=part, estimated=wanted) if is_floor else replace(self, share=part, estimated=wanted)


def _bound_below(std: np.ndarray) -> np.ndarray:
    """``std`` (..., N) with no row below a small share of the rms of all rows."""
    with np.errstate(invalid="ignore"):
        rms = np.sqrt(np.nanmean(std**2, axis=-1, keepdims=True))
    return np.maximum(std, LEAST_SHARE_OF_RMS * rms)


def _find_least(function: Callable[[np.ndarray], np.ndarray], low: float, high: float) -> float:
    """Where ``function``, which takes many values at once, is least between two values: a grid that is narrowed around its least value."""
    for _ in range(NARROWINGS):
        tried = np.linspace(low, high, TRIED_VALUES)
        k = int(np.argmin(function(tried)))
        low, high = tried[max(k - 1, 0)], tried[min(k + 1, TRIED_VALUES - 1)]
    return float(tried[k])
