"""Dependence of the unexplained signal on each variable.

The signal is averaged in bins of each variable. The share of its variance that the bins explain ranks the variables; the curve of
the best one is odd or even about zero, a step, bent, growing or periodic; a difference between the ways up and down is a loop; a line
in its spectrum that neither input nor motion have is a tone. What is proportional to a variable or constant is left out of the shape: the
fitted parameters have absorbed it already.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.discovery.curve_shape import CurveShape, ShapeKind, classify_shape, find_period
from greybox.discovery.policy import LocalisationPolicy
from greybox.numerics import TINY
from greybox.values import Printable, ReadOnly

# The variable of a tone.
TIME = "time"


@dataclass(frozen=True)
class Dependence(Printable, ReadOnly):
    """The unexplained signal as a function of one variable.

    Parameters
    ----------
    variable, unit
        The state, input or measured state, or ``time``, and its unit.
    share
        Share of the signal's variance that the curve explains, 0 to 1.
    shape
        What the curve looks like.
    loop
        Further share that the direction of motion explains.
    tone
        Frequency in Hz of a spectral line; None without one.
    centres, mean, std
        Averages in bins (B,), in the units of the variable and of the signal, and their standard deviations.
    period
        Of a curve that repeats over the variable (cogging, a thread, a gear), in its unit; None for another one.
    is_relevant
        Whether the signal counts as a function of this variable.
    has_loop
        Whether the direction of motion matters.
    """

    variable: str
    unit: str
    share: float
    shape: CurveShape
    loop: float
    tone: float | None
    centres: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    period: float | None = None
    is_relevant: bool = True
    has_loop: bool = False

    def to_values(self) -> dict[str, Any]:
        """What it says, without the averages, ready for a finding or for JSON."""
        return {
            "variable": self.variable,
            "unit": self.unit,
            "share": self.share,
            "shape": self.shape.kind,
            "parity": self.shape.parity,
            "downwards": self.shape.downwards,
            "position": self.shape.position,
            "loop": self.loop,
            "has_loop": self.has_loop,
            "tone": self.tone,
            "period": self.period,
        }


def rank_dependences(
    time: np.ndarray,
    w: np.ndarray,
    variables: Mapping[str, tuple[np.ndarray, str]],
    policy: LocalisationPolicy,
    run: np.ndarray | None = None,
) -> list[Dependence]:
    """The signal as a function of each of several variables, best first; a tone before all.

    Parameters
    ----------
    time, w
        Seconds and signal (K,).
    variables
        Name -> values (K,) and unit.
    policy
        From which shares a variable, a loop and a tone count.
    run
        States and inputs (K, n) as they are without the signal, of which a tone must be no part; by default the variables.
    """
    w = w - w.mean()
    if not w.any():
        return []
    ranked = [_depend_on(name, unit, z, w, policy) for name, (z, unit) in variables.items() if np.ptp(z) > 0]
    ranked.sort(key=lambda d: -(d.share + max(d.loop - policy.loop_share, 0.0)))
    motion = np.stack([z for z, _ in variables.values()], axis=1) if run is None else run
    tone = find_tone(time, w, motion, policy)
    if tone is not None and not (ranked and ranked[0].share > tone[1]):
        frequency, share = tone
        none, relevant = np.zeros(0), share > policy.dependence_share
        shape = CurveShape(ShapeKind.TONE)
        ranked.insert(0, Dependence(TIME, "s", share, shape, 0.0, frequency, none, none, none, None, relevant))
    return ranked


def find_tone(
    time: np.ndarray, w: np.ndarray, motion: np.ndarray, policy: LocalisationPolicy
) -> tuple[float, float] | None:
    """Frequency in Hz and share of one spectral line of ``w`` (K,) that neither inputs nor states (``motion``, (K, n)) have."""
    step = float(np.median(np.diff(time)))
    window = np.hanning(len(w))
    power = np.abs(np.fft.rfft(w * window)) ** 2
    power[:2] = 0.0  # drift is no tone
    if not power.any():
        return None
    top = int(np.argmax(power))
    near = slice(max(top - 2, 0), top + 3)
    share = float(power[near].sum() / power.sum())
    motion_power = np.abs(np.fft.rfft((motion - motion.mean(axis=0)) * window[:, None], axis=0)) ** 2
    total = motion_power.sum(axis=0)
    driven = float(np.max(np.where(total > 0, motion_power[near].sum(axis=0) / np.where(total > 0, total, 1.0), 0.0)))
    # The line's position between the bins, by the parabola through the three highest in dB.
    shift = 0.0
    if 0 < top < len(power) - 1 and min(power[top - 1 : top + 2]) > 0:
        left, middle, right = np.log(power[top - 1 : top + 2])
        shift = 0.5 * (left - right) / (left - 2 * middle + right)
    if share < policy.tone_share or driven > policy.driven_share:
        return None
    return float((top + shift) / (len(w) * step)), share


def _depend_on(name: str, unit: str, z: np.ndarray, w: np.ndarray, policy: LocalisationPolicy) -> Dependence:
    edges = np.unique(np.quantile(z, np.linspace(0, 1, policy.bins + 1)))
    which = np.clip(np.searchsorted(edges, z, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(which, minlength=len(edges) - 1)
    used = count > 0
    centres, mean = (np.bincount(which, v, len(edges) - 1)[used] / count[used] for v in (z, w))
    scatter = np.bincount(which, w**2, len(edges) - 1)[used] / count[used] - mean**2
    std = np.sqrt(np.maximum(scatter, 0.0) / np.maximum(count[used] - 1, 1))
    share = _adjusted_share(w, which, len(edges) - 1)
    upwards = np.gradient(z) > 0
    with_direction = _adjusted_share(w, 2 * which + upwards, 2 * (len(edges) - 1))
    with_direction = max(with_direction, share, 0.0)
    loop = with_direction - max(share, 0.0)
    sinusoid, with_line, period = find_period(z, w, policy.shape)
    gain_needed = min(policy.periodic_gain, policy.periodic_gain_of_rest * (1 - with_direction))
    if sinusoid > policy.dependence_share and with_line - with_direction > gain_needed:
        relevant = bool(with_line > policy.dependence_share)
        periodic = CurveShape(ShapeKind.PERIODIC)
        return Dependence(name, unit, with_line, periodic, 0.0, None, centres, mean, std, period, relevant)
    shape = classify_shape(centres, mean, count[used], policy.shape)
    share = max(share, 0.0)
    relevant = bool(share + loop > policy.dependence_share)
    has_loop = bool(loop > policy.loop_share)
    return Dependence(name, unit, share, shape, loop, None, centres, mean, std, None, relevant, has_loop)


def _adjusted_share(w: np.ndarray, which: np.ndarray, bins: int) -> float:
    """Share of the variance between bins, less what chance would give."""
    count = np.bincount(which, minlength=bins)
    used = count > 0
    mean = np.bincount(which, w, bins)[used] / count[used]
    between = float(count[used] @ mean**2) / max(float(w @ w), TINY)
    free = len(w) - int(used.sum())
    return 1 - (1 - between) * (len(w) - 1) / free if free > 0 else 0.0
