"""Electro-mechanical positioning system: a motor turns a ball screw that moves a carriage. SI units.

The drive's current loop is far faster than the mechanics, so the control voltage is a force `g u` at the
carriage::

    q'    = v
    M q'' = g u - Fv q'

`M` is the carriage with the inertia of motor and screw referred to it, `Fv` all viscous friction. The gain `g`
is known, which gives the mass its scale. Friction that does not vanish at standstill, and an offset, are left
to effects (`coulomb_friction`, `constant_load`). The records were taken in closed loop and begin with the
carriage moving slowly.

Source: A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System
Identification Benchmarks, 2019.
"""

from greybox import Balance, Input, Model, Output, Parameter, State

INVERSE_DYNAMICS = "Janot, Gautier, Brunot 2019, inverse dynamics and least squares"


def balances(x, u, p):
    return [
        Balance("position", "m/s", 1, "q", velocity=x.v),
        Balance("force", "N", p.M, "v", motor=p.g * u.u, viscous=-p.Fv * x.v),
    ]


emps = Model(
    "emps",
    states=[
        State("q", "m", role="displacement", description="position of the carriage"),
        State("v", "m/s", role="velocity", description="velocity of the carriage"),
    ],
    inputs=[Input("u", "V", role="drive", description="control voltage of the drive")],
    outputs=[Output("q", "m", description="position of the carriage")],
    parameters=[
        Parameter(
            "M",
            "kg",
            95.0,
            (1.0, 1e4),
            source=INVERSE_DYNAMICS,
            role="mass",
            description="moving mass, rotating parts included",
        ),
        Parameter(
            "Fv", "N*s/m", 203.5, (1.0, 1e5), source=INVERSE_DYNAMICS, role="damping", description="viscous friction"
        ),
        Parameter(
            "g",
            "N/V",
            35.15065,
            (1.0, 1e3),
            fixed=True,
            source="Janot, Gautier, Brunot 2019, drive gain given with the data",
            role="force_constant",
            description="force per volt",
        ),
    ],
    balances=balances,
    description="motor, ball screw and carriage, closed loop",
    source="Janot, Gautier, Brunot 2019, Data set and reference models of EMPS",
    candidates=(
        *("coulomb_friction", "stribeck_friction", "lugre_friction", "quadratic_damping", "second_mode"),
        *(
            "directional_damping",
            "constant_load",
            "input_offset",
            "input_saturation",
            "input_dead_zone",
            "transport_delay",
        ),
        *("backlash", "sensor_lag", "linear_input"),
    ),
)
