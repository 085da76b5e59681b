"""The shape of a curve in a control engineer's words: a step, a flat middle, a bend, a square, a period.

What is constant or proportional to the variable is taken away from curve and templates alike: the model's own constants (a spring, a
damper, an offset) have absorbed it, and no data tell it from theirs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Share of an odd (or even) part from which a curve is called odd (or even), of a shape from which it has a name, and of a bend.
PARITY, NAMED, BENT = 0.75, 0.6, 0.9
# Share of the reach below which a curve lies on one side of zero; widths and places of a bend that are tried.
ONE_SIDE, TRIED = 0.2, 33
# Half-width of a flat middle over the reach from which it is one: a narrower one is the other side of a step.
NARROWEST = 0.2
# To this share a shape whose width is free must lower what the others do not explain: a step is nearly one the other way round.
LOWERED = 0.5
# Periods of a periodic curve over the range: from so few on it counts, so many are tried, so many steps a period.
FEWEST, MOST, FINE = 3.0, 40.0, 20

Rest = Callable[[np.ndarray], np.ndarray]


def classify_shape(z: np.ndarray, f: np.ndarray, count: np.ndarray, unit: str = "") -> tuple[str, str]:
    """Parity (``odd``, ``even``, ``neither``) and shape in words of the curve ``f`` (B,) at ``z`` (B,), ``count`` (B,) samples at each."""
    reach = float(np.abs(z).max())
    if len(z) < 6 or reach == 0:
        return "neither", "too few values to say"
    s, root = z / reach, np.sqrt(count / count.sum())
    left = np.linalg.qr(np.stack([root, root * s], axis=1))[0]

    def rest(values: np.ndarray) -> np.ndarray:
        weighed = root * values
        return weighed - left @ (left.T @ weighed)

    curve = rest(f)
    if not curve.any():
        return "neither", "no shape beyond a straight line"
    bend, share = _bend(s, curve, rest)
    bent = f"a bend at {reach * bend:.3g} {unit}".rstrip()
    parabola = _likeness(curve, rest(s**2))
    bends = share > BENT and 1 - share < LOWERED * (1 - parabola**2)
    if s.min() > -ONE_SIDE or s.max() < ONE_SIDE:
        return "neither", bent if bends else _curving(parabola)
    parity = _parity(s, f, rest)
    name, likeness = _likest(s, curve, rest, parity, f" (to about {{:.3g}} {unit})".rstrip(), reach)
    if likeness > NAMED:
        return parity, name
    if bends:
        return parity, bent
    return parity, f"{parity} in shape" if parity != "neither" else "neither odd nor even"


def _curving(likeness: float) -> str:
    """How a curve on one side of zero goes, by its likeness to a parabola."""
    if likeness**2 < NAMED:
        return "of no simple shape"
    return "curving upwards" if likeness > 0 else "curving downwards"


def _parity(s: np.ndarray, f: np.ndarray, rest: Rest) -> str:
    mirrored = np.interp(-s, s, f)
    shared = np.abs(s) <= min(s.max(), -s.min())
    odd, even = (rest(np.where(shared, (f + k * mirrored) / 2, 0.0)) for k in (-1, 1))
    total = float(odd @ odd + even @ even)
    part = float(odd @ odd) / total if total > 0 else 0.5
    return "odd" if part > PARITY else "even" if part < 1 - PARITY else "neither"


def _likest(
    s: np.ndarray, curve: np.ndarray, rest: Rest, parity: str, width: str, reach: float
) -> tuple[str, float]:  # fmt: skip
    """The name of the template of this parity that is most like the ``curve``, and the share of it that it explains."""
    templates = {
        ("odd", "odd, a step where it passes zero"): np.tanh(s / 0.1),
        ("odd", "odd, growing faster than in proportion"): s**3,
        ("odd", "odd, growing with the square"): s * np.abs(s),
        ("even", "even, growing with the square"): s**2,
        ("even", "even, with a kink at zero"): np.abs(s),
    }
    found = [(_likeness(curve, rest(t)), name) for (own, name), t in templates.items() if own == parity]
    best, name = max(found, key=lambda one: abs(one[0]), default=(0.0, ""))
    if parity == "odd":
        widths = np.linspace(NARROWEST, 0.9, TRIED)
        flat = [_likeness(curve, rest(np.sign(s) * np.maximum(np.abs(s) - c, 0))) for c in widths]
        k = int(np.argmax(np.abs(flat)))
        if 1 - flat[k] ** 2 < LOWERED * (1 - best**2):
            best, name = flat[k], f"odd, with a flat middle{width.format(widths[k] * reach)}"
    return name + (", downwards" if best < 0 else ""), best**2


def _bend(s: np.ndarray, curve: np.ndarray, rest: Rest) -> tuple[float, float]:
    """Where the curve bends if it is straight on both sides, and the share of it that this explains."""
    places = np.linspace(s.min(), s.max(), TRIED + 2)[1:-1]
    shares = [_likeness(curve, rest(np.maximum(s - c, 0))) ** 2 for c in places]
    best = int(np.argmax(shares))
    return float(places[best]), shares[best]


def _likeness(a: np.ndarray, b: np.ndarray) -> float:
    return float(a @ b) / np.sqrt(max(float(a @ a) * float(b @ b), 1e-300))


def find_period(z: np.ndarray, w: np.ndarray) -> tuple[float, float, float]:
    """The sinusoid over ``z`` (K,) that explains most of ``w`` (K,) beside a straight line: its share of the variance, that of both, and
    its period in ``z``."""
    reach = float(np.ptp(z))
    turns = np.arange(FEWEST, MOST, 1 / FINE)
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
    total = max(float(around @ around), 1e-300)
    sinusoid, line = float(gained[best]) / total, 1 - float(rest @ rest) / total
    shift = 0.0
    if 0 < best < len(turns) - 1:  # between the steps, by the parabola through the three highest
        before, at, after = gained[best - 1 : best + 2]
        shift = 0.5 * float((before - after) / min(before - 2 * at + after, -1e-300))
    return sinusoid, sinusoid + line, reach / float(turns[best] + shift / FINE)
