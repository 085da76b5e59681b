"""Surrogates of an unknown effect: a smooth curve, a line, a power or a sinusoid over a variable, a tone in time, or a linear path.

The curve is ``sum c_k exp(-(t - k)^2)``, ``t = (z - lowest) / pitch``: bumps so close that their sum is smooth (equal ones make a constant
to 1e-4), and short enough to be read in a model file. Outside the range that was seen the curve goes to zero. Weak priors on the
heights separate what a parameter of the model could do as well.

Of a variable of which fewer levels were seen than there would be bumps (an input that is stepped between a few values) the curve has one
height for each level and nothing to say between them: there it is the straight line from one to the next, and beyond them it stays.

The tone is ``z1' = 2 pi f z2``, ``z2' = -2 pi f z1``: a sinusoid whose amplitude and phase are the initial state, which every record has
for itself. The frequency is one parameter of all. (B. A. Francis, W. M. Wonham 1976, The internal model principle of control theory.)

The linear path goes from the inputs to a reading, past the plant: ``y + d u + z``, ``z' = -a z + b u``. It has no place in the plant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from greybox.base.linear_algebra import decompose_columns
from greybox.discovery.curve_shape import FEWEST_LEVELS, TIME, Dependence, find_levels
from greybox.discovery.disturbance_sites import DisturbanceSite, SiteKind
from greybox.discovery.localisation import ResidualSignal
from greybox.model import Balance, Effect
from greybox.model.signals import Expression, Input, NamedValues, Output, Parameter, State

# Names of the effects.
CURVE, TONE, LINEAR_DYNAMICS = "fitted_curve", "tone", "linear_dynamics"
# Name of the constants of a curve that hold its levels; a number follows.
LEVEL = "level"
# The state of a curve over time: seconds since the record began.
CLOCK = "clock"
SOURCE = "fitted to the residual of the model; no physical law"


@dataclass(frozen=True)
class CurvePlace:
    """A site at which a curve or a tone may stand, the variable that it is over, and the signal that the residual asks for there."""

    site: DisturbanceSite
    dependence: Dependence
    signal: ResidualSignal

    @property
    def shows_curve(self) -> bool:
        """Whether enough levels of the variable were seen for more than a straight line."""
        return len(find_levels(self.signal.variables[self.dependence.variable])) >= FEWEST_LEVELS


# Share of the range by which the curve extends beyond what was seen.
SURROGATE_MARGIN = 0.15
# Standard deviation of the prior of each height, over the signal's rms: weak, it separates what the model's constants do as well.
HEIGHT_PRIOR = 5.0


def make_curve_effect(
    site: DisturbanceSite,
    dependence: Dependence,
    z: np.ndarray,
    w: np.ndarray,
    std: np.ndarray,
    intervals: int,
) -> Effect:
    """A smooth curve over the variable of ``dependence`` as an effect at ``site``.

    It has ``intervals`` + 1 heights, or as many as levels were seen where these are fewer. They begin (its ``probe``) as a regression of
    the signal ``w`` (K,), known to ``std`` (K,), on the variable ``z`` (K,) has them.
    """
    levels, size = find_levels(z), float(np.sqrt(np.mean(w**2)))
    variable, unit, prior = dependence.variable, dependence.unit, HEIGHT_PRIOR * size
    source = "range of the record"
    low, high = float(z.min()), float(z.max())
    low, high = low - SURROGATE_MARGIN * (high - low), high + SURROGATE_MARGIN * (high - low)
    pitch, count = (high - low) / intervals, intervals + 1
    places = [
        Parameter("lowest", unit, low, fixed=True, source=source, description=f"least {variable}"),
        Parameter("pitch", unit, pitch, fixed=True, source=source, description="distance of the bumps"),
    ]
    # No more heights than levels: the others would be what the prior makes them.
    if has_heights_at_levels := len(levels) < count:
        count = len(levels)
        places = [
            Parameter(f"{LEVEL}{k}", unit, float(level), fixed=True, source="seen in the record", description="level")
            for k, level in enumerate(levels)
        ]
    heights = [f"c{k}" for k in range(count)]
    parameters = [
        *places,
        *(
            Parameter(n, site.unit, 0.0, source="zero, until fitted", prior=(0.0, prior), description="height")
            for n in heights
        ),
    ]

    def curve(value: Expression, p: NamedValues) -> Expression:
        if has_heights_at_levels:
            return _line_through(value, [p[f"{LEVEL}{k}"] for k in range(count)], [p[n] for n in heights])
        return _sum_of_bumps((value - p.lowest) / p.pitch, [p[n] for n in heights])

    basis = _hats(z, levels) if has_heights_at_levels else _bumps((z - low) / pitch, count)
    weight = 1 / np.maximum(std, 1e-3 * size)
    prior_rows = np.eye(len(heights)) / prior
    regression = decompose_columns(np.vstack([basis * weight[:, None], prior_rows]))
    c = regression.solve(np.append(w * weight, np.zeros(len(heights))))
    begin = dict(zip(heights, map(float, c), strict=True))
    return _curve_effect(site, dependence, curve, parameters, begin, f"smooth curve over {variable}")


def make_line_effect(site: DisturbanceSite, dependence: Dependence, z: np.ndarray, w: np.ndarray) -> Effect:
    """A straight line over the variable of ``dependence`` as an effect at ``site``.

    It begins (its ``probe``) as the regression of the signal ``w`` (K,) on the variable ``z`` (K,).
    """
    middle, spread = float(np.mean(z)), float(np.std(z)) or 1.0
    source = "range of the record"
    parameters = [
        Parameter("middle", dependence.unit, middle, fixed=True, source=source, description="mean of the variable"),
        Parameter("spread", dependence.unit, spread, fixed=True, source=source, description="its standard deviation"),
        Parameter("level", site.unit, 0.0, source="zero, until fitted", description="its value in the middle"),
        Parameter("slope", site.unit, 0.0, source="zero, until fitted", description="its change over the spread"),
    ]

    def line(value: Expression, p: NamedValues) -> Expression:
        return p.level + p.slope * (value - p.middle) / p.spread

    level, slope = decompose_columns(np.stack([np.ones_like(z), (z - middle) / spread], axis=1)).solve(w)
    begin = {"level": float(level), "slope": float(slope)}
    return _curve_effect(site, dependence, line, parameters, begin, f"straight line over {dependence.variable}")


# Exponents from which a power is fitted; it stays between the first and the last. The straight line is the model's own.
SURROGATE_POWERS: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 1.5, 2.0, 3.0)
# Share of the variable's rms below which a power is straight.
STRAIGHT_SHARE = 0.01


def make_power_effect(site: DisturbanceSite, dependence: Dependence, z: np.ndarray, w: np.ndarray) -> Effect:
    """A power of the variable of ``dependence``, with its sign, as an effect at ``site``.

    It begins (its ``probe``) as the regression of the signal ``w`` (K,) on the variable ``z`` (K,) that leaves least. Close to zero the
    power is straight: the slope of a root is infinite there.
    """
    size = float(np.sqrt(np.mean(z**2)))
    low, high = min(SURROGATE_POWERS), max(SURROGATE_POWERS)
    parameters = [
        Parameter("scale", dependence.unit, size, fixed=True, source="rms of the record", description="where it is 1"),
        Parameter("height", site.unit, 0.0, source="zero, until fitted", description="its value there"),
        Parameter("power", "1", 1.0, (low, high), source="between a step and a steep curve", description="exponent"),
    ]

    def curve(value: Expression, p: NamedValues) -> Expression:
        return p.height * _power(value / p.scale, p.power, STRAIGHT_SHARE)

    def regress(power: float) -> tuple[float, float]:
        basis = np.stack([_power(z / size, power, STRAIGHT_SHARE), z / size, np.ones_like(z)], axis=1)
        coefficients = decompose_columns(basis).solve(w)
        return float(np.sum((w - basis @ coefficients) ** 2)), float(coefficients[0])

    best = min(SURROGATE_POWERS, key=lambda power: regress(power)[0])
    parameters[-1] = replace(parameters[-1], value=best)
    begin = {"height": regress(best)[1]}
    return _curve_effect(site, dependence, curve, parameters, begin, f"power of {dependence.variable}")


def _power(t: Expression, power: Expression, straight: float) -> Expression:
    """``sign(t) |t|**power``, straight for ``t`` below ``straight``."""
    return t * (t**2 + straight**2) ** ((power - 1) / 2)


# Share by which a period may move from the one that the signal shows.
PERIOD_MARGIN = 0.1


def make_sinusoid_effect(
    site: DisturbanceSite,
    dependence: Dependence,
    period: float,
    z: np.ndarray,
    w: np.ndarray,
) -> Effect:
    """A sinusoid of about ``period`` over the variable of ``dependence`` as an effect at ``site``.

    It begins (its ``probe``) as a regression of the signal ``w`` (K,) on the variable ``z`` (K,) has it.
    """
    variable, margin = dependence.variable, PERIOD_MARGIN
    parameters = [
        Parameter(
            "pitch",
            dependence.unit,
            period,
            ((1 - margin) * period, (1 + margin) * period),
            source="seen in what the model leaves over",
            description=f"period over {variable}",
        ),
        *(
            Parameter(n, site.unit, 0.0, source="zero, until fitted", description=f"its {n}")
            for n in ("cosine", "sine")
        ),
    ]

    def curve(value: Expression, p: NamedValues) -> Expression:
        angle = 2 * ca.pi * value / p.pitch
        return p.cosine * ca.cos(angle) + p.sine * ca.sin(angle)

    angle = 2 * np.pi * z / period
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(z), z], axis=1)
    cosine, sine, *_ = decompose_columns(basis).solve(w)
    begin = {"cosine": float(cosine), "sine": float(sine)}
    return _curve_effect(site, dependence, curve, parameters, begin, f"sinusoid over {variable}")


def _curve_effect(
    site: DisturbanceSite,
    dependence: Dependence,
    curve: Callable[[Expression, NamedValues], Expression],
    parameters: Sequence[Parameter],
    begin: Mapping[str, float],
    equation: str,
) -> Effect:
    """``curve`` of the variable and the parameters, added at ``site``; it is a multiple of those that ``begin`` at a value."""
    is_over_time = dependence.variable == TIME
    variable = CLOCK if is_over_time else dependence.variable

    def term(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return curve(x[variable] if variable in x else u[variable], p)

    def run_clock(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        return [Balance("seconds", "s/s", 1, CLOCK, passing=1.0)]

    def with_term(value: Expression, x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return value + term(x, u, p)

    return Effect(
        CURVE,
        site.name,
        parameters,
        states=[State(CLOCK, "s", 0.0, description="time since the record began")] if is_over_time else [],
        balances=run_clock if is_over_time else None,
        terms=None if site.kind in (SiteKind.INPUT, SiteKind.SENSOR) else term,
        on_input=with_term if site.kind == SiteKind.INPUT else None,
        on_output=with_term if site.kind == SiteKind.SENSOR else None,
        equation=equation,
        parity=dependence.shape.parity.value,
        amplitudes=list(begin),
        probe=lambda scales: begin,
        source=SOURCE,
    )


def make_linear_path(output: Output, inputs: Sequence[Input]) -> Effect:
    """Linear dynamics of the first order from all ``inputs`` to the reading of one output, beside the plant."""
    # z' = -a z + b u, y + d u + z in the place of y: with a plant of the first order any linear one of the second.
    unit, state, rate = output.unit, f"z_{output.name}", "a"
    direct, gain = ({i.name: f"{letter}_{i.name}" for i in inputs} for letter in "db")
    units = {i.name: f"({unit})/({i.unit})" for i in inputs}
    parameters = [
        Parameter(rate, "1/s", 1.0, (0.0, np.inf), source=SOURCE, description="rate of the path"),
        *(Parameter(direct[n], units[n], 0.0, source=SOURCE, description=f"direct path from {n}") for n in direct),
        *(Parameter(gain[n], f"{units[n]}/s", 0.0, source=SOURCE, description=f"path from {n}") for n in gain),
    ]
    return Effect(
        f"{LINEAR_DYNAMICS}_to_{output.name}",
        output.name,
        parameters,
        states=[State(state, unit, 0.0, description="what the path adds")],
        balances=lambda x, u, p: [
            Balance(state, f"({unit})/s", 1, state, decay=-p[rate] * x[state], **{n: p[gain[n]] * u[n] for n in gain})
        ],
        on_output=lambda value, x, u, p: value + x[state] + sum(p[direct[n]] * u[n] for n in direct),
        equation="z' = -a z + b u, y + d u + z in the place of y",
        parity="linear",
        amplitudes=[*direct.values(), *gain.values()],
        source=SOURCE,
    )


def evaluate_curve(values: Mapping[str, float], z: np.ndarray) -> np.ndarray:
    """The curve, or the sinusoid, with these parameters at ``z`` (M,)."""
    if "cosine" in values:
        angle = 2 * np.pi * z / values["pitch"]
        return values["cosine"] * np.cos(angle) + values["sine"] * np.sin(angle)
    count = sum(name.startswith("c") for name in values)
    heights = np.array([values[f"c{k}"] for k in range(count)])
    levels = levels_of(values)
    if levels is not None:
        return _hats(z, levels) @ heights
    return _bumps((z - values["lowest"]) / values["pitch"], len(heights)) @ heights


def levels_of(values: Mapping[str, float]) -> np.ndarray | None:
    """The levels (L,) at which a curve with these parameters has its heights; None for one that is known all over its range."""
    count = sum(name.startswith(LEVEL) for name in values)
    return np.array([values[f"{LEVEL}{k}"] for k in range(count)]) if count else None


def _hats(z: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """What each height at a level adds at ``z`` (M,): columns (M, L) of the straight lines from level to level."""
    return np.stack([np.interp(z, levels, unit) for unit in np.eye(len(levels))], axis=1)


def _line_through(value: Expression, levels: Sequence[Expression], heights: Sequence[Expression]) -> Expression:
    total: Expression = heights[0]
    for k in range(1, len(levels)):
        share = (value - levels[k - 1]) / (levels[k] - levels[k - 1])
        total = total + (heights[k] - heights[k - 1]) * ca.fmin(ca.fmax(share, 0), 1)
    return total


def _bumps(t: np.ndarray, count: int) -> np.ndarray:
    """Bumps (M, count) at ``t``."""
    return np.exp(-((t[:, None] - np.arange(count)) ** 2))


def _sum_of_bumps(t: Expression, heights: Sequence[Expression]) -> Expression:
    total: Expression = 0
    for k, c in enumerate(heights):
        total = total + c * ca.exp(-((t - k) ** 2))
    return total


def make_tone_effect(site: DisturbanceSite, signal: ResidualSignal, first_time: float, frequency: float) -> Effect:
    """A tone of about ``frequency`` Hz as an effect at ``site``; at rest it starts as the ``signal`` shows it.

    ``first_time`` is that of the first row of the signal's record, in seconds.
    """
    frequency, (cosine, sine) = _fit_sinusoid(signal.time - first_time, signal.value, frequency)
    unit = site.unit.strip() if site.unit.strip() not in ("", "-") else "1"
    rate_unit = f"{unit}/s" if unit.isalnum() else f"({unit})/s"
    states = [
        State("z1", site.unit, cosine, free_start=True, description="the tone"),
        State("z2", site.unit, sine, free_start=True, description="the tone a quarter of a period later"),
    ]

    def oscillator(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        rate = 2 * ca.pi * p.frequency
        return [
            Balance("tone", rate_unit, 1, "z1", turning=rate * x.z2),
            Balance("quarter", rate_unit, 1, "z2", turning=-rate * x.z1),
        ]

    def term(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return x.z1

    def with_term(value: Expression, x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return value + x.z1

    return Effect(
        TONE,
        site.name,
        [
            Parameter(
                "frequency",
                "Hz",
                frequency,
                (0.5 * frequency, 2 * frequency),
                source="spectral line of what the model leaves over",
                description="frequency of the tone",
            )
        ],
        states=states,
        balances=oscillator,
        terms=None if site.kind in (SiteKind.INPUT, SiteKind.SENSOR) else term,
        on_input=with_term if site.kind == SiteKind.INPUT else None,
        on_output=with_term if site.kind == SiteKind.SENSOR else None,
        equation="z1, z1' = 2 pi f z2, z2' = -2 pi f z1",
        parity="slow",
        source=SOURCE,
    )


def _fit_sinusoid(time: np.ndarray, w: np.ndarray, about: float) -> tuple[float, tuple[float, float]]:
    """Frequency near ``about`` of the sinusoid closest to ``w`` (K,), and its cosine and sine parts at time zero."""
    from scipy.optimize import minimize_scalar

    def regress(frequency: float) -> tuple[np.ndarray, float]:
        angle = 2 * np.pi * frequency * time
        basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(time)], axis=1)
        coefficients = decompose_columns(basis).solve(w)
        return coefficients, float(np.sum((w - basis @ coefficients) ** 2))

    reach = 1 / np.ptp(time)
    best = minimize_scalar(
        lambda f: regress(f)[1],
        bounds=(max(about - reach, 0.5 * about), about + reach),
        method="bounded",
        options={"xatol": 1e-4 * reach},
    )
    cosine, sine, _ = regress(float(best.x))[0]
    return float(best.x), (float(cosine), float(sine))
