"""Values: the noise of each output, where it is known from, and what is known of it: a level, or a bound with a direction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from greybox.noise.autoregression import AutoRegression
from greybox.values import Printable

WHITE = AutoRegression()


class NoiseSource(StrEnum):
    """Where the noise of an output is known from, the most trustworthy first."""

    GIVEN = "given"
    QUIET_RECORD = "quiet_record"
    REPEATED_PERIODS = "repeated_periods"
    REPEATED_EXPERIMENTS = "repeated_experiments"
    FLAT_PIECES = "flat_pieces"
    SPECTRUM = "spectrum"
    DIFFERENCES = "differences"
    RESIDUAL = "residual"
    INNOVATIONS = "innovations"

    @classmethod
    def _missing_(cls, value: object) -> NoiseSource | None:
        """The source that an older file names by a phrase."""
        phrases = {
            "quiet record": cls.QUIET_RECORD,
            "repeated periods": cls.REPEATED_PERIODS,
            "repeated experiments": cls.REPEATED_EXPERIMENTS,
            "the records' differences": cls.DIFFERENCES,
            "the residual of the fit": cls.RESIDUAL,
            "the innovations": cls.INNOVATIONS,
        }
        return phrases.get(str(value))

    @property
    def is_independent(self) -> bool:
        """Whether it does not use the records that are fitted."""
        return self in (NoiseSource.GIVEN, NoiseSource.QUIET_RECORD)

    @property
    def direction(self) -> BoundDirection:
        """What a level from this source says, where nothing else is known of it.

        Differences and the residual of a fit hold what the plant did too.
        """
        bounds = (NoiseSource.SPECTRUM, NoiseSource.DIFFERENCES, NoiseSource.RESIDUAL)
        return BoundDirection.AT_MOST if self in bounds else BoundDirection.ABOUT


class BoundDirection(StrEnum):
    """What a level says of the noise: this large, not larger, or not smaller."""

    ABOUT = "about"
    AT_MOST = "at_most"
    AT_LEAST = "at_least"


@dataclass(frozen=True)
class NoiseBound:
    """What is known of the noise of one output.

    Parameters
    ----------
    level
        Standard deviation in the unit of the output.
    direction
        Whether the noise is about as large, at most or at least.
    source
        Where this is known from.
    correlation_time
        How long the noise remembers in s: the sum of its autocorrelation from the first lag on, times the sampling period. None where
        that is not known.
    relative_error
        Standard deviation of the level over the level, from the number of samples it was estimated from.

    Examples
    --------
    >>> NoiseBound(0.03, BoundDirection.AT_MOST, NoiseSource.SPECTRUM).floor is None
    True
    """

    level: float
    direction: BoundDirection
    source: NoiseSource
    correlation_time: float | None = None
    relative_error: float = 0.0

    @property
    def floor(self) -> float | None:
        """The level that a perfect model would leave; None where only a bound is known."""
        return self.level if self.direction is BoundDirection.ABOUT else None

    @property
    def ceiling(self) -> float | None:
        """The level beyond which a residual is more than noise; None where nobody knows it."""
        return None if self.direction is BoundDirection.AT_LEAST else self.level


@dataclass(frozen=True)
class NoiseModel(Printable):
    """Level and colour of the noise of each output.

    Parameters
    ----------
    outputs
        Names of the model's outputs, in their order (ny).
    std : array (ny,)
        Standard deviations in the model's units: what a fit weighs its outputs with. Where only a ceiling is known they may lie below
        it. Of an output with too few samples for any source it is the spread of the measurement, until there is a fit with a residual.
    sources
        Where each is known from, by name of the measured outputs. An output that reads the same in every row has none.
    colour
        An autoregression for each output (ny), of order zero where the noise is white or its colour unknown.
    known
        Whether no level was estimated from the records that are fitted.
    bounds
        What is known of each, by name of the measured outputs; what a source says in general where one is missing.
    """

    outputs: tuple[str, ...]
    std: np.ndarray
    sources: Mapping[str, NoiseSource]
    colour: tuple[AutoRegression, ...]
    known: bool
    bounds: Mapping[str, NoiseBound] = field(default_factory=dict)

    @property
    def coloured(self) -> bool:
        """Whether the noise of any output is known to be coloured."""
        return any(a.order for a in self.colour)

    def bound(self, output: str) -> NoiseBound | None:
        """What is known of the noise of an output; None for one without a source."""
        source = self.sources.get(output)
        if output in self.bounds or source is None:
            return self.bounds.get(output)
        return NoiseBound(float(self.std[self.outputs.index(output)]), source.direction, source)

    @property
    def is_level_known(self) -> bool:
        """Whether the level of every output with a source is known, and not bounded only."""
        bounds = [self.bound(name) for name in self.sources]
        return all(b is not None and b.direction is BoundDirection.ABOUT for b in bounds)

    def ceiling_ratio(self, output: str) -> float:
        """How many times the standard deviation that is weighed with the noise may be: 1 where its level is known."""
        bound = self.bound(output)
        if bound is None or bound.direction is not BoundDirection.AT_MOST:
            return 1.0
        return max(bound.level / float(self.std[self.outputs.index(output)]), 1.0)
