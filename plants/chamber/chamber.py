"""A chamber of air behind a hose, as in a soft actuator: pressure of the regulator in, pressure of the chamber out. SI units.

    V / (n R T) p' = k (p_in^2 - p^2) - kl (p^2 - p_0^2)

The left side is the air that the volume `V` takes up, with the polytropic exponent `n`: 1 if it keeps its temperature, 1.4 if no
heat passes. The hose is long and narrow, its flow laminar, so that the mass flow follows the difference of the squares of the
absolute pressures (law of Hagen and Poiseuille for a gas, R. B. Bird, W. E. Stewart, E. N. Lightfoot, Transport Phenomena, 2002,
section 2.3); a leak to the air does the same.
"""

import math

from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    return [
        Balance(
            "pressure",
            "kg/s",
            p.V / (p.n * p.R * p.T),
            "p",
            hose=p.k * (u.p_in**2 - x.p**2),
            leak=-p.kl * (x.p**2 - p.p_0**2),
        )
    ]


chamber = Model(
    "chamber",
    states=[
        State("p", "Pa", 101325.0, (0.0, math.inf), role="pressure", description="absolute pressure of the chamber")
    ],
    inputs=[Input("p_in", "Pa", role="drive", description="absolute pressure after the regulator")],
    outputs=[Output("p", "Pa", description="absolute pressure of the chamber")],
    parameters=[
        Parameter("V", "m^3", 5e-5, (1e-8, 1.0), fixed=True, source="filled with water", description="volume"),
        Parameter("n", "1", 1.0, (1.0, 1.4), fixed=True, source="slow: keeps its temperature", description="exponent"),
        Parameter("R", "J/kg/K", 287.05, fixed=True, source="dry air", description="gas constant"),
        Parameter("T", "K", 293.15, fixed=True, source="laboratory", description="temperature"),
        Parameter("p_0", "Pa", 101325.0, fixed=True, source="standard atmosphere", description="pressure of the air"),
        Parameter("k", "kg/s/Pa^2", 1e-14, (1e-20, 1e-8), source="assumed", description="conductance of the hose"),
        Parameter("kl", "kg/s/Pa^2", 1e-16, (0.0, 1e-8), source="assumed", description="conductance of the leak"),
    ],
    balances=balances,
    description="chamber of air behind a hose",
)
