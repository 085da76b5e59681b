"""Two water tanks in cascade: a pump fills the upper one, which drains into the lower one. Levels are read in volt.

Outflow through a small hole after Torricelli, speed as the square root of the level::

    x1' = -k1 sqrt(x1) + k4 u
    x2' =  k2 sqrt(x1) - k3 sqrt(x2)        y = x2

Only the lower level is measured, so the scale of the upper one is free: with `x1 = c z` and `k1, k2, k4`
replaced by `k1 / sqrt(c)`, `k2 sqrt(c)`, `k4 / c` every record stays the same. Fixing `k2` at any positive
number chooses that scale; it is a choice of unit for `x1`, not knowledge about the tank. The value here is near
`k1`, so that the upper level is in nearly the same unit as the lower one (equal tanks would have `k2 = k1`).

Levels cannot be negative, and no record begins empty. The tanks overflow and the sensor ends at 10 V: neither
is in here.

Source: M. Schoukens, P. Mattsson, T. Wigren, J.-P. Noel, Cascaded tanks benchmark combining soft and hard
nonlinearities, Workshop on Nonlinear System Identification Benchmarks, 2016.
"""

import math

import casadi as ca

from greybox import Balance, Input, Model, Output, Parameter, State

ROUGH = "derived: rough fit of this model to the estimation record with k2 = 0.05 V**0.5/s"


def balances(x, u, p):
    upper, lower = ca.sqrt(x.x1), ca.sqrt(x.x2)
    return [
        Balance("upper_level", "V/s", 1, "x1", outflow=-p.k1 * upper, pump=p.k4 * u.u),
        Balance("lower_level", "V/s", 1, "x2", inflow=p.k2 * upper, outflow=-p.k3 * lower),
    ]


cascaded_tanks = Model(
    "cascaded_tanks",
    states=[
        State(
            "x1",
            "V",
            15.0,
            (0.0, math.inf),
            role="upper_head",
            description="level of the upper tank, unit chosen by k2",
        ),
        State("x2", "V", 5.0, (0.0, math.inf), role="lower_head", description="level of the lower tank"),
    ],
    inputs=[Input("u", "V", role="drive", description="pump voltage")],
    outputs=[Output("y", "V", lambda x, u, p: x.x2, description="level of the lower tank")],
    parameters=[
        Parameter(
            "k1",
            "V**0.5/s",
            0.06,
            (1e-3, 5.0),
            source=ROUGH,
            role="upper_outlet",
            description="outflow of the upper tank",
        ),
        Parameter(
            "k2",
            "V**0.5/s",
            0.05,
            (1e-3, 5.0),
            fixed=True,
            role="lower_inlet",
            source="chosen: fixes the free scale of the upper level, any positive number fits equally well",
            description="inflow of the lower tank; fixed, because it only sets the unit of x1",
        ),
        Parameter("k3", "V**0.5/s", 0.09, (1e-3, 5.0), source=ROUGH, description="outflow of the lower tank"),
        Parameter("k4", "1/s", 0.09, (1e-3, 5.0), source=ROUGH, description="pump flow per volt"),
    ],
    balances=balances,
    description="pump, upper tank, lower tank with its level measured",
    source="Schoukens, Mattsson, Wigren, Noel 2016, Cascaded tanks benchmark",
    candidates=(
        *("upper_overflow", "lower_overflow", "reading_curve", "sensor_saturation"),
        *("input_offset", "input_saturation", "input_dead_zone", "transport_delay"),
        *("sensor_drift", "sensor_lag", "backlash", "linear_input"),
    ),
)
