"""Signal path: what the drive and the sensor do to a signal on its way in and out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from greybox.model.balance import Balance
from greybox.model.effect import EVERY_BALANCE, Effect, amplitude_parameter, shape_parameter
from greybox.model.effects.flow import OUT_OF_REACH
from greybox.model.effects.scales import LONGEST_DELAY, UNTAILORED_DELAY, Scales
from greybox.model.parts import Occurrence
from greybox.model.signals import Expression, State


def _follow(value: Expression, goal: Expression, time: Expression, slowness: Expression) -> Expression:
    """``value`` moved towards ``goal`` for a time, by one unit in ``slowness`` at most; the goal where that is zero."""
    reach = time / ca.if_else(slowness > 0, slowness, ca.inf)
    return ca.if_else(slowness > 0, value + ca.fmin(ca.fmax(goal - value, -reach), reach), goal)


# Difference of the gain by sign that a search starts from beside a constant load, as a share.
GAIN_SHARE = 0.2


def _gain_from_offset(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    # An input of both signs that does less on one side has a mean: that is what a fitted offset or load shows.
    share = min(2 * abs(values["u0"]) / s.input, 0.5) if "u0" in values else GAIN_SHARE
    return [{"g": share}, {"g": -share}]


input_saturation = Effect(
    "input_saturation",
    site="input",
    parameters=[
        shape_parameter(
            "u_max",
            "{input}",
            OUT_OF_REACH,
            (1e-9, 1e9),
            "largest input that gets through",
            "large: absent until fitted",
        )
    ],
    on_input=lambda value, x, u, p: ca.fmin(ca.fmax(value, -p.u_max), p.u_max),
    equation="min(max(u, -u_max), u_max)",
    parity="odd",
    tells_apart=(
        "Look at large inputs at small displacements: a clipped input acts whatever the displacement is, a hardening"
        " spring and choked flow do not."
    ),
    source="supply voltage of an amplifier, end stop of a spool",
    neutral={"u_max": OUT_OF_REACH},
    grid=lambda s: {"u_max": [share * s.input for share in (0.97, 0.85, 0.7, 0.5)]},
    occurs=Occurrence.OCCASIONAL,
    occurs_with={"hull": Occurrence.COMMON, "actuator": Occurrence.COMMON},
)

soft_saturation = Effect(
    "soft_saturation",
    site="input",
    parameters=[shape_parameter("u_max", "{input}", OUT_OF_REACH, (1e-9, 1e9), "input that is never exceeded")],
    on_input=lambda value, x, u, p: p.u_max * ca.tanh(value / p.u_max),
    equation="u_max tanh(u / u_max)",
    parents=("input_saturation",),
    parity="odd",
    tells_apart=(
        "Drive with a slow ramp: the response bends from the start, where a hard limit leaves it straight and then stops it; a"
        " hardening spring bends with displacement instead, and winding heat takes its time."
    ),
    source="amplifier or valve driver that limits gradually",
    neutral={"u_max": OUT_OF_REACH},
    grid=lambda s: {"u_max": [share * s.input for share in (3.0, 1.5, 0.7)]},
    # tanh leaves off long before its limit: the same loss at the peak takes a limit that is higher.
    from_parent=lambda values, s: [{"u_max": factor * min(values["u_max"], s.input)} for factor in (1.0, 1.5, 3.0)],
    occurs=Occurrence.EXOTIC,
)

input_dead_zone = Effect(
    "input_dead_zone",
    site="drive",
    parameters=[amplitude_parameter("d", "{drive}", "half-width of the zone without effect", low=0.0)],
    on_input=lambda value, x, u, p: value - ca.fmin(ca.fmax(value, -p.d), p.d),
    equation="0 inside +-d, u -+ d outside",
    parity="odd",
    tells_apart=(
        "Add a constant voltage larger than d: the dead zone is gone, Coulomb friction stays; or measure the current,"
        " which stays at zero inside the zone."
    ),
    source="crossover distortion of an amplifier",
    probe=lambda s: {"d": 0.01 * s.input},
    occurs=Occurrence.OCCASIONAL,
    occurs_with={"motor": Occurrence.COMMON},
)

valve_dead_zone = replace(
    input_dead_zone,
    name="valve_dead_zone",
    site="valve",
    parameters=(amplitude_parameter("d", "{valve}", "half-width of the overlap of the spool", low=0.0),),
    tells_apart=(
        "Measure the pressures: in the dead zone none of them changes, while friction lets them build up until the"
        " piston moves."
    ),
    source="overlap of a spool and its ports; Linear ARX modelling of pneumatic actuator system (chapter 10)",
    needs=("valve",),
    occurs=Occurrence.COMMON,
    occurs_with={},
)

input_hysteresis = Effect(
    "input_hysteresis",
    site="drive",
    parameters=[amplitude_parameter("h", "{drive}", "half of the width of the loop", low=0.0)],
    states=[State("w", "{drive}", description="input that gets through")],
    update=lambda x, u, p: {"w": ca.fmin(ca.fmax(x.w, u.input - p.h), u.input + p.h)},
    # What the state was and where the input is: play does not depend on the way between.
    on_input=lambda value, x, u, p: ca.fmin(ca.fmax(x.w, value - p.h), value + p.h),
    equation="w = min(max(w, u - h), u + h), w in the place of u",
    parity="odd",
    tells_apart=(
        "Drive with slow triangles of two sizes: after each reversal nothing happens until the input has come back by 2 h, whatever"
        " its size; a dead zone is passed at zero only, and a lag shrinks with the frequency."
    ),
    source="play in front of the plant: M. Krasnoselskii, A. Pokrovskii, Systems with Hysteresis, Springer 1989",
    probe=lambda s: {"h": 0.01 * s.input},
    limits=lambda s: {"h": (0.0, s.input)},
    occurs=Occurrence.RARE,
    occurs_with={"valve": Occurrence.COMMON},
)

valve_hysteresis = replace(
    input_hysteresis,
    name="valve_hysteresis",
    site="valve",
    parameters=(amplitude_parameter("h", "{valve}", "half of the width of the loop", low=0.0),),
    states=(State("w", "{valve}", description="position of the spool, as the voltage that would hold it"),),
    source="friction of the spool and remanence of its solenoid, in data sheets of proportional valves: hysteresis 2 h over the range",
    needs=("valve",),
    occurs_with={},
)

rectified_reading = Effect(
    "rectified_reading",
    site="sensor",
    parameters=[
        amplitude_parameter("r", "1", "0.5 for a sensor that ends at zero, 1 for one without sign", low=0.0, high=1.0)
    ],
    on_output=lambda value, x, u, p: value - 2 * p.r * ca.fmin(value, 0),
    equation="y for y > 0, (1 - 2 r) y for y < 0",
    parity="even",
    tells_apart=(
        "Reverse the motion slowly: the reading goes on at zero, or turns round there, while every other output passes through."
    ),
    source="tacho with a rectifier, flow meter without direction, converter of one sign",
    probe=lambda s: {"r": 0.05},
    occurs=Occurrence.EXOTIC,
)

# Time constant (s) of a lag that no record shows.
NEUTRAL_LAG = 1e-08
# Time constants from which a lag is searched for, in samples...
LAG_SAMPLES = (0.5, 3.0, 15.0)
# ...and from there on each so many times the one before, up to this share of the record: a lag of seconds is not found from a start at
# milliseconds.
LAG_FACTOR, LONGEST_LAG = 10.0, 0.1


def list_lags(scales: Scales) -> list[float]:
    """Time constants (s) from which a lag is searched for: on all scales of time of a record."""
    lags = [samples * scales.period for samples in LAG_SAMPLES]
    while LAG_FACTOR * lags[-1] <= LONGEST_LAG * scales.duration:
        lags.append(LAG_FACTOR * lags[-1])
    return lags


valve_lag = Effect(
    "valve_lag",
    site="valve",
    parameters=[
        shape_parameter(
            "tau_v", "s", NEUTRAL_LAG, (NEUTRAL_LAG, 100.0), "lag of the spool", "small: absent until fitted"
        )
    ],
    states=[State("w", "{valve}", relaxing=True, description="spool position, as the voltage that would hold it")],
    on_input=lambda value, x, u, p: x.w,
    balances=lambda x, u, p: [Balance("spool", "{valve}", p.tau_v, "w", voltage=u.valve, spool=-x.w)],
    equation="tau_v w' = u - w, w in the place of u",
    parity="linear",
    tells_apart=(
        "Measure the pressures: a lag of the spool delays them, a lag of the sensor does not; from voltage to position"
        " both are the same. Tones at 1/tau_v tell a lag, which weakens them, from a delay."
    ),
    source="first order of a spool with its spring and solenoid",
    neutral={"tau_v": NEUTRAL_LAG},
    grid=lambda s: {"tau_v": list_lags(s)},
    limits=lambda s: {"tau_v": (min(NEUTRAL_LAG, 1e-4 * s.period), s.duration)},
    needs=("valve",),
    occurs=Occurrence.COMMON,
)

drive_lag = replace(
    valve_lag,
    name="drive_lag",
    site="drive",
    parameters=(
        shape_parameter(
            "tau_u", "s", NEUTRAL_LAG, (NEUTRAL_LAG, 1e6), "lag of the drive", "small: absent until fitted"
        ),
    ),
    states=(State("w", "{drive}", relaxing=True, description="what the drive delivers"),),
    balances=lambda x, u, p: [Balance("drive", "{drive}", p.tau_u, "w", command=u.drive, drive=-x.w)],
    equation="tau_u w' = u - w, w in the place of u",
    tells_apart=(
        "Measure what the drive delivers (current, heat, flow). From the command to the output its lag and that of a sensor are the same;"
        " tones at 1/tau_u tell a lag, which weakens them, from a delay."
    ),
    source="first order of an amplifier, a heater or a pump",
    amplitudes=("tau_u",),
    neutral={"tau_u": NEUTRAL_LAG},
    grid=lambda s: {"tau_u": list_lags(s)},
    limits=lambda s: {"tau_u": (min(NEUTRAL_LAG, 1e-4 * s.period), s.duration)},
    needs=(),
    occurs_with={"actuator": Occurrence.USUAL, "motor": Occurrence.RARE},
)

transport_delay = Effect(
    "transport_delay",
    site="input",
    parameters=[amplitude_parameter("delay", "s", "time by which the input arrives late", *UNTAILORED_DELAY)],
    delay=lambda x, u, p: p.delay,
    equation="u(t - delay)",
    parity="linear",
    tells_apart=(
        "Raise the frequency until delay times frequency is a quarter: a delay turns the phase and keeps the amplitude,"
        " a lag of amplifier, valve or sensor weakens it."
    ),
    source="transport time in a hose (about 3 ms a metre), a converter or a bus",
    probe=lambda s: {"delay": 0.4 * s.period},
    limits=lambda s: {"delay": (0.0, LONGEST_DELAY * s.period)},
    needs=("link",),
    occurs=Occurrence.COMMON,
    occurs_with={"link": Occurrence.USUAL},
)

input_offset = Effect(
    "input_offset",
    site="input",
    parameters=[amplitude_parameter("u0", "{input}", "offset between the recorded and the acting input, either sign")],
    on_input=lambda value, x, u, p: value + p.u0,
    equation="u + u0",
    parity="even",
    tells_apart=(
        "For a linear spring an input offset and a constant load give the same displacement record. Disconnect the"
        " drive: the load stays, the offset goes; or measure the current at rest, which only the offset moves."
    ),
    source="amplifier and converter offset",
    probe=lambda s: {"u0": 0.01 * s.input},
    occurs=Occurrence.COMMON,
)

input_gain = Effect(
    "input_gain",
    site="input",
    parameters=[
        amplitude_parameter("g", "1", "share by which more arrives than the record says, either sign", low=-1.0)
    ],
    on_input=lambda value, x, u, p: value * (1 + p.g),
    equation="(1 + g) u",
    parity="linear",
    tells_apart=(
        "Weigh or measure one constant of the plant by itself: with every constant free a gain only scales them. Or read the input with"
        " a second instrument."
    ),
    source="torque constant of a drive, gain of an amplifier, calibration of a force sensor",
    probe=lambda s: {"g": 0.03},
    occurs=Occurrence.OCCASIONAL,
    occurs_with={"video": Occurrence.COMMON},
)

sensor_gain = replace(
    input_gain,
    name="sensor_gain",
    site="sensor",
    parameters=(amplitude_parameter("g", "1", "share by which the reading is too large, either sign", low=-1.0),),
    on_input=None,
    on_output=lambda value, x, u, p: value * (1 + p.g),
    equation="(1 + g) y",
    tells_apart=(
        "Read two known values at standstill: their difference shows the gain, and a third one whether the reading bends."
    ),
    source="calibration of a sensor, scale of a video",
)

sensor_offset = Effect(
    "sensor_offset",
    site="sensor",
    parameters=[amplitude_parameter("y0", "{sensor}", "how much the sensor reads at zero, either sign")],
    on_output=lambda value, x, u, p: value + p.y0,
    equation="y + y0",
    parity="even",
    tells_apart=(
        "Read one known value at standstill. On a linear spring a constant load does the same; where nothing depends on the place, so"
        " does another start."
    ),
    source="zero of an encoder or of a joint, of a bridge amplifier, of a pressure cell",
    probe=lambda s: {"y0": 0.01 * s.sensor},
    occurs=Occurrence.OCCASIONAL,
)

rate_limit = Effect(
    "rate_limit",
    site="drive",
    parameters=[
        amplitude_parameter(
            "ts", "s/{drive}", "least time that a change by one unit takes: one over the fastest rate", low=0.0
        )
    ],
    states=[
        State("w", "{drive}", description="what the drive delivered at the end of the last step"),
        State("now", "s", description="time"),
        State("last", "s", description="time of that end"),
    ],
    balances=lambda x, u, p: [Balance("clock", "1", 1, "now", time=1)],
    update=lambda x, u, p: {"w": _follow(x.w, u.input, x.now - x.last, p.ts), "last": x.now},
    # It follows the input as fast as it may, from where it was: exact for an input that is held, while a ramp outlasts the step.
    on_input=lambda value, x, u, p: _follow(x.w, value, x.now - x.last, p.ts),
    equation="abs(w') <= 1/ts, w after u as fast as that allows, w in the place of u",
    parity="odd",
    tells_apart=(
        "Step by two sizes: the time to follow grows with the size under a limit of the rate and is the same under a lag; a limit of the"
        " size stays at its value."
    ),
    source="rudder, control valve, slew rate of an amplifier: T. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control",
    # From a change by the largest input within 3 % of the record.
    probe=lambda s: {"ts": 0.03 * s.duration / s.input},
    limits=lambda s: {"ts": (0.0, s.duration / s.input)},
    occurs=Occurrence.RARE,
    occurs_with={"hull": Occurrence.COMMON, "actuator": Occurrence.OCCASIONAL, "valve": Occurrence.OCCASIONAL},
)

TELLS_SIGN = (
    "Push the plant by hand, or apply a small constant input, and look which way each reading goes. From the record alone a reversed input"
    " and a plant whose every reading is reversed are the same."
)

reversed_input = Effect(
    "reversed_input",
    site="input",
    parameters=[],
    on_input=lambda value, x, u, p: -value,
    equation="-u in the place of u",
    parity="linear",
    tells_apart=TELLS_SIGN,
    source="polarity of a motor, of a valve or of the wires of an amplifier",
    occurs=Occurrence.OCCASIONAL,
)

reversed_reading = replace(
    reversed_input,
    name="reversed_reading",
    site="sensor",
    on_input=None,
    on_output=lambda value, x, u, p: -value,
    equation="-y in the place of y",
    source="direction in which an encoder counts, side from which a sensor looks",
)

late_row = Effect(
    "late_row",
    site="input",
    parameters=[],
    late=1,
    equation="u of the next row in the place of u",
    parity="linear",
    tells_apart=(
        "Look at a step of the input: a plant cannot answer before it. A logger that writes the command of the row before shows the answer"
        " one row too early."
    ),
    source="logger that reads the command before the controller has written it",
    occurs=Occurrence.OCCASIONAL,
)

early_row = replace(
    late_row,
    name="early_row",
    late=-1,
    equation="u of the row before in the place of u",
    tells_apart=(
        "Sample twice as fast: a row that is written early is early by half the time then, a delay of the plant or its drive stays."
    ),
    source="controller whose output acts from its next scan on, computing time of a controller",
)

gain_by_sign = Effect(
    "gain_by_sign",
    site="input",
    parameters=[
        amplitude_parameter(
            "g", "1", "share by which a negative input does less, negative where it does more", high=1.0
        )
    ],
    on_input=lambda value, x, u, p: value - p.g * ca.fmin(value, 0),
    equation="u for u > 0, (1 - g) u for u < 0",
    parents=("input_offset", "constant_load"),
    parity="even",
    tells_apart=(
        "Repeat a step of either sign at two sizes: the answers differ by the same ratio at both sizes, those of an input offset by"
        " the same amount; a constant load acts with the input at rest too."
    ),
    source="unequal piston areas or valve edges; amplifier with unequal branches",
    probe=lambda s: {"g": 0.03},
    from_parent=_gain_from_offset,
    limits=lambda s: {"g": (-9.0, 1.0)},
    needs=("single_rod", "valve"),
    occurs=Occurrence.EXOTIC,
    occurs_with={"single_rod": Occurrence.USUAL},
)

sensor_drift = Effect(
    "sensor_drift",
    site="sensor",
    parameters=[amplitude_parameter("rate", "{sensor}/s", "drift of the reading, either sign")],
    states=[State("drift", "{sensor}", description="how far the reading has drifted")],
    balances=lambda x, u, p: [Balance("drift", "{sensor}/s", 1, "drift", rate=p.rate)],
    on_output=lambda value, x, u, p: value + x.drift,
    equation="x + rate t",
    parity="slow",
    tells_apart=(
        "Rest for as long as the record: the reading drifts on with nothing applied; creep under a constant load slows"
        " down and goes back when the load is taken off."
    ),
    source="thermal drift of a displacement sensor",
    probe=lambda s: {"rate": 0.02 * s.sensor / s.duration},
    needs=("analogue", "slow_sensor"),
    occurs=Occurrence.RARE,
    occurs_with={"analogue": Occurrence.RARE, "encoder": Occurrence.EXOTIC, "video": Occurrence.EXOTIC},
)

clock_skew = Effect(
    "clock_skew",
    site="sensor",
    parameters=[
        amplitude_parameter("e", "1", "share by which more time passes than the stamps say, either sign", low=-0.9)
    ],
    # dx/dt_stamped = (1 + e) dx/dt: every balance stores less by this factor.
    on_storage=lambda x, u, p: {EVERY_BALANCE: 1 / (1 + p.e)},
    equation="dt = (1 + e) dt_stamped",
    parity="linear",
    tells_apart=(
        "Compare the clock of the recorder with another over a minute, or record a signal of known frequency. In the data it is a factor"
        " on every rate: constants that carry a time and are known by themselves show it."
    ),
    source="frame rate of a video, or sampling rate of a recorder, that is not the nominal one",
    probe=lambda s: {"e": 0.01},
    needs=("video",),
    occurs=Occurrence.EXOTIC,
)

sensor_lag = Effect(
    "sensor_lag",
    site="sensor",
    parameters=[
        shape_parameter(
            "tau_s", "s", NEUTRAL_LAG, (NEUTRAL_LAG, 100.0), "lag of the sensor", "small: absent until fitted"
        )
    ],
    states=[State("y", "{sensor}", lambda p: p.sensor, relaxing=True, description="what the sensor shows")],
    balances=lambda x, u, p: [Balance("lag", "{sensor}", p.tau_s, "y", value=x.sensor, reading=-x.y)],
    on_output=lambda value, x, u, p: x.y,
    equation="tau_s y' = x - y, y in the place of x",
    parity="linear",
    tells_apart=(
        "Measure the current or a pressure: a lag of the sensor leaves them alone, a delay or lag of the input does not;"
        " from the input to this sensor a lag at either end is the same."
    ),
    source="filter of a sensor or its amplifier",
    neutral={"tau_s": NEUTRAL_LAG},
    grid=lambda s: {"tau_s": list_lags(s)},
    limits=lambda s: {"tau_s": (min(NEUTRAL_LAG, 1e-4 * s.period), s.duration)},
    needs=("slow_sensor",),
    occurs=Occurrence.RARE,
    occurs_with={"slow_sensor": Occurrence.USUAL, "encoder": Occurrence.EXOTIC},
)

backlash = Effect(
    "backlash",
    site="sensor",
    parameters=[amplitude_parameter("gap", "{sensor}", "half of the play between the body and its sensor", low=0.0)],
    states=[State("w", "{sensor}", lambda p: p.sensor, description="what the sensor shows")],
    update=lambda x, u, p: {"w": ca.fmin(ca.fmax(x.w, x.sensor - p.gap), x.sensor + p.gap)},
    on_output=lambda value, x, u, p: x.w,
    equation="w = min(max(w, s - gap), s + gap), w in the place of s",
    parity="odd",
    tells_apart=(
        "Move slowly forth and back: play keeps the reading still at every reversal by the same distance whatever the"
        " force, friction keeps the body itself still until the force has changed."
    ),
    source="play in the coupling of a sensor",
    probe=lambda s: {"gap": 0.01 * s.sensor},
    needs=("gear",),
    occurs=Occurrence.OCCASIONAL,
)

# What a record may get wrong of any plant.
MISREAD: tuple[Effect, ...] = (reversed_input, reversed_reading, late_row, early_row)

SIGNAL_PATH: tuple[Effect, ...] = (
    input_saturation,
    soft_saturation,
    input_dead_zone,
    valve_dead_zone,
    input_hysteresis,
    valve_hysteresis,
    valve_lag,
    drive_lag,
    rate_limit,
    transport_delay,
    input_offset,
    input_gain,
    reversed_input,
    late_row,
    early_row,
    gain_by_sign,
    sensor_drift,
    sensor_gain,
    sensor_offset,
    reversed_reading,
    clock_skew,
    sensor_lag,
    backlash,
    rectified_reading,
)


# Between samples: what the input does there, as an effect of its own.
#
# A record holds the input at its rows only. A computer holds it until the next row, which is what a model without one of these
# effects assumes (or whatever the experiment says, see `greybox.Experiment.hold`); a measured input moves on. On a fast plant that
# difference can outweigh every nonlinearity, so it is looked at before anything else.

TELLS_APART = (
    "Look at the input with an oscilloscope, or sample it ten times as fast: steps are held, straight lines and smooth curves are"
    " not. In the data a held input is late by half a sample and no more than that at every frequency, as a short delay is."
)

linear_input = Effect(
    "linear_input",
    site="input",
    parameters=[],
    hold="first",
    equation="u straight from sample to sample",
    parity="linear",
    tells_apart=TELLS_APART,
    source="first-order hold: Astrom, Wittenmark, Computer-Controlled Systems",
    occurs=Occurrence.OCCASIONAL,
)

band_limited_input = Effect(
    "band_limited_input",
    site="input",
    parameters=[],
    hold="band-limited",
    equation="u without content above half the sampling rate",
    parity="linear",
    tells_apart=TELLS_APART,
    source="Pintelon, Schoukens, System Identification: A Frequency Domain Approach: the band-limited measurement setup",
    occurs=Occurrence.OCCASIONAL,
)

BETWEEN_SAMPLES: tuple[Effect, ...] = (linear_input, band_limited_input)
