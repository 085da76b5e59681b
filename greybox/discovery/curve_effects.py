"""Effects that stand in for an unknown one: a smooth curve over a variable, or a sinusoid over it.

``sum c_k exp(-(t - k)^2)``, ``t = (z - lowest) / pitch``: bumps so close that their sum is smooth (equal ones make a constant to 1e-4), and
short enough to be read in a model file. Outside the range that was seen the curve goes to zero. Weak priors on the heights keep
apart what a constant of the model could do as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import casadi as ca
import numpy as np

from greybox.discovery.dependence import Dependence
from greybox.discovery.disturbance_sites import INPUT, SENSOR, DisturbanceSite
from greybox.model import Effect
from greybox.model.signals import Expression, NamedValues, Parameter

NAME = "fitted_curve"
# Intervals of the curve; how far it reaches beyond the stretch that was looked at; prior of a height over the signal's rms.
INTERVALS, MARGIN, LOOSE = 20, 0.15, 5.0
# A period may move by this share from the one that the signal shows.
STRETCH = 0.1


def make_curve_effect(
    place: DisturbanceSite,
    region: Dependence,
    z: np.ndarray,
    w: np.ndarray,
    std: np.ndarray,
    intervals: int = INTERVALS,
) -> tuple[Effect, dict[str, float]]:
    """A smooth curve over the variable of ``region`` as an effect at ``place``; its heights by regression of ``w`` (K,) on ``z`` (K,)."""
    low, high = float(z.min()), float(z.max())
    low, high = low - MARGIN * (high - low), high + MARGIN * (high - low)
    pitch, size = (high - low) / intervals, float(np.sqrt(np.mean(w**2)))
    heights = [f"c{k}" for k in range(intervals + 1)]
    parameters = [
        Parameter("lowest", region.unit, low, fixed=True, source="range of the record", description=f"least {region.variable}"),
        Parameter("pitch", region.unit, pitch, fixed=True, source="range of the record", description="distance of the bumps"),
        *(
            Parameter(n, place.unit, 0.0, source="zero, until fitted", prior=(0.0, LOOSE * size), description="height")
            for n in heights
        ),
    ]  # fmt: skip

    def curve(seen: Expression, p: NamedValues) -> Expression:
        return _bumps((seen - p.lowest) / p.pitch, [p[n] for n in heights])

    basis = _basis((z - low) / pitch, len(heights))
    weight = 1 / np.maximum(std, 1e-3 * size)
    held = np.eye(len(heights)) / (LOOSE * size)
    c = np.linalg.lstsq(
        np.vstack([basis * weight[:, None], held]), np.append(w * weight, np.zeros(len(heights))), rcond=None
    )[0]
    effect = _effect(place, region, curve, parameters, heights, f"smooth curve over {region.variable}")
    return effect, dict(zip(heights, map(float, c), strict=True))


def make_sinusoid_effect(
    place: DisturbanceSite, region: Dependence, period: float, z: np.ndarray, w: np.ndarray
) -> tuple[Effect, dict[str, float]]:
    """A sinusoid of ``period`` over the variable of ``region`` as an effect at ``place``; its size by regression of ``w`` on ``z`` (K,)."""
    parameters = [
        Parameter(
            "pitch", region.unit, period, ((1 - STRETCH) * period, (1 + STRETCH) * period),
            source="seen in what the model leaves over", description=f"period over {region.variable}",
        ),
        *(Parameter(n, place.unit, 0.0, source="zero, until fitted", description=f"its {n}") for n in ("cosine", "sine")),
    ]  # fmt: skip

    def curve(seen: Expression, p: NamedValues) -> Expression:
        turned = 2 * ca.pi * seen / p.pitch
        return p.cosine * ca.cos(turned) + p.sine * ca.sin(turned)

    turned = 2 * np.pi * z / period
    basis = np.stack([np.cos(turned), np.sin(turned), np.ones_like(z), z], axis=1)
    cosine, sine, *_ = np.linalg.lstsq(basis, w, rcond=None)[0]
    effect = _effect(place, region, curve, parameters, ["cosine", "sine"], f"sinusoid over {region.variable}")
    return effect, {"pitch": period, "cosine": float(cosine), "sine": float(sine)}


def _effect(
    place: DisturbanceSite, region: Dependence, curve: Callable[[Expression, NamedValues], Expression], parameters: Sequence[Parameter],
    amplitudes: Sequence[str], equation: str,
) -> Effect:  # fmt: skip
    """``curve`` of the region's variable and the constants, added at ``place``."""
    variable = region.variable

    def added(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return curve(x[variable] if variable in x else u[variable], p)

    def changed(value: Expression, x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return value + added(x, u, p)

    return Effect(
        NAME, place.name, parameters,
        terms=None if place.kind in (INPUT, SENSOR) else added,
        on_input=changed if place.kind == INPUT else None, on_output=changed if place.kind == SENSOR else None,
        equation=equation, parity=region.parity, amplitudes=amplitudes,
        source="fitted to what the model leaves over; no law of its own",
    )  # fmt: skip


def evaluate_curve(values: Mapping[str, float], z: np.ndarray) -> np.ndarray:
    """The curve, or the sinusoid, with these constants at ``z`` (M,)."""
    if "cosine" in values:
        turned = 2 * np.pi * z / values["pitch"]
        return values["cosine"] * np.cos(turned) + values["sine"] * np.sin(turned)
    heights = np.array([values[f"c{k}"] for k in range(INTERVALS + 1)])
    return _basis((z - values["lowest"]) / values["pitch"], len(heights)) @ heights


def _basis(t: np.ndarray, count: int) -> np.ndarray:
    """Bumps (M, count) at ``t``."""
    return np.exp(-((t[:, None] - np.arange(count)) ** 2))


def _bumps(t: Expression, heights: Sequence[Expression]) -> Expression:
    total: Expression = 0
    for k, c in enumerate(heights):
        total = total + c * ca.exp(-((t - k) ** 2))
    return total
