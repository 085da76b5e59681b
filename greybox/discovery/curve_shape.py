"""The shape of a curve in a control engineer's terms: a step, a flat middle, a bend, a square, a period.

What is constant or proportional to the variable is removed from curve and templates alike: the model's own parameters (a spring, a
damper, an offset) have absorbed it, and no data can tell it from theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from greybox.discovery.policy import ShapePolicy
from greybox.numerics import TINY

Remainder = Callable[[np.ndarray], np.ndarray]


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


def classify_shape(z: np.ndarray, f: np.ndarray, count: np.ndarray, policy: ShapePolicy) -> CurveShape:
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
    position, share = _find_bend(s, curve, remainder, policy.positions)
    parabola = _likeness(curve, remainder(s**2))
    bends = share > policy.bend_share and 1 - share < policy.free_width_ratio * (1 - parabola**2)
    if s.min() > -policy.one_side_share or s.max() < policy.one_side_share:
        if bends:
            return CurveShape(ShapeKind.BEND, position=reach * position)
        if parabola**2 < policy.named_share:
            return CurveShape(ShapeKind.UNNAMED)
        return CurveShape(ShapeKind.CURVED, downwards=not parabola > 0)
    parity = _parity(s, f, remainder, policy.parity_share)
    shape, likeness = _match_template(s, curve, remainder, parity, reach, policy)
    if likeness > policy.named_share:
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


def _match_template(
    s: np.ndarray, curve: np.ndarray, remainder: Remainder, parity: Parity, reach: float, policy: ShapePolicy
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
        widths = np.linspace(policy.narrowest_middle, 0.9, policy.positions)
        flat = [_likeness(curve, remainder(np.sign(s) * np.maximum(np.abs(s) - c, 0))) for c in widths]
        k = int(np.argmax(np.abs(flat)))
        if 1 - flat[k] ** 2 < policy.free_width_ratio * (1 - best**2):
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


def find_period(z: np.ndarray, w: np.ndarray, policy: ShapePolicy) -> tuple[float, float, float]:
    """The sinusoid over ``z`` (K,) that explains most of ``w`` (K,) beside a straight line: its share of the variance, that of both, and
    its period in ``z``."""
    reach = float(np.ptp(z))
    turns = np.arange(policy.fewest_periods, policy.most_periods, 1 / policy.steps_per_period)
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
    return sinusoid, sinusoid + line, reach / float(turns[best] + shift / policy.steps_per_period)
