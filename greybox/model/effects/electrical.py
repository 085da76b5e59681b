"""Electrical: what a coil does besides resistance, inductance and a constant force per ampere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from greybox.model.balance import Balance
from greybox.model.effect import Effect, amplitude_parameter, geometric_grid, shape_parameter
from greybox.model.effects.scales import Scales
from greybox.model.parts import Occurrence
from greybox.model.signals import Expression, NamedValues, State


def _drooping_constants(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
    # First even term of the bell: Kf (1 - a x^2).
    left = 1 - p.a * x.displacement**2
    # One constant may stand for both: in SI units they are the same number.
    roles = ("force_constant", "back_emf_constant") if "back_emf_constant" in p else ("force_constant",)
    return {role: p[role] * left for role in roles}


def _amplifier_current(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    """Current from the amplifier when the inductance carries ``x.current`` and ``Re`` the rest."""
    emf = (p.back_emf_constant if "back_emf_constant" in p else p.force_constant) * x.velocity
    # u = emf + R i + Re (i - iL), solved for the current i of the amplifier; iL is that of the inductance.
    return (u.drive - emf + p.Re * x.current) / (p.resistance + p.Re)


force_constant_droop = Effect(
    "force_constant_droop",
    site="force",
    parameters=[
        amplitude_parameter("a", "1/{displacement}**2", "share of force and back EMF lost per squared displacement")
    ],
    on_parameter=_drooping_constants,
    equation="Kf (1 - a x^2), Kv (1 - a x^2)",
    parity="odd",
    tells_apart=(
        "Measure the current, or compare slow motion with motion above the resonance: the loss goes with the current, the"
        " force of a cubic spring with the displacement."
    ),
    source="bell-shaped force of a voice coil over its stroke; Klippel 2006, Loudspeaker nonlinearities, Bl(x)",
    amplitudes=("a",),
    probe=lambda s: {"a": 0.03 / s.displacement**2},
    needs=("voice_coil",),
    occurs=Occurrence.EXOTIC,
    occurs_with={"voice_coil": Occurrence.USUAL},
)

winding_heating = Effect(
    "winding_heating",
    site="voltage",
    parameters=[
        amplitude_parameter("Rth", "1/({voltage}*{current})", "rise of the resistance, as a share, per power", low=0.0),
        shape_parameter("tau_th", "s", 1.0, (1e-3, 1e7), "time in which the winding warms"),
    ],
    states=[State("z", "", description="rise of the resistance, as a share")],
    on_parameter=lambda x, u, p: {"resistance": p.resistance * (1 + x.z)},
    # The resistance as it is used already carries the factor 1 + z.
    balances=lambda x, u, p: [
        Balance("heat", "1", p.tau_th, "z", power=p.Rth * p.resistance * x.current**2, cooling=-x.z)
    ],
    equation="Ra (1 + z), tau_th z' = Rth Ra (1 + z) i^2 - z",
    parity="slow",
    tells_apart=(
        "Rest, then load: the current falls as the winding warms and recovers at rest; creep leaves the current as it"
        " is."
    ),
    source="temperature coefficient of copper, 0.39 % per kelvin, with one thermal time constant",
    amplitudes=("Rth",),
    probe=lambda s: {"Rth": 0.1 / (s.input * s.current)},
    grid=lambda s: {"tau_th": geometric_grid(0.02 * s.duration, 2 * s.duration, 4)},
    needs=("motor", "voice_coil"),
    occurs=Occurrence.RARE,
    occurs_with={"voice_coil": Occurrence.COMMON},
)

eddy_current = Effect(
    "eddy_current",
    site="voltage",
    parameters=[
        shape_parameter(
            "Re",
            "{voltage}/{current}",
            1e6,
            (1e-6, 1e9),
            "loop resistance in parallel with the inductance",
            "large: absent until fitted",
        )
    ],
    on_state=lambda x, u, p: {"current": _amplifier_current(x, u, p)},
    # Only the current in the inductance makes force; the other terms take the current from the amplifier.
    on_term=lambda x, u, p: {"force": {"coil": p.force_constant * x.current}},
    equation="La iL' = Re (i - iL), u = Ra i + Re (i - iL) + Kv v, force Kf iL",
    parity="linear",
    tells_apart=(
        "Excite up to Re/La with the current measured: eddy currents let the current lead at high frequency, a delay or"
        " a slow amplifier lets it lag."
    ),
    source="semi-inductance of a coil in iron with one loop: Klippel 2006, Loudspeaker nonlinearities",
    amplitudes=("Re",),
    neutral={"Re": 1e6},
    grid=lambda s: {"Re": [factor * s.input / s.current for factor in (30.0, 5.0, 1.0, 0.3)]},
    needs=("motor", "voice_coil"),
    occurs=Occurrence.RARE,
    occurs_with={"voice_coil": Occurrence.COMMON},
)

saturating_inductance = Effect(
    "saturating_inductance",
    site="voltage",
    parameters=[amplitude_parameter("a", "1/{current}**2", "loss of inductance per squared current", low=0.0)],
    on_parameter=lambda x, u, p: {"inductance": p.inductance / (1 + p.a * x.current**2)},
    equation="La / (1 + a i^2)",
    parity="odd",
    tells_apart=(
        "Step the voltage at standstill with and without a bias current: with the bias the current rises faster at first; a warm winding"
        " changes where it ends, not how it begins."
    ),
    source="differential inductance of a coil on iron: R. Erickson, D. Maksimovic, Fundamentals of Power Electronics",
    amplitudes=("a",),
    probe=lambda s: {"a": 0.1 / s.current**2},
    needs=("motor", "voice_coil"),
    occurs=Occurrence.RARE,
)

# Share of the largest current within which the drop of a contact builds up.
BRUSH_CURRENT = 0.02


brush_drop = Effect(
    "brush_drop",
    site="voltage",
    parameters=[
        amplitude_parameter(
            "Ub", "{voltage}", "drop of brushes, a diode or another contact, nearly the same at every current", low=0.0
        ),
        replace(
            shape_parameter("ib", "{current}", 1e-3, (1e-12, 1e6), "current within which the drop builds up"),
            fixed=True,
        ),
    ],
    terms=lambda x, u, p: -p.Ub * ca.tanh(x.current / p.ib),
    equation="-Ub sign(i), smooth within ib",
    parity="odd",
    tells_apart=(
        "Hold the shaft and raise the voltage slowly with the current measured: nothing flows below the drop; a dead zone of the amplifier"
        " shows the same, but only in its own voltage. Dry friction lets current flow before anything moves."
    ),
    source="voltage drop of carbon brushes, 0.5 to 2 V a pair: A. Hughes, B. Drury, Electric Motors and Drives",
    amplitudes=("Ub",),
    probe=lambda s: {"Ub": s.visible_force},
    grid=lambda s: {"ib": [BRUSH_CURRENT * s.current]},
    needs=("motor",),
    occurs=Occurrence.RARE,
)

ELECTRICAL: tuple[Effect, ...] = (
    force_constant_droop,
    winding_heating,
    eddy_current,
    saturating_inductance,
    brush_drop,
)


# Heat: what a warm body does besides storing heat and losing it in proportion to its excess temperature.
#
# The site is the balance of a state with the role ``temperature``; losses speak of an input or a parameter with the role
# ``ambient_temperature``. Temperatures may be in kelvin or in degrees Celsius: only radiation asks which.


def _ambient(u: NamedValues, p: NamedValues) -> Expression:
    return u.ambient_temperature if "ambient_temperature" in u else p.ambient_temperature


def _convection(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    excess = x.temperature - _ambient(u, p)
    # A root of a square keeps its slope at zero; below the least excess the loss is proportional.
    return -p.c * excess * (excess**2 + p.least**2) ** 0.125


heat_loss = Effect(
    "heat_loss",
    site="heat",
    parameters=[amplitude_parameter("G", "{force}/{temperature}", "conductance to the ambient temperature", low=0.0)],
    terms=lambda x, u, p: -p.G * (x.temperature - _ambient(u, p)),
    equation="-G (T - Ta)",
    parity="linear",
    tells_apart=(
        "Hold several powers until the temperature stands still: the power over the excess temperature is the same at all of them; a sensor"
        " that reads too much shows the same, and a second thermometer tells."
    ),
    source="law of cooling of Newton; VDI Heat Atlas, part C",
    amplitudes=("G",),
    probe=lambda s: {"G": s.visible_force / s.peaks["temperature"]},
    occurs=Occurrence.COMMON,
)

heat_gain = Effect(
    "heat_gain",
    site="heat",
    parameters=[
        amplitude_parameter("Q0", "{force}", "constant heat from elsewhere (sun, people, losses), either sign")
    ],
    terms=lambda x, u, p: p.Q0,
    equation="+Q0",
    parity="even",
    tells_apart=(
        "Switch the heater off for long: what stays warmer than the ambient temperature is heated by something else, or its thermometer"
        " reads too much; a second thermometer tells."
    ),
    source="internal and solar gains of a zone: ISO 52016-1",
    amplitudes=("Q0",),
    probe=lambda s: {"Q0": s.visible_force},
    occurs=Occurrence.COMMON,
)

# Zero of the Celsius scale (K).
ZERO_CELSIUS = 273.15
# A temperature whose peak is below this is in degrees Celsius: nothing that is modelled here runs that cold in kelvin.
WARMEST_CELSIUS = 200.0


def _celsius_offset(s: Scales) -> Mapping[str, list[float]]:
    is_kelvin = s.peaks["temperature"] > WARMEST_CELSIUS
    return {"T0": [0.0 if is_kelvin else ZERO_CELSIUS]}


def _radiation_probe(s: Scales) -> Mapping[str, float]:
    # Stefan and Boltzmann: kr T^4, T in kelvin.
    warm = s.peaks["temperature"] + _celsius_offset(s)["T0"][0]
    return {"kr": s.visible_force / warm**4}


radiation_loss = Effect(
    "radiation_loss",
    site="heat",
    parameters=[
        amplitude_parameter(
            "kr", "{force}/{temperature}**4", "emissivity times area times 5.67e-8 W/(m^2 K^4)", low=0.0
        ),
        replace(
            shape_parameter(
                "T0", "{temperature}", ZERO_CELSIUS, (0.0, 500.0), "absolute temperature at zero of the scale"
            ),
            fixed=True,
        ),
    ],
    terms=lambda x, u, p: -p.kr * ((x.temperature + p.T0) ** 4 - (_ambient(u, p) + p.T0) ** 4),
    equation="-kr ((T + T0)^4 - (Ta + T0)^4)",
    parity="even",
    tells_apart=(
        "Hold several powers until the temperature stands still: the loss per kelvin of excess grows with the cube of the absolute"
        " temperature, by a third from 20 to 50 degrees Celsius; that of convection grows with the excess alone, most near zero."
    ),
    source="law of Stefan and Boltzmann; VDI Heat Atlas, part K",
    amplitudes=("kr",),
    probe=_radiation_probe,
    grid=_celsius_offset,
    occurs=Occurrence.RARE,
)

# Share of the largest temperature below which convection counts as proportional: its power has no slope at zero excess.
LEAST_EXCESS = 0.001


natural_convection = Effect(
    "natural_convection",
    site="heat",
    parameters=[
        amplitude_parameter(
            "c", "{force}/{temperature}**1.25", "loss over the excess temperature to the power 1.25", low=0.0
        ),
        # Below this excess the loss is proportional; it only keeps the slope of the power finite.
        replace(
            shape_parameter("least", "{temperature}", 0.1, (1e-9, 1e3), "excess below which the loss is proportional"),
            fixed=True,
        ),
    ],
    terms=_convection,
    equation="-c (T - Ta) abs(T - Ta)^0.25",
    parity="odd",
    tells_apart=(
        "Let the body cool freely from far above the ambient temperature: the rate falls faster than the excess, on a logarithmic scale"
        " the curve bends; a second body that stores heat bends it too, but only after a fast change of power."
    ),
    source="laminar natural convection, Nusselt number over Rayleigh number to the power 1/4: VDI Heat Atlas, part F",
    amplitudes=("c",),
    probe=lambda s: {"c": s.visible_force / s.peaks["temperature"] ** 1.25},
    grid=lambda s: {"least": [LEAST_EXCESS * s.peaks["temperature"]]},
    occurs=Occurrence.RARE,
)

heat_storage = Effect(
    "heat_storage",
    site="heat",
    parameters=[
        amplitude_parameter("g", "{force}/{temperature}", "conductance to a second body that stores heat", low=0.0),
        shape_parameter("tau_g", "s", 100.0, (1e-3, 1e9), "time in which the second body follows"),
    ],
    states=[State("z", "{temperature}", lambda p: p.temperature, description="temperature of the second body")],
    terms=lambda x, u, p: -p.g * (x.temperature - x.z),
    balances=lambda x, u, p: [Balance("store", "{temperature}", p.tau_g, "z", body=x.temperature, store=-x.z)],
    equation="-g (T - z), tau_g z' = T - z",
    parity="slow",
    tells_apart=(
        "Heat for a short and for a long time to the same temperature, then let it cool: after the long time a warm second body holds"
        " the temperature up; an ambient that drifts does so without any heating."
    ),
    source="two thermal capacities in a chain: K. Ogata, System Dynamics, section on thermal systems",
    amplitudes=("g",),
    probe=lambda s: {"g": s.visible_force / s.peaks["temperature"]},
    grid=lambda s: {"tau_g": geometric_grid(0.02 * s.duration, s.duration, 4)},
    needs=("second_body",),
    occurs=Occurrence.USUAL,
)

THERMAL: tuple[Effect, ...] = (heat_loss, radiation_loss, natural_convection, heat_storage)
HEAT_SOURCES: tuple[Effect, ...] = (heat_gain,)
"""After the effects of inputs: at a body that is heated an offset of its input is the same."""
