"""Thermal: what a warm body does besides storing heat and losing it in proportion to its excess temperature.

The site is the balance of a state with the role ``temperature``; losses speak of an input or a parameter with the role
``ambient_temperature``. Temperatures may be in kelvin or in degrees Celsius: only radiation asks which.
"""

from __future__ import annotations

from collections.abc import Mapping

from greybox.model.balance import Balance
from greybox.model.effect import Effect, amplitude_parameter, fixed_parameter, geometric_grid, shape_parameter
from greybox.model.effects.scales import Scales
from greybox.model.parts import Occurrence
from greybox.model.signals import Expression, NamedValues, State


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
    probe=lambda s: {"Q0": s.visible_force},
    occurs=Occurrence.COMMON,
)

# Zero of the Celsius scale (K).
ZERO_CELSIUS = 273.15
# A temperature that comes below this (K) is one in degrees Celsius, or above that of the air: what is modelled here is never so cold.
COLDEST_KELVIN = 200.0


def _celsius_offset(s: Scales) -> Mapping[str, list[float]]:
    is_kelvin = s.floors["temperature"] > COLDEST_KELVIN
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
        fixed_parameter("T0", "{temperature}", 0.0, (0.0, 500.0), "absolute temperature at zero of the scale"),
    ],
    terms=lambda x, u, p: -p.kr * ((x.temperature + p.T0) ** 4 - (_ambient(u, p) + p.T0) ** 4),
    equation="-kr ((T + T0)^4 - (Ta + T0)^4)",
    parity="even",
    tells_apart=(
        "Hold several powers until the temperature stands still: the loss per kelvin of excess grows with the cube of the absolute"
        " temperature, by a third from 20 to 50 degrees Celsius; that of convection grows with the excess alone, most near zero."
    ),
    source="law of Stefan and Boltzmann; VDI Heat Atlas, part K",
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
        fixed_parameter("least", "{temperature}", 0.1, (1e-9, 1e3), "excess below which the loss is proportional"),
    ],
    terms=_convection,
    equation="-c (T - Ta) abs(T - Ta)^0.25",
    parity="odd",
    tells_apart=(
        "Let the body cool freely from far above the ambient temperature: the rate falls faster than the excess, on a logarithmic scale"
        " the curve bends; a second body that stores heat bends it too, but only after a fast change of power."
    ),
    source="laminar natural convection, Nusselt number over Rayleigh number to the power 1/4: VDI Heat Atlas, part F",
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
    probe=lambda s: {"g": s.visible_force / s.peaks["temperature"]},
    grid=lambda s: {"tau_g": geometric_grid(0.02 * s.duration, s.duration, 4)},
    needs=("second_body",),
    occurs=Occurrence.USUAL,
)

THERMAL: tuple[Effect, ...] = (heat_loss, radiation_loss, natural_convection, heat_storage)
HEAT_SOURCES: tuple[Effect, ...] = (heat_gain,)
"""After the effects of inputs: at a body that is heated an offset of its input is the same."""
