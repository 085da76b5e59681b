"""A hydraulic cylinder with a servo valve: valve command in, position and load pressure out. SI units.

    x'           = v
    M v'         = A pL - B v
    V / (4 E) pL' = Kq u - A v - Cl pL

`pL` is the pressure difference between the chambers, `Kq` the flow gain of the valve near its centre, `Cl` the leak across the
piston, `E` the bulk modulus (Merritt, Hydraulic Control Systems, 1967, section 6.2).
"""

from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    return [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", pressure=p.A * x.pL, viscous=-p.B * x.v),
        Balance("flow", "m^3/s", p.V / (4 * p.E), "pL", valve=p.Kq * u.u, piston=-p.A * x.v, leak=-p.Cl * x.pL),
    ]


cylinder = Model(
    "cylinder",
    states=[
        State("x", "m", role="displacement", description="position of the piston"),
        State("v", "m/s", role="velocity", description="velocity of the piston"),
        State("pL", "Pa", role="pressure", description="load pressure"),
    ],
    inputs=[Input("u", "V", role="valve", description="command of the valve")],
    outputs=[Output("x", "m", description="position"), Output("pL", "Pa", description="load pressure")],
    parameters=[
        Parameter("M", "kg", 80.0, (1.0, 1e4), role="mass", source="weighed", fixed=True, description="moving mass"),
        Parameter(
            "A", "m^2", 1.2e-3, (1e-5, 1.0), role="piston_area", source="drawing", fixed=True, description="piston area"
        ),
        Parameter("B", "N*s/m", 800.0, (1.0, 1e6), role="damping", source="assumed", description="viscous friction"),
        Parameter(
            "V", "m^3", 6e-4, (1e-6, 1.0), role="total_volume", source="drawing", fixed=True, description="enclosed oil"
        ),
        Parameter("E", "Pa", 9e8, (1e7, 3e9), source="assumed", description="bulk modulus of the oil, hoses included"),
        Parameter("Kq", "m^3/s/V", 4e-5, (1e-8, 1.0), source="data sheet", description="flow gain of the valve"),
        Parameter("Cl", "m^3/s/Pa", 1e-12, (1e-16, 1e-6), source="assumed", description="leak across the piston"),
    ],
    balances=balances,
    description="servo valve and double-acting cylinder",
)
