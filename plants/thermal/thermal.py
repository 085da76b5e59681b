"""A heated block and the sensor in its well: heater power and ambient temperature in, reading out.

    C T' = P - h (T - Ta)
    s S' = T - S

Temperatures are in degrees Celsius: only differences enter, so kelvin and degrees Celsius do the same. The block's capacity and
its heat transfer follow from the power; the sensor's time constant `s` shows in the first seconds of every change.
"""

from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    return [
        Balance("heat", "W", p.C, "T", heater=u.P, loss=-p.h * (x.T - u.Ta)),
        Balance("reading", "K", p.s, "S", block=x.T, sensor=-x.S),
    ]


thermal = Model(
    "thermal",
    states=[
        State("T", "K", 20.0, role="temperature", description="temperature of the block, in degrees Celsius"),
        State("S", "K", 20.0, description="reading of the sensor, in degrees Celsius"),
    ],
    inputs=[
        Input("P", "W", role="drive", description="power of the heater"),
        Input("Ta", "K", role="ambient_temperature", description="ambient temperature, in degrees Celsius"),
    ],
    outputs=[Output("S", "K", description="temperature, as the sensor reads it")],
    parameters=[
        Parameter("C", "J/K", 400.0, (1.0, 1e7), source="assumed", description="heat capacity of the block"),
        Parameter("h", "W/K", 0.8, (1e-3, 1e4), source="assumed", description="heat transfer to the room"),
        Parameter("s", "s", 8.0, (0.1, 1e4), source="assumed", description="time constant of the sensor"),
    ],
    balances=balances,
    description="heated block with a sensor in a well",
)
