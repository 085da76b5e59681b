"""Heat: what a warm body does besides storing heat and losing it in proportion to its excess temperature.

The site is the balance of a state with the role ``temperature``; losses speak of an input or a parameter with the role
``ambient_temperature``. Temperatures may be in kelvin or in degrees Celsius: only radiation asks which.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from greybox.effects.parameters import amplitude_parameter, geometric_grid, shape_parameter
from greybox.effects.policy import START
from greybox.effects.scales import Scales
from greybox.model import Balance, Effect
from greybox.model.signals import Expression, NamedValues, State


def _ambient(u: NamedValues, p: NamedValues) -> Expression:
    return u.ambient_temperature if "ambient_temperature" in u else p.ambient_temperature


def _radiation(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.kr * ((x.temperature + p.T0) ** 4 - (_ambient(u, p) + p.T0) ** 4)


def _convection(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    excess = x.temperature - _ambient(u, p)
    # A root of a square keeps its slope at zero; below the least excess the loss is proportional.
    return -p.c * excess * (excess**2 + p.least**2) ** 0.125


def _heat_into_store(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.g * (x.temperature - x.z)


def _store_balance(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
    return [Balance("store", "{temperature}", p.tau_g, "z", body=x.temperature, store=-x.z)]


def _celsius_offset(s: Scales) -> Mapping[str, list[float]]:
    is_kelvin = s.peaks["temperature"] > START.warmest_celsius
    return {"T0": [0.0 if is_kelvin else START.zero_celsius]}


def _radiation_probe(s: Scales) -> Mapping[str, float]:
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
                "T0", "{temperature}", START.zero_celsius, (0.0, 500.0), "absolute temperature at zero of the scale"
            ),
            fixed=True,
        ),
    ],
    terms=_radiation,
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
)

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
    grid=lambda s: {"least": [START.least_excess * s.peaks["temperature"]]},
)

heat_storage = Effect(
    "heat_storage",
    site="heat",
    parameters=[
        amplitude_parameter("g", "{force}/{temperature}", "conductance to a second body that stores heat", low=0.0),
        shape_parameter("tau_g", "s", 100.0, (1e-3, 1e9), "time in which the second body follows"),
    ],
    states=[State("z", "{temperature}", lambda p: p.temperature, description="temperature of the second body")],
    terms=_heat_into_store,
    balances=_store_balance,
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
)

THERMAL: tuple[Effect, ...] = (radiation_loss, natural_convection, heat_storage)
