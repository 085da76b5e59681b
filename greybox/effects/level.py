"""Level: tanks that run over, and gauges whose reading is not proportional to what they measure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from greybox.effects.parameters import amplitude_parameter, shape_parameter
from greybox.effects.policy import NEUTRAL, START
from greybox.effects.scales import Scales
from greybox.model import Effect
from greybox.model.signals import Expression, NamedValues


def _overflow(level: Expression, edge: Expression, rate: Expression) -> Expression:
    """What runs over an edge: proportional to the height above it."""
    return rate * ca.fmax(level - edge, 0)


def _upper_overflow(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
    spilt = _overflow(x.upper_head, p.edge, p.ko)
    # The outlet tells how the same water raises the two levels: it lowers one by upper_outlet, raises the other by lower_inlet.
    return {"upper_level": -spilt, "lower_level": p.share * spilt * p.lower_inlet / p.upper_outlet}


def _lower_overflow(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -_overflow(x.lower_head, p.edge, p.ko)


def _own_overflow(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -_overflow(x.store, p.edge, p.ko)


def _own_leak(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.kl * x.store


def _own_overflow_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    return {"ko": (0.0, START.fastest_overflow * s.storage / s.period)}


def _upper_grid(s: Scales) -> Mapping[str, list[float]]:
    return {"edge": [share * s.peaks["upper_head"] for share in START.overflow_edges], "share": [0.2, 0.6]}


def _lower_grid(s: Scales) -> Mapping[str, list[float]]:
    return {"edge": [share * s.peaks["lower_head"] for share in START.overflow_edges]}


def _overflow_probe(s: Scales) -> Mapping[str, float]:
    return {"ko": START.overflow_rate / s.period}


def _overflow_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    # Faster than the samples follow, an edge is an edge: the rate shows no more, and explicit steps would have to shrink.
    return {"ko": (0.0, START.fastest_overflow / s.period)}


def _bend_reading(value: Expression, x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    share = value / p.full
    return value + (1 - share) * (p.y0 - p.bow * value)


def _limit_reading(value: Expression, x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return ca.fmin(value, p.y_max)


upper_overflow = Effect(
    "upper_overflow",
    site="upper_level",
    parameters=[
        amplitude_parameter("ko", "1/s", "rate at which what stands above the edge runs over", low=0.0),
        shape_parameter("edge", "{upper_head}", 10.0, (1e-6, 1e6), "level of the edge"),
        shape_parameter("share", "1", 0.5, (0.0, 1.0), "share of the spilt water that falls into the lower tank"),
    ],
    terms=_upper_overflow,
    equation="-ko max(x1 - edge, 0) on the upper tank, plus share k2/k1 of it on the lower",
    parity="even",
    tells_apart=(
        "Hold the pump at full voltage: an overflowing tank stops rising at its edge, a pump that saturates lets it settle where"
        " the outflow equals the inflow; after the pump has stopped the first is as if less water had come in."
    ),
    source="Schoukens, Mattsson, Wigren, Noel 2016, Cascaded tanks benchmark: part of the overflow reaches the lower tank",
    amplitudes=("ko",),
    probe=_overflow_probe,
    grid=_upper_grid,
    limits=_overflow_limits,
)

lower_overflow = Effect(
    "lower_overflow",
    site="lower_level",
    parameters=[
        amplitude_parameter("ko", "1/s", "rate at which what stands above the edge runs over", low=0.0),
        shape_parameter("edge", "{lower_head}", 10.0, (1e-6, 1e6), "level of the edge"),
    ],
    terms=_lower_overflow,
    equation="-ko max(x2 - edge, 0)",
    parity="even",
    tells_apart=(
        "Watch the tank, or the time at which the reading leaves its top: a tank that runs over falls at once when the inflow"
        " stops, a sensor at its end shows the same value until the level has come down to it."
    ),
    source="Schoukens, Mattsson, Wigren, Noel 2016, Cascaded tanks benchmark",
    amplitudes=("ko",),
    probe=_overflow_probe,
    grid=_lower_grid,
    limits=_overflow_limits,
)

overflow = Effect(
    "overflow",
    site="store",
    parameters=[
        amplitude_parameter("ko", "{force}/{store}", "what runs over for each unit above the edge", low=0.0),
        shape_parameter("edge", "{store}", 1.0, (1e-9, 1e9), "level of the edge, or pressure at which a valve opens"),
    ],
    terms=_own_overflow,
    equation="-ko max(h - edge, 0)",
    approaches=("linear_leak",),
    parity="even",
    tells_apart=(
        "Fill slowly with the reading watched: an edge stops the rise at one level whatever the inflow, and falls at once when the inflow"
        " stops; a sensor at its end shows the same value until the level has come down to it."
    ),
    source="weir, or relief valve, as straight above its edge: H. Merritt, Hydraulic Control Systems, Wiley 1967",
    amplitudes=("ko",),
    probe=lambda s: {"ko": START.overflow_rate * s.storage / s.period},
    grid=lambda s: {"edge": [share * s.store for share in START.overflow_edges]},
    limits=_own_overflow_limits,
)

linear_leak = Effect(
    "linear_leak",
    site="store",
    parameters=[amplitude_parameter("kl", "{force}/{store}", "leak over the level or pressure", low=0.0)],
    terms=_own_leak,
    equation="-kl h",
    parity="linear",
    tells_apart=(
        "Stop inflow and outlets and let the level fall: through a laminar leak it falls by equal ratios in equal times, through a hole as"
        " a straight root of the level."
    ),
    source="laminar gap: flow proportional to the pressure",
    amplitudes=("kl",),
    probe=lambda s: {"kl": s.visible_force / s.store},
)

reading_curve = Effect(
    "reading_curve",
    site="sensor",
    parameters=[
        amplitude_parameter("y0", "{sensor}", "reading of an empty tank, either sign"),
        amplitude_parameter(
            "bow", "1", "how much lower than a straight line the reading runs in between, as a share; either sign"
        ),
        # Both figures describe the way from nothing to this reading; any other would do as well.
        replace(
            shape_parameter(
                "full", "{sensor}", 10.0, (1e-9, NEUTRAL.out_of_reach), "reading at which level and reading agree"
            ),
            fixed=True,
        ),
    ],
    on_output=_bend_reading,
    equation="y + (1 - y/full) (y0 - bow y)",
    parity="even",
    tells_apart="Read known levels at standstill: a curved reading shows there, another law of outflow does not.",
    source="calibration curve of second order of a sensor that is not proportional",
    amplitudes=("y0", "bow"),
    probe=lambda s: {"y0": 0.02 * s.reading, "bow": 0.1},
    grid=lambda s: {"full": [s.reading]},
)

sensor_saturation = Effect(
    "sensor_saturation",
    site="sensor",
    parameters=[
        shape_parameter(
            "y_max",
            "{sensor}",
            NEUTRAL.out_of_reach,
            (1e-9, NEUTRAL.out_of_reach),
            "largest reading",
            "large: absent until fitted",
        )
    ],
    on_output=_limit_reading,
    equation="min(y, y_max)",
    parity="even",
    tells_apart=(
        "Look at the reading at its top: a sensor at its end shows one value exactly, without noise, whatever the plant does."
    ),
    source="end of the range of a converter",
    amplitudes=("y_max",),
    neutral={"y_max": NEUTRAL.out_of_reach},
    grid=lambda s: {"y_max": [share * s.reading for share in (1.0, 0.95, 0.85)]},
)

LEVEL: tuple[Effect, ...] = (upper_overflow, lower_overflow, overflow, linear_leak, reading_curve, sensor_saturation)
