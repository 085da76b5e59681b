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

LEVEL: tuple[Effect, ...] = (upper_overflow, lower_overflow, reading_curve, sensor_saturation)
