"""Flow: what a valve, two chambers and a supply do besides the linear law. Pressures are absolute."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from greybox.model.balance import Balance
from greybox.model.effect import Effect, amplitude_parameter, fixed_parameter, geometric_grid, shape_parameter
from greybox.model.effects.scales import VISIBLE_SHARE, Scales
from greybox.model.parts import Occurrence
from greybox.model.signals import Expression, NamedValues, State

# What keeps the equations finite where a trial step of a fit leaves the physical range.
#
# Square of the flow function below which the flow is laminar: the root has no slope where both pressures are equal.
LAMINAR = 0.01
# Smallest volume of a chamber, as a share of half the total volume.
LEAST_VOLUME = 0.01
# Smallest pressure of a chamber, as a share of the ambient pressure.
LEAST_PRESSURE = 0.01


def _leakage(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
    # What one chamber loses the other gains.
    across = p.kl * (x.chamber_a - x.chamber_b)
    return {"pressure_a": -across, "pressure_b": across}


def _orifice_pressure(upstream: Expression, downstream: Expression, b: Expression) -> Expression:
    """``p_1 phi(p_2 / p_1)`` (ISO 6358) from the higher pressure to the lower one, negative where that is upwards."""
    high = ca.fmax(upstream, downstream)
    # 1 - (r - b)/(1 - b) between -1 and 1, with the sign of the flow: phi^2 is this times (2 - its size)
    fall = ca.fmin(ca.fmax((upstream - downstream) / ((1 - b) * high), -1), 1)
    square = fall * (2 - ca.fabs(fall))
    return high * square / ca.sqrt(ca.fmax(ca.fabs(square), LAMINAR))


def _choked_rate(u: Expression, p: NamedValues) -> Expression:
    """``G max(u, 0)``, the rate of pressure by a choked flow."""
    gain = p.ambient_pressure * p.valve_gain * p.supply_pressure / (p.ambient_density * p.total_volume)
    return gain * ca.fmax(u, 0)


def _filling(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Mapping[str, Expression]]:
    def filled(opening: Expression, pressure: Expression) -> Mapping[str, Expression]:
        return {
            "valve_flow": _choked_rate(opening, p)
            * _orifice_pressure(p.supply_pressure, pressure, p.b)
            / p.supply_pressure
        }

    return {"pressure_a": filled(u.valve, x.chamber_a), "pressure_b": filled(-u.valve, x.chamber_b)}


def _venting(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
    def vented(opening: Expression, pressure: Expression) -> Expression:
        inside = ca.fmax(pressure, LEAST_PRESSURE * p.ambient_pressure)
        return -p.ce * _choked_rate(opening, p) * _orifice_pressure(inside, p.ambient_pressure, p.b) / p.supply_pressure

    return {"pressure_a": vented(-u.valve, x.chamber_a), "pressure_b": vented(u.valve, x.chamber_b)}


def _volumes(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
    # V = V0 +- A x, over half the total volume: what one chamber gains the other loses.
    change = p.scale * p.piston_area * x.displacement / (p.total_volume / 2)
    return {"pressure_a": ca.fmax(1 + change, LEAST_VOLUME), "pressure_b": ca.fmax(1 - change, LEAST_VOLUME)}


def _root_leak(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    # c sign(p) sqrt(|p|), with the root smooth about zero: p / (p^2 + p0^2)^(1/4).
    pressure = x.pressure
    return -p.c * pressure / (pressure**2 + p.laminar**2) ** 0.25


chamber_leakage = Effect(
    "chamber_leakage",
    site="pressure_a",
    parameters=[amplitude_parameter("kl", "1/s", "rate at which the pressures of both chambers meet", low=0.0)],
    terms=_leakage,
    equation="-kl (p_a - p_b) on chamber a, plus on chamber b",
    parity="linear",
    tells_apart=(
        "Close the valve with a load on the piston and measure the pressures: through a leak their difference decays"
        " while the piston creeps, a return spring holds it."
    ),
    source="laminar gap at the piston seal: flow proportional to the pressure difference",
    # Both pressures move the piston at the rate of the chambers; a hundredth of it is visible but small.
    probe=lambda s: {"kl": 0.02 / s.fastest},
    needs=("seal",),
    occurs=Occurrence.OCCASIONAL,
)

choked_flow = Effect(
    "choked_flow",
    site="pressure_a",
    parameters=[
        shape_parameter("b", "1", 0.3, (0.01, 0.9), "critical pressure ratio", "usual: spool valves have 0.2 to 0.4"),
        shape_parameter(
            "ce", "1", 1.0, (0.05, 20.0), "conductance of the exhaust over that of the inlet", "equal edges"
        ),
    ],
    on_term=_filling,
    terms=_venting,
    equation=(
        "filling: G abs(u) phi(p/P_S, b), venting: -ce G abs(u) (p/P_S) phi(P_a/p, b) in the place of G u;"
        " phi(r, b) = 1 for r <= b, else sqrt(1 - ((r - b)/(1 - b))^2); where the flow turns round the two pressures change places"
    ),
    parity="odd",
    tells_apart=(
        "Measure the pressures: choked flow lets them settle where both flows are equal, whatever the voltage; a clipped"
        " voltage or a slow supply leaves them at half the supply."
    ),
    source="ISO 6358-1; Linear ARX modelling of pneumatic actuator system (chapter 10), eq. 10.1",
    grid=lambda s: {"b": [0.2, 0.45], "ce": [0.7, 1.0, 1.5]},
    occurs=Occurrence.COMMON,
)

supply_droop = Effect(
    "supply_droop",
    site="pressure_a",
    parameters=[
        amplitude_parameter("r", "1/{valve}", "share of the flow lost per opening held", low=0.0),
        shape_parameter("tau_d", "s", 0.5, (1e-6, 1e6), "time in which the supply follows"),
    ],
    states=[State("z", "", relaxing=True, description="share of the flow lost")],
    on_parameter=lambda x, u, p: {"valve_gain": p.valve_gain * (1 - x.z)},
    balances=lambda x, u, p: [Balance("droop", "1", p.tau_d, "z", drain=p.r * ca.fabs(u.valve), recovery=-x.z)],
    equation="G (1 - z) u, tau_d z' = r abs(u) - z",
    parity="odd",
    tells_apart=(
        "Hold the valve open: the speed falls within tau_d and recovers at rest; a curved valve gain acts at once."
    ),
    source="flow resistance between reservoir and valve, with one time constant",
    probe=lambda s: {"r": 0.03 / s.input},
    grid=lambda s: {"tau_d": geometric_grid(max(s.fastest, 4 * s.period), 0.2 * s.duration, 4)},
    occurs=Occurrence.RARE,
)

position_dependent_volume = Effect(
    "position_dependent_volume",
    site="pressure_a",
    parameters=[
        amplitude_parameter(
            "scale", "1", "share of the swept volume that changes the chambers: 1 is geometry", low=0.0, high=2.0
        )
    ],
    on_storage=_volumes,
    equation="V/2 (1 +- scale A s/(V/2)) for the two chambers",
    parity="even",
    tells_apart=(
        "Repeat a small motion near both ends with the pressures measured: the smaller chamber answers faster."
    ),
    source="Linear ARX modelling of pneumatic actuator system (chapter 10), eq. 10.3",
    probe=lambda s: {"scale": 0.1},
    occurs=Occurrence.OCCASIONAL,
)

# Share of the largest pressure below which a leak is laminar: the root has no slope at zero.
LAMINAR_SHARE = 0.001


root_leak = Effect(
    "root_leak",
    site="pressure",
    parameters=[
        amplitude_parameter("c", "{force}/{pressure}**0.5", "leak over the root of the pressure difference", low=0.0),
        # Below this pressure the leak is laminar; it only keeps the root smooth.
        fixed_parameter("laminar", "{pressure}", 1.0, (1e-12, 1e12), "pressure below which the leak is laminar"),
    ],
    terms=_root_leak,
    equation="-c sqrt(abs(p)) sign(p)",
    parity="odd",
    tells_apart=(
        "Hold the body and let the pressure decay: through an orifice it reaches zero in finite time, through a laminar gap it decays"
        " by equal ratios in equal times."
    ),
    source="orifice law of Torricelli: H. Merritt, Hydraulic Control Systems, Wiley 1967",
    probe=lambda s: {"c": s.visible_force / s.store**0.5},
    grid=lambda s: {"laminar": [LAMINAR_SHARE * s.store]},
    occurs=Occurrence.RARE,
)

pump_back_pressure = Effect(
    "pump_back_pressure",
    site="store",
    parameters=[amplitude_parameter("b", "1/{store}", "share of the driven flow lost per pressure or level", low=0.0)],
    terms=lambda x, u, p: -p.b * x.store * x.driven,
    equation="-b p (flow driven by the inputs)",
    parity="even",
    tells_apart=(
        "Hold the pump at one speed against several pressures: its flow falls with the pressure; a curved pump does so with its speed,"
        " whatever the pressure."
    ),
    source="slope of a pump's characteristic, or its internal leak: H. Merritt, Hydraulic Control Systems, Wiley 1967",
    probe=lambda s: {"b": VISIBLE_SHARE / s.store},
    limits=lambda s: {"b": (0.0, 10.0 / s.store)},
    occurs=Occurrence.RARE,
)

FLOW: tuple[Effect, ...] = (
    chamber_leakage,
    choked_flow,
    supply_droop,
    position_dependent_volume,
    root_leak,
    pump_back_pressure,
)


# Level: tanks that run over, and gauges whose reading is not proportional to what they measure.


def _overflow(level: Expression, edge: Expression, rate: Expression) -> Expression:
    """What runs over an edge: proportional to the height above it."""
    return rate * ca.fmax(level - edge, 0)


def _upper_overflow(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
    spilt = _overflow(x.upper_head, p.edge, p.ko)
    # The outlet tells how the same water raises the two levels: it lowers one by upper_outlet, raises the other by lower_inlet.
    return {"upper_level": -spilt, "lower_level": p.share * spilt * p.lower_inlet / p.upper_outlet}


# Largest rate of an overflow, per sampling period: faster than the samples follow, an edge is an edge.
FASTEST_OVERFLOW = 4.0


# Edges over which a tank may run, as shares of the highest level of the record, the faintest first.
OVERFLOW_EDGES: tuple[float, ...] = (0.95, 0.8, 0.65, 0.5, 0.35, 0.25)


# Rate of an overflow to start from, per sampling period.
OVERFLOW_RATE = 0.1


def _overflow_probe(s: Scales) -> Mapping[str, float]:
    return {"ko": OVERFLOW_RATE / s.period}


def _overflow_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    # Faster than the samples follow, an edge is an edge: the rate shows no more, and explicit steps would have to shrink.
    return {"ko": (0.0, FASTEST_OVERFLOW / s.period)}


def _bend_reading(value: Expression, x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    # A parabola above the straight scale that is right at the full mark: its empty mark reads y0, and it bows in between.
    share = value / p.full
    return value + (1 - share) * (p.y0 - p.bow * value)


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
    probe=_overflow_probe,
    grid=lambda s: {"edge": [share * s.peaks["upper_head"] for share in OVERFLOW_EDGES], "share": [0.2, 0.6]},
    limits=_overflow_limits,
    occurs=Occurrence.RARE,
)

lower_overflow = Effect(
    "lower_overflow",
    site="lower_level",
    parameters=[
        amplitude_parameter("ko", "1/s", "rate at which what stands above the edge runs over", low=0.0),
        shape_parameter("edge", "{lower_head}", 10.0, (1e-6, 1e6), "level of the edge"),
    ],
    terms=lambda x, u, p: -_overflow(x.lower_head, p.edge, p.ko),
    equation="-ko max(x2 - edge, 0)",
    parity="even",
    tells_apart=(
        "Watch the tank, or the time at which the reading leaves its top: a tank that runs over falls at once when the inflow"
        " stops, a sensor at its end shows the same value until the level has come down to it."
    ),
    source="Schoukens, Mattsson, Wigren, Noel 2016, Cascaded tanks benchmark",
    probe=_overflow_probe,
    grid=lambda s: {"edge": [share * s.peaks["lower_head"] for share in OVERFLOW_EDGES]},
    limits=_overflow_limits,
    occurs=Occurrence.RARE,
)

overflow = Effect(
    "overflow",
    site="store",
    parameters=[
        amplitude_parameter("ko", "{force}/{store}", "what runs over for each unit above the edge", low=0.0),
        shape_parameter("edge", "{store}", 1.0, (1e-9, 1e9), "level of the edge, or pressure at which a valve opens"),
    ],
    terms=lambda x, u, p: -_overflow(x.store, p.edge, p.ko),
    equation="-ko max(h - edge, 0)",
    approaches=("linear_leak",),
    parity="even",
    tells_apart=(
        "Fill slowly with the reading watched: an edge stops the rise at one level whatever the inflow, and falls at once when the inflow"
        " stops; a sensor at its end shows the same value until the level has come down to it."
    ),
    source="weir, or relief valve, as straight above its edge: H. Merritt, Hydraulic Control Systems, Wiley 1967",
    probe=lambda s: {"ko": OVERFLOW_RATE * s.storage / s.period},
    grid=lambda s: {"edge": [share * s.store for share in OVERFLOW_EDGES]},
    limits=lambda s: {"ko": (0.0, FASTEST_OVERFLOW * s.storage / s.period)},
    occurs=Occurrence.RARE,
)

linear_leak = Effect(
    "linear_leak",
    site="store",
    parameters=[amplitude_parameter("kl", "{force}/{store}", "leak over the level or pressure", low=0.0)],
    terms=lambda x, u, p: -p.kl * x.store,
    equation="-kl h",
    parity="linear",
    tells_apart=(
        "Stop inflow and outlets and let the level fall: through a laminar leak it falls by equal ratios in equal times, through a hole as"
        " a straight root of the level."
    ),
    source="laminar gap: flow proportional to the pressure",
    probe=lambda s: {"kl": s.visible_force / s.store},
    occurs=Occurrence.RARE,
)

# A limit, in the unit of the signal, that no record reaches.
OUT_OF_REACH = 1000000.0


reading_curve = Effect(
    "reading_curve",
    site="sensor",
    parameters=[
        amplitude_parameter("y0", "{sensor}", "reading of an empty tank, either sign"),
        amplitude_parameter(
            "bow", "1", "how much lower than a straight line the reading runs in between, as a share; either sign"
        ),
        # Both figures describe the way from nothing to this reading; any other would do as well.
        fixed_parameter("full", "{sensor}", 10.0, (1e-9, OUT_OF_REACH), "reading at which level and reading agree"),
    ],
    on_output=_bend_reading,
    equation="y + (1 - y/full) (y0 - bow y)",
    parity="even",
    tells_apart="Read known levels at standstill: a curved reading shows there, another law of outflow does not.",
    source="calibration curve of second order of a sensor that is not proportional",
    probe=lambda s: {"y0": 0.02 * s.reading, "bow": 0.1},
    grid=lambda s: {"full": [s.reading]},
    needs=("analogue",),
    occurs=Occurrence.EXOTIC,
    occurs_with={"analogue": Occurrence.OCCASIONAL},
)

# Where the range of a sensor may end, as shares of the range of its readings.
RANGE_ENDS: tuple[float, ...] = (1.0, 0.95, 0.85)


def _range_ends(s: Scales) -> Mapping[str, list[float]]:
    low, high = s.readings
    into = [(1 - share) * (high - low) for share in RANGE_ENDS]
    return {"y_max": [*(high - depth for depth in into), *(low + depth for depth in into)], "side": [1.0, -1.0]}


sensor_saturation = Effect(
    "sensor_saturation",
    site="sensor",
    parameters=[
        shape_parameter(
            "y_max",
            "{sensor}",
            OUT_OF_REACH,
            (-OUT_OF_REACH, OUT_OF_REACH),
            "reading at the end of the range",
            "large: absent until fitted",
        ),
        # Which end it is: no constant to be found, both are tried.
        fixed_parameter("side", "1", 1.0, (-1.0, 1.0), "1 for the upper end, -1 for the lower one"),
    ],
    # min(y, y_max) at the upper end; with both signs turned it is max(y, y_max) at the lower one.
    on_output=lambda value, x, u, p: p.side * ca.fmin(p.side * value, p.side * p.y_max),
    equation="min(y, y_max), or max(y, y_max) at a lower end",
    parity="even",
    tells_apart=(
        "Look at the reading at its top, or at its bottom: a sensor at its end shows one value exactly, without noise, whatever the plant"
        " does."
    ),
    source="end of the range of a converter",
    neutral={"y_max": OUT_OF_REACH},
    grid=_range_ends,
    occurs=Occurrence.RARE,
)

LEVEL: tuple[Effect, ...] = (upper_overflow, lower_overflow, overflow, linear_leak, reading_curve, sensor_saturation)
