"""What Monte-Carlo smoothing finds: equation 17, as a step response, as a difference equation, and in the s-domain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from greybox.blackbox.continuous import ContinuousTransferFunction
from greybox.blackbox.findings import BlackBoxFinding
from greybox.blackbox.monte_carlo_smoothing.grid_search import DrawCounts, StepResponseConstants
from greybox.blackbox.monte_carlo_smoothing.intervals import AXES, DrawIntervals
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.responses import InitialChoice
from greybox.experiment import Experiment
from greybox.findings import Finding, Severity
from greybox.numerics import NEGLIGIBLE_JUMP
from greybox.values import Printable

SYMBOLS = {"amplitude": "A", "ratio": "r", "phase": "theta", "frequency": "w", "decay": "sigma"}
KIND = "monte-carlo smoothing"


@dataclass(frozen=True)
class SmoothingRound:
    """The evaluations between two adjustments of the intervals: ``candidates``, the best of each evaluation."""

    intervals: DrawIntervals
    candidates: tuple[StepResponseConstants, ...]

    @property
    def best(self) -> StepResponseConstants:
        """The best of them all."""
        return min(self.candidates, key=lambda c: c.error)


@dataclass(frozen=True, eq=False)
class MonteCarloSmoothing(Printable):
    """A step response ``yhat(t) = A {1 - r e^(-sigma t) sin(w t + theta)}`` after a step of ``height``, and the model behind it.

    ``best`` holds the five constants and the mean square error (equation 1) over ``samples`` rows after the step. ``rounds`` are
    the evaluations (none for constants from elsewhere), ``specification`` the error that was asked for. `simulate`, `predict` and
    the rest are those of ``model``, its exact difference equation for a held input.
    """

    output: str
    input: str
    sampling_time: float
    height: float
    best: StepResponseConstants
    samples: int
    rounds: tuple[SmoothingRound, ...] = ()
    draws: DrawCounts = field(default_factory=DrawCounts)
    specification: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def coefficients(self) -> dict[str, float]:
        """The constants by their letters in equation 17: A, r, theta, w, sigma."""
        return {SYMBOLS[axis]: getattr(self.best, axis) for axis in AXES}

    @property
    def error(self) -> float:
        """Mean square error over the step response, in the output's unit squared."""
        return self.best.error

    @property
    def met(self) -> bool | None:
        """Whether the error meets the specification; None where there was none."""
        return None if self.specification is None else self.error <= self.specification

    def response(self, time: np.ndarray) -> np.ndarray:
        """Equation 17 at ``time`` in seconds after the step; zero before it."""
        b, t = self.best, np.asarray(time, float)
        swing = b.ratio * np.exp(-b.decay * np.maximum(t, 0)) * np.sin(b.frequency * t + b.phase)
        return np.where(t >= 0, b.amplitude * (1 - swing), 0.0)

    @property
    def jump(self) -> float:
        """What equation 17 does at once, ``yhat(0+) = A (1 - r sin(theta))``: zero for anything with a mass."""
        return float(self.best.amplitude * (1 - self.best.ratio * np.sin(self.best.phase)))

    @property
    def damping(self) -> float:
        """Damping ratio ``sigma / sqrt(sigma^2 + w^2)``."""
        return float(self.best.decay / np.hypot(self.best.decay, self.best.frequency))

    @property
    def delay(self) -> float:
        """The delay in seconds that the phase shows, ``(arccos(zeta) - theta) / w``.

        A second-order system without a zero has ``theta = arccos(zeta)`` and ``r = 1 / sqrt(1 - zeta^2)``; the same response
        ``Td`` later has ``theta - w Td`` and ``r e^(sigma Td)`` in their place.
        """
        return float((np.arccos(self.damping) - self.best.phase) / self.best.frequency)

    @property
    def transfer_function(self) -> ContinuousTransferFunction:
        """The transfer function of equation 17 over the step's height, with the feed-through that ``r`` and ``theta`` leave."""
        b = self.best
        sine, cosine = b.ratio * np.sin(b.phase), b.ratio * np.cos(b.phase)
        above = np.array([1 - sine, b.decay * (2 - sine) - b.frequency * cosine, b.decay**2 + b.frequency**2])
        below = np.array([1.0, 2 * b.decay, b.decay**2 + b.frequency**2])
        return ContinuousTransferFunction(b.amplitude / self.height * above, below)

    @cached_property
    def model(self) -> PolynomialModel:
        """The exact difference equation for an input held between samples, ``y = (b0 + b1 q^-1 + b2 q^-2) / F(q) u + e``."""
        b, h = self.best, self.sampling_time
        f = np.array([1.0, -2 * np.exp(-b.decay * h) * np.cos(b.frequency * h), np.exp(-2 * b.decay * h)])
        first = self.response(h * np.arange(3)) / self.height
        # y = B / F applied to a step: its first three rows give the three numbers of B
        numbers = np.convolve(f, first)[:3] - np.append(0.0, np.convolve(f, first)[:2])
        numbers[2] = b.amplitude / self.height * f.sum() - numbers[0] - numbers[1]
        return PolynomialModel(
            KIND,
            self.output,
            (self.input,),
            h,
            (0,),
            (numbers,),
            f=(f,),
            noise_std=float(np.sqrt(self.error)),
            samples=self.samples,
            loss=self.error,
            history="zero",
            focus="simulation",
            units=self.units,
            findings=self.findings,
        )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What one should know before trusting it."""
        findings = []
        if abs(self.jump) > NEGLIGIBLE_JUMP * abs(self.best.amplitude):
            values = {
                "jump": self.jump,
                "unit": self.units.get(self.output, ""),
                "delay": self.delay,
                "samples": self.delay / self.sampling_time,
            }
            findings.append(Finding(BlackBoxFinding.SMOOTHING_FEEDTHROUGH, Severity.WARNING, self.output, values))
        at_end = [
            SYMBOLS[axis]
            for axis in AXES
            for last in self.rounds[-1:]
            if _is_near_end(getattr(self.best, axis), getattr(last.intervals, axis), getattr(self.draws, axis))
        ]
        if at_end:
            values = {"constants": at_end}
            findings.append(Finding(BlackBoxFinding.SMOOTHING_AT_INTERVAL_END, Severity.WARNING, values=values))
        if self.met is False:
            values = {"error": self.error, "specification": self.specification}
            findings.append(Finding(BlackBoxFinding.SMOOTHING_ABOVE_SPECIFICATION, Severity.WARNING, values=values))
        return tuple(findings)

    kind = KIND

    @property
    def inputs(self) -> tuple[str, ...]:
        """The one input."""
        return (self.input,)

    @property
    def label(self) -> str:
        """What it is called in tables."""
        return KIND

    @property
    def parameters(self) -> int:
        """Number of constants."""
        return len(AXES)

    @property
    def poles(self) -> np.ndarray:
        """Poles in the z-plane (2,)."""
        return self.model.poles

    @property
    def stable(self) -> bool:
        """Whether both poles lie inside the unit circle."""
        return self.model.stable

    @property
    def feedthrough(self) -> dict[str, float]:
        """Direct share of the input in the output of the same row."""
        return self.model.feedthrough

    def simulate(
        self, experiment: Experiment, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Free run, as `PolynomialModel.simulate`."""
        return self.model.simulate(experiment, initial=initial, rows=rows)

    def predict(
        self, experiment: Experiment, steps: int = 1, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Prediction, as `PolynomialModel.predict`: the free run, since equation 17 has no noise model."""
        return self.model.predict(experiment, steps, initial=initial, rows=rows)

    def errors(self, experiment: Experiment, *, initial: InitialChoice = "estimated") -> np.ndarray:
        """One-step errors (N,), as `PolynomialModel.errors`."""
        return self.model.errors(experiment, initial=initial)

    def to_control(self) -> Any:
        """A discrete `control.TransferFunction`."""
        return self.model.to_control()


def _is_near_end(value: float, interval: tuple[float, float], count: int) -> bool:
    """Whether ``value`` lies within the mean distance of ``count`` draws from an end of its ``interval``."""
    low, high = interval
    gap = (high - low) / (count + 1)
    return not low + gap < value < high - gap
