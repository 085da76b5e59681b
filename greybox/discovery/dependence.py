"""In which region the unexplained signal lives: as a function of which variable, and of what shape.

The signal is averaged in bins of each variable. The share of its variance that the bins explain ranks the variables; the curve of
the best one is odd or even about zero, a step, bent, growing or periodic; a difference between the ways up and down is a loop; a line
in its spectrum that neither input nor motion have is a tone. What is proportional to a variable or constant is left out of the shape: the
fitted constants have absorbed it already.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from greybox.discovery.curve_shape import classify_shape, find_period
from greybox.values import ReadOnly

BINS = 16
# Shares of the variance: from where a variable counts, from where a loop does, and a tone.
WORTH, LOOP, TONE, DRIVEN = 0.15, 0.12, 0.5, 0.25
# A sinusoid over the variable is what it is from so much more than the share of the bins, or from this part of what they leave.
PERIODIC, LEFT = 0.1, 0.25
TIME = "time"


@dataclass(frozen=True)
class Dependence(ReadOnly):
    """The unexplained signal as a function of one variable.

    ``share`` of its variance that the curve explains (0 to 1); ``shape`` in words; ``parity`` ``odd``, ``even`` or ``neither``; ``loop``
    the further share that the direction of motion explains; ``tone`` in Hz of a spectral line, None without. ``centres``, ``mean``
    and ``std`` (B,) are the averages in bins and their standard deviations, in ``unit`` of the variable and in that of the signal.
    ``period`` in ``unit`` of a curve that repeats (cogging, a thread, a gear), None for another one.
    """

    variable: str
    unit: str
    share: float
    shape: str
    parity: str
    loop: float
    tone: float | None
    centres: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    period: float | None = None

    def __str__(self) -> str:
        if self.tone is not None:
            return f"a tone of {self.tone:.4g} Hz, whatever the motion ({100 * self.share:.0f} % of it)"
        looped = f", with a loop ({100 * self.loop:.0f} % more by the direction)" if self.loop > LOOP else ""
        return f"a function of {self.variable} ({100 * self.share:.0f} % of it): {self.shape}{looped}"


def rank_dependences(
    time: np.ndarray, w: np.ndarray, variables: Mapping[str, tuple[np.ndarray, str]], run: np.ndarray | None = None
) -> list[Dependence]:
    """The signal ``w`` (K,) as a function of each of ``variables`` (name -> values (K,) and unit), best first; a tone before all.

    ``run`` (K, n): states and inputs as they are without the signal, of which a tone must be no part; by default the variables.
    """
    w = w - w.mean()
    if not w.any():
        return []
    found = [_region(name, unit, z, w) for name, (z, unit) in variables.items() if np.ptp(z) > 0]
    found.sort(key=lambda r: -(r.share + max(r.loop - LOOP, 0.0)))
    driven = np.stack([z for z, _ in variables.values()], axis=1) if run is None else run
    line = find_tone(time, w, driven)
    if line is not None and not (found and found[0].share > line[1]):
        frequency, share = line
        found.insert(0, Dependence(TIME, "s", share, "a tone", "neither", 0.0, frequency, *np.zeros((3, 0))))
    return found


def find_tone(time: np.ndarray, w: np.ndarray, motion: np.ndarray) -> tuple[float, float] | None:
    """Frequency in Hz and share of one spectral line of ``w`` (K,) that neither inputs nor states (``motion``, (K, n)) have."""
    step = float(np.median(np.diff(time)))
    window = np.hanning(len(w))
    power = np.abs(np.fft.rfft(w * window)) ** 2
    power[:2] = 0.0  # what drifts is no tone
    if not power.any():
        return None
    top = int(np.argmax(power))
    near = slice(max(top - 2, 0), top + 3)
    share = float(power[near].sum() / power.sum())
    drive = np.abs(np.fft.rfft((motion - motion.mean(axis=0)) * window[:, None], axis=0)) ** 2
    total = drive.sum(axis=0)
    driven = float(np.max(np.where(total > 0, drive[near].sum(axis=0) / np.where(total > 0, total, 1.0), 0.0)))
    # The line's place between the bins, by the parabola through the three highest in dB.
    shift = 0.0
    if 0 < top < len(power) - 1 and min(power[top - 1 : top + 2]) > 0:
        left, middle, right = np.log(power[top - 1 : top + 2])
        shift = 0.5 * (left - right) / (left - 2 * middle + right)
    if share < TONE or driven > DRIVEN:
        return None
    return float((top + shift) / (len(w) * step)), share


def _region(name: str, unit: str, z: np.ndarray, w: np.ndarray) -> Dependence:
    edges = np.unique(np.quantile(z, np.linspace(0, 1, BINS + 1)))
    which = np.clip(np.searchsorted(edges, z, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(which, minlength=len(edges) - 1)
    used = count > 0
    centres, mean = (np.bincount(which, v, len(edges) - 1)[used] / count[used] for v in (z, w))
    scatter = np.bincount(which, w**2, len(edges) - 1)[used] / count[used] - mean**2
    std = np.sqrt(np.maximum(scatter, 0.0) / np.maximum(count[used] - 1, 1))
    share = _adjusted(w, which, len(edges) - 1)
    up = np.gradient(z) > 0
    both = _adjusted(w, 2 * which + up, 2 * (len(edges) - 1))
    both = max(both, share, 0.0)
    loop = both - max(share, 0.0)
    repeated, with_line, period = find_period(z, w)
    if repeated > WORTH and with_line - both > min(PERIODIC, LEFT * (1 - both)):
        shape = f"periodic, every {period:.3g} {unit}".rstrip()
        return Dependence(name, unit, with_line, shape, "neither", 0.0, None, centres, mean, std, period)
    parity, shape = classify_shape(centres, mean, count[used], unit)
    return Dependence(name, unit, max(share, 0.0), shape, parity, loop, None, centres, mean, std)


def _adjusted(w: np.ndarray, which: np.ndarray, bins: int) -> float:
    """Share of the variance between bins, less what chance would give."""
    count = np.bincount(which, minlength=bins)
    used = count > 0
    mean = np.bincount(which, w, bins)[used] / count[used]
    between = float(count[used] @ mean**2) / max(float(w @ w), 1e-300)
    free = len(w) - int(used.sum())
    return 1 - (1 - between) * (len(w) - 1) / free if free > 0 else 0.0
