"""The shape of a curve in a control engineer's terms: a step, a flat middle, a bend, a square, a period.

What is constant or proportional to the variable is removed from curve and templates alike: the model's own parameters (a spring, a
damper, an offset) have absorbed it, and no data can tell it from theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np

from greybox.base.numerics import TINY
from greybox.base.values import Printable, ReadOnly

Remainder = Callable[[np.ndarray], np.ndarray]


# Values closer than this share of the range are one level: the resolution of a converter and the noise of a reading spread it so far, and
# a curve that repeats forty times over the range still has five levels in each period.
LEVEL_WIDTH = 0.005
# Levels that must be seen of a variable: over two, any function is a straight line, which the model has already.
FEWEST_LEVELS = 3


def find_levels(z: np.ndarray) -> np.ndarray:
    """The distinct levels (L,) of values (K,), each the mean of those that are the same within their resolution."""
    ordered = np.sort(z)
    width = LEVEL_WIDTH * float(ordered[-1] - ordered[0])
    first, starts = ordered[0], [0]
    for k, value in enumerate(ordered):
        if value - first > width:
            first = value
            starts.append(k)
    return np.array([part.mean() for part in np.split(ordered, starts[1:])])


class Parity(StrEnum):
    """Symmetry of a curve about zero."""

    ODD = "odd"
    EVEN = "even"
    NEITHER = "neither"


class ShapeKind(StrEnum):
    """What a curve looks like."""

    TOO_FEW_VALUES = "too_few_values"
    """Too few values to say."""
    STRAIGHT = "straight"
    """Nothing beyond a straight line."""
    STEP = "step"
    """A step where the variable passes zero."""
    FLAT_MIDDLE = "flat_middle"
    """Zero up to a distance from the origin, straight beyond: play, a dead zone, a stop."""
    CUBIC = "cubic"
    """Odd, growing faster than in proportion."""
    ODD_SQUARE = "odd_square"
    """Odd, growing with the square."""
    SQUARE = "square"
    """Even, growing with the square."""
    KINK = "kink"
    """Even, with a kink at zero."""
    BEND = "bend"
    """Two straight lines that meet at a position."""
    CURVED = "curved"
    """On one side of zero, curving upwards or downwards."""
    PERIODIC = "periodic"
    """It repeats over the variable."""
    TONE = "tone"
    """A sinusoid in time, whatever the motion."""
    UNNAMED = "unnamed"
    """None of these; its parity may still be known."""


@dataclass(frozen=True)
class CurveShape:
    """What a curve looks like.

    Parameters
    ----------
    kind
        Which shape.
    parity
        Its symmetry about zero.
    downwards
        Whether it is the shape turned upside down.
    position
        Of a bend, or half the width of a flat middle, in the unit of the variable; None for other shapes.
    """

    kind: ShapeKind
    parity: Parity = Parity.NEITHER
    downwards: bool = False
    position: float | None = None


# Share of an odd (or even) part from which a curve is odd (or even).
PARITY_SHARE = 0.75
# Share that a template must explain to give its name.
NAMED_SHARE = 0.6
# Share that a bend between two straight lines must explain.
BEND_SHARE = 0.9
# Share of the reach below which a curve lies on one side of zero.
ONE_SIDE_SHARE = 0.2
# Positions of a bend, and widths of a flat middle, that are tried.
SHAPE_POSITIONS = 33
# A shape with a free position must reduce what the others leave unexplained to this share of it.
FREE_WIDTH_RATIO = 0.5


def classify_shape(z: np.ndarray, f: np.ndarray, count: np.ndarray) -> CurveShape:
    """Shape of the curve ``f`` (B,) at ``z`` (B,), with ``count`` (B,) samples at each."""
    reach = float(np.abs(z).max())
    if len(z) < 6 or reach == 0:
        return CurveShape(ShapeKind.TOO_FEW_VALUES)
    s, root = z / reach, np.sqrt(count / count.sum())
    line = np.linalg.qr(np.stack([root, root * s], axis=1))[0]

    def remainder(values: np.ndarray) -> np.ndarray:
        weighted = root * values
        return weighted - line @ (line.T @ weighted)

    curve = remainder(f)
    if not curve.any():
        return CurveShape(ShapeKind.STRAIGHT)
    position, share = _find_bend(s, curve, remainder, SHAPE_POSITIONS)
    parabola = _likeness(curve, remainder(s**2))
    bends = share > BEND_SHARE and 1 - share < FREE_WIDTH_RATIO * (1 - parabola**2)
    if s.min() > -ONE_SIDE_SHARE or s.max() < ONE_SIDE_SHARE:
        if bends:
            return CurveShape(ShapeKind.BEND, position=reach * position)
        if parabola**2 < NAMED_SHARE:
            return CurveShape(ShapeKind.UNNAMED)
        return CurveShape(ShapeKind.CURVED, downwards=not parabola > 0)
    parity = _parity(s, f, remainder, PARITY_SHARE)
    shape, likeness = _match_template(s, curve, remainder, parity, reach)
    if likeness > NAMED_SHARE:
        return shape
    if bends:
        return CurveShape(ShapeKind.BEND, parity, position=reach * position)
    return CurveShape(ShapeKind.UNNAMED, parity)


def _parity(s: np.ndarray, f: np.ndarray, remainder: Remainder, limit: float) -> Parity:
    mirrored = np.interp(-s, s, f)
    shared = np.abs(s) <= min(s.max(), -s.min())
    odd, even = (remainder(np.where(shared, (f + k * mirrored) / 2, 0.0)) for k in (-1, 1))
    total = float(odd @ odd + even @ even)
    odd_share = float(odd @ odd) / total if total > 0 else 0.5
    if odd_share > limit:
        return Parity.ODD
    return Parity.EVEN if odd_share < 1 - limit else Parity.NEITHER


# Half-width of a flat middle over the reach: a narrower one is the far side of a step.
NARROWEST_MIDDLE = 0.2


def _match_template(
    s: np.ndarray, curve: np.ndarray, remainder: Remainder, parity: Parity, reach: float
) -> tuple[CurveShape, float]:
    """The template of this parity that is most like the ``curve``, and the share of it that it explains."""
    templates = {
        ShapeKind.STEP: (Parity.ODD, np.tanh(s / 0.1)),
        ShapeKind.CUBIC: (Parity.ODD, s**3),
        ShapeKind.ODD_SQUARE: (Parity.ODD, s * np.abs(s)),
        ShapeKind.SQUARE: (Parity.EVEN, s**2),
        ShapeKind.KINK: (Parity.EVEN, np.abs(s)),
    }
    matches = [
        (_likeness(curve, remainder(t)), kind)
        for kind, (template_parity, t) in templates.items()
        if template_parity == parity
    ]
    best, kind = max(matches, key=lambda match: abs(match[0]), default=(0.0, ShapeKind.UNNAMED))
    position = None
    if parity is Parity.ODD:
        widths = np.linspace(NARROWEST_MIDDLE, 0.9, SHAPE_POSITIONS)
        flat = [_likeness(curve, remainder(np.sign(s) * np.maximum(np.abs(s) - c, 0))) for c in widths]
        k = int(np.argmax(np.abs(flat)))
        if 1 - flat[k] ** 2 < FREE_WIDTH_RATIO * (1 - best**2):
            best, kind, position = flat[k], ShapeKind.FLAT_MIDDLE, float(widths[k] * reach)
    return CurveShape(kind, parity, bool(best < 0), position), best**2


def _find_bend(s: np.ndarray, curve: np.ndarray, remainder: Remainder, positions: int) -> tuple[float, float]:
    """Where the curve bends if it is straight on both sides, and the share of it that this explains."""
    places = np.linspace(s.min(), s.max(), positions + 2)[1:-1]
    shares = [_likeness(curve, remainder(np.maximum(s - c, 0))) ** 2 for c in places]
    best = int(np.argmax(shares))
    return float(places[best]), shares[best]


def _likeness(a: np.ndarray, b: np.ndarray) -> float:
    return float(a @ b) / np.sqrt(max(float(a @ a) * float(b @ b), TINY))


# Periods over the range from which a curve counts as periodic.
SHAPE_FEWEST_PERIODS = 3.0
# Periods over the range up to which one is looked for.
MOST_PERIODS = 40.0
# Steps of the search over the number of periods.
STEPS_PER_PERIOD = 20


def find_period_of_curve(z: np.ndarray, w: np.ndarray) -> tuple[float, float, float]:
    """The sinusoid over ``z`` (K,) that explains most of ``w`` (K,) beside a straight line: its share of the variance, that of both, and
    its period in ``z``."""
    reach = float(np.ptp(z))
    # Two levels a period at least: with fewer, any values lie on a sinusoid of some short period.
    most = min(MOST_PERIODS, len(find_levels(z)) / 2)
    turns = np.arange(SHAPE_FEWEST_PERIODS, most, 1 / STEPS_PER_PERIOD)
    if not len(turns):
        return 0.0, 0.0, reach
    left = np.linalg.qr(np.stack([np.ones_like(z), z - z.mean()], axis=1))[0]
    rest = w - left @ (left.T @ w)
    angle = 2 * np.pi * np.outer((z - z.min()) / reach, turns)
    c, s = (m - left @ (left.T @ m) for m in (np.cos(angle), np.sin(angle)))
    cc, ss, cs = (np.sum(a * b, axis=0) for a, b in ((c, c), (s, s), (c, s)))
    wc, ws = rest @ c, rest @ s
    determinant = np.maximum(cc * ss - cs**2, 1e-12 * len(z) ** 2)
    gained = (wc**2 * ss - 2 * wc * ws * cs + ws**2 * cc) / determinant
    best = int(np.argmax(gained))
    around = w - w.mean()
    total = max(float(around @ around), TINY)
    sinusoid, line = float(gained[best]) / total, 1 - float(rest @ rest) / total
    shift = 0.0
    if 0 < best < len(turns) - 1:  # between the steps, by the parabola through the three highest
        before, at, after = gained[best - 1 : best + 2]
        shift = 0.5 * float((before - after) / min(before - 2 * at + after, -TINY))
    return sinusoid, sinusoid + line, reach / float(turns[best] + shift / STEPS_PER_PERIOD)


# Dependence of the unexplained signal on each variable.
#
# The signal is averaged in bins of each variable. The share of its variance that the bins explain ranks the variables; the curve of
# the best one is odd or even about zero, a step, bent, growing or periodic; a difference between the ways up and down is a loop; a line
# in its spectrum that neither input nor motion have is a tone. What is proportional to a variable or constant is left out of the shape: the
# fitted parameters have absorbed it already.

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

    KEYS: ClassVar[str] = """
        variable unit share shape=shape.kind parity=shape.parity downwards=shape.downwards position=shape.position loop has_loop tone
        period centres mean std
        """


# Share of the signal's variance from which it counts as a function of a variable.
DEPENDENCE_SHARE = 0.15
# Further share that the direction of motion must explain for a loop.
LOOP_SHARE = 0.12


def rank_dependences(
    time: np.ndarray,
    w: np.ndarray,
    variables: Mapping[str, tuple[np.ndarray, str]],
    run: np.ndarray | None = None,
) -> list[Dependence]:
    """The signal as a function of each of several variables, best first; a tone before all.

    Parameters
    ----------
    time, w
        Seconds and signal (K,).
    variables
        Name -> values (K,) and unit.
    run
        States and inputs (K, n) as they are without the signal, of which a tone must be no part; by default the variables.
    """
    w = w - w.mean()
    if not w.any():
        return []
    ranked = [_depend_on(name, unit, z, w) for name, (z, unit) in variables.items() if np.ptp(z) > 0]
    ranked.sort(key=lambda d: -(d.share + max(d.loop - LOOP_SHARE, 0.0)))
    # A site may have no variable of its own: then the signal can be no more than a tone.
    motion = np.reshape([z for z, _ in variables.values()], (len(variables), len(w))).T if run is None else run
    tone = find_tone(time, w, motion)
    if tone is not None and not (ranked and ranked[0].share > tone[1]):
        frequency, share = tone
        none, relevant = np.zeros(0), share > DEPENDENCE_SHARE
        shape = CurveShape(ShapeKind.TONE)
        ranked.insert(0, Dependence(TIME, "s", share, shape, 0.0, frequency, none, none, none, None, relevant))
    return ranked


# Share of the signal's power in one spectral line from which it is a tone.
TONE_SHARE = 0.5
# Share of the power of an input or a state in that line above which it is driven and no tone from outside.
DRIVEN_SHARE = 0.25


def find_tone(time: np.ndarray, w: np.ndarray, motion: np.ndarray) -> tuple[float, float] | None:
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
    in_line = motion_power[near].sum(axis=0) / np.where(total > 0, total, 1.0)
    driven = float(np.max(np.where(total > 0, in_line, 0.0), initial=0.0))
    # The line's position between the bins, by the parabola through the three highest in dB.
    shift = 0.0
    if 0 < top < len(power) - 1 and min(power[top - 1 : top + 2]) > 0:
        left, middle, right = np.log(power[top - 1 : top + 2])
        shift = 0.5 * (left - right) / (left - 2 * middle + right)
    if share < TONE_SHARE or driven > DRIVEN_SHARE:
        return None
    return float((top + shift) / (len(w) * step)), share


# Bins of a variable in which the signal is averaged.
LOCALISATION_BINS = 16
# Share by which a sinusoid over the variable must explain more than the bins.
PERIODIC_GAIN = 0.1
# Share of what the bins leave that is enough.
PERIODIC_GAIN_OF_REST = 0.25


def _depend_on(name: str, unit: str, z: np.ndarray, w: np.ndarray) -> Dependence:
    edges = np.unique(np.quantile(z, np.linspace(0, 1, LOCALISATION_BINS + 1)))
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
    sinusoid, with_line, period = find_period_of_curve(z, w)
    gain_needed = min(PERIODIC_GAIN, PERIODIC_GAIN_OF_REST * (1 - with_direction))
    if sinusoid > DEPENDENCE_SHARE and with_line - with_direction > gain_needed:
        relevant = bool(with_line > DEPENDENCE_SHARE)
        periodic = CurveShape(ShapeKind.PERIODIC)
        return Dependence(name, unit, with_line, periodic, 0.0, None, centres, mean, std, period, relevant)
    shape = classify_shape(centres, mean, count[used])
    share = max(share, 0.0)
    relevant = bool(share + loop > DEPENDENCE_SHARE)
    has_loop = bool(loop > LOOP_SHARE)
    return Dependence(name, unit, share, shape, loop, None, centres, mean, std, None, relevant, has_loop)


def _adjusted_share(w: np.ndarray, which: np.ndarray, bins: int) -> float:
    """Share of the variance between bins, less what chance would give."""
    count = np.bincount(which, minlength=bins)
    used = count > 0
    mean = np.bincount(which, w, bins)[used] / count[used]
    between = float(count[used] @ mean**2) / max(float(w @ w), TINY)
    free = len(w) - int(used.sum())
    return 1 - (1 - between) * (len(w) - 1) / free if free > 0 else 0.0
