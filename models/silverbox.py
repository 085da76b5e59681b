"""Silverbox: an electronic circuit that behaves as a mass on a spring. Its displacement is a voltage.

Divided by the mass, of which the circuit has none to weigh::

    y'            = v
    y'' + d y' + k1 y = b u

so the balance `force` is in V/s^2 (force over mass) and stores 1. The circuit's spring hardens, which is left
to effects (`cubic_stiffness`, a small `quadratic_stiffness`). The input was recorded band-limited, not held
between samples.

Source: T. Wigren, J. Schoukens, Three free data sets for development and benchmarking in nonlinear system
identification, European Control Conference, 2013.
"""

from greybox import Balance, Input, Model, Output, Parameter, State

ROUGH = "derived: rough second-order fit to the frequency response of the multisine record, 10 to 150 Hz"


def balances(x, u, p):
    return [
        Balance("position", "V/s", 1, "y", velocity=x.v),
        Balance("force", "V/s**2", 1, "v", supply=p.b * u.u, damping=-p.d * x.v, spring=-p.k1 * x.y),
    ]


silverbox = Model(
    "silverbox",
    states=[
        State("y", "V", role="displacement", description="displacement of the mass, as a voltage"),
        State("v", "V/s", role="velocity", description="its rate"),
    ],
    inputs=[Input("u", "V", role="drive", description="force on the mass, as a voltage")],
    outputs=[Output("y", "V", description="displacement of the mass, as a voltage")],
    parameters=[
        Parameter("d", "1/s", 43.0, (0.5, 5e3), source=ROUGH, role="damping", description="damping over mass"),
        Parameter(
            "k1",
            "1/s**2",
            1.9e5,
            (1e3, 1e7),
            source=ROUGH,
            role="stiffness",
            description="stiffness over mass, resonance at about 70 Hz",
        ),
        Parameter("b", "1/s**2", 1.9e5, (1e3, 1e7), source=ROUGH, description="input gain over mass"),
    ],
    balances=balances,
    description="electronic mass on a hardening spring",
    source="Wigren, Schoukens 2013, Three free data sets for development and benchmarking",
    candidates=(
        *("cubic_stiffness", "quadratic_stiffness", "viscoelastic_creep", "quadratic_damping", "constant_load"),
        *("displacement_damping", "cubic_damping"),
        *("input_offset", "input_saturation", "transport_delay", "sensor_drift", "sensor_lag"),
        *("linear_input", "band_limited_input"),
    ),
)
