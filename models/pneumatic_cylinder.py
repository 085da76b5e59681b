"""Pneumatic cylinder with a proportional valve, linear chain (isothermal, small motions about mid-stroke). SI units.

A voltage opens the valve, which fills one chamber and vents the other (eqs. 10.2, 10.4); the piston's motion
changes both volumes (eq. 10.3); the difference of the pressures drives the piston against viscous friction
(eqs. 10.6, 10.7)::

    s'    = v
    M v'  = A (p_a - p_b) - M f_v v
    p_a'  =   G u - (P_S A / V) v          G = P_a K2 P_S / (rho_a V)
    p_b'  = - G u + (P_S A / V) v

`p_a` and `p_b` are absolute and start at `P_S / 2`. With `P_AB = p_a - p_b` this is equation 10.5, and from `u`
to `s` equation 10.9: an integrator of gain `P_a K2 / (rho_a A)` and a pair of poles with `wn^2 = 2 P_S A^2 / (M V)`.
The sum `p_a + p_b` never changes. Equal areas on both sides; rod, dead volumes and hoses are not in it.

`f_v` is mass-normalised, in 1/s, as equations 10.7 to 10.9 need it (the paper's text before them has it in N
s/m). `K2` is the mass flow per volt and pascal of upstream pressure.

What a record can tell: from `u` and `s` alone the integrator's gain, `wn` and `f_v`; slow tones show only the
gain and the lag `f_v / wn^2`. A measured pressure shows `A / M` and `P_S A / V` apart.

Source: Linear ARX modelling of pneumatic actuator system (book chapter 10), section 10.2, equations 10.1 to 10.9.
"""

from greybox import Balance, Input, Model, Output, Parameter, State


def half_supply(p):
    """Both chambers rest at half the supply pressure (the 2 in the denominator of eq. 10.4)."""
    return p.P_S / 2


def balances(x, u, p):
    flow = p.P_a * p.K2 * p.P_S / (p.rho_a * p.V_total) * u.u  # eq. 10.4, first term
    displacement = p.P_S * p.A_piston / p.V_total * x.v  # eq. 10.4, second term
    pressure = p.A_piston * (x.p_a - x.p_b)
    return [
        Balance("position", "m/s", 1, "s", velocity=x.v),
        # eq. 10.6 with F_Friction = M f_v v, which is eq. 10.7
        Balance("force", "N", p.M_piston, "v", pressure=pressure, viscous=-p.M_piston * p.f_v * x.v),
        Balance("pressure_a", "Pa/s", 1, "p_a", valve_flow=flow, displacement=-displacement),
        Balance("pressure_b", "Pa/s", 1, "p_b", valve_flow=-flow, displacement=displacement),
    ]


pneumatic_cylinder = Model(
    "pneumatic_cylinder",
    states=[
        State("s", "m", role="displacement", description="piston displacement from mid-stroke, eq. 10.3"),
        State("v", "m/s", role="velocity", description="piston velocity, eq. 10.6"),
        State("p_a", "Pa", half_supply, description="absolute pressure in chamber A, eq. 10.4"),
        State("p_b", "Pa", half_supply, description="absolute pressure in chamber B, eq. 10.4"),
    ],
    inputs=[Input("u", "V", role="drive", description="valve voltage, eq. 10.2")],
    outputs=[
        Output("s", "m", description="piston displacement"),
        Output("p_a", "Pa", description="absolute pressure in chamber A"),
        Output("p_b", "Pa", description="absolute pressure in chamber B"),
    ],
    parameters=[
        Parameter(
            "K2",
            "kg/(s*Pa*V)",
            6.5e-10,
            (1e-12, 1e-7),
            source="derived: K2 = rho_a A / P_a x 0.0472 m/s/V, the gain of eq. 10.12 at 0.05 m/V (assumed)",
            description="mass flow of the valve per volt and pascal, eq. 10.2",
        ),
        Parameter(
            "f_v",
            "1/s",
            46.15,
            (0.05, 5000.0),
            source="assumed, plausible: 60 N s/m over M_piston = 1.3 kg",
            description="viscous friction over mass, eq. 10.7",
        ),
        Parameter(
            "M_piston",
            "kg",
            1.3,
            (0.05, 50.0),
            fixed=True,
            source="assumed, plausible: piston and rod of a 40 mm x 500 mm cylinder",
            role="mass",
            description="moving mass, eq. 10.6",
        ),
        Parameter(
            "A_piston",
            "m**2",
            11.56e-4,
            (1e-5, 0.1),
            fixed=True,
            source="derived: bore 40 mm (Table 10.1), rod 16 mm (catalogue, assumed), mean of both sides",
            description="effective piston area, eq. 10.3",
        ),
        Parameter(
            "V_total",
            "m**3",
            6.98e-4,
            (1e-6, 0.1),
            fixed=True,
            source="derived: mean area x 0.5 m stroke (Table 10.1) and 2 x 60 cm3 of dead volume (assumed)",
            description="air volume of both chambers, eq. 10.3",
        ),
        Parameter(
            "P_S",
            "Pa",
            8.0e5,
            (1.2e5, 2e7),
            fixed=True,
            source="derived: 700 kPa above atmosphere (section 10.2.5)",
            description="absolute supply pressure, eq. 10.4",
        ),
        Parameter(
            "P_a",
            "Pa",
            1.013e5,
            (2e3, 1e6),
            fixed=True,
            source="standard atmosphere",
            description="ambient pressure, eq. 10.4",
        ),
        Parameter(
            "rho_a",
            "kg/m**3",
            1.205,
            (0.05, 25.0),
            fixed=True,
            source="ideal gas: air at 1.013e5 Pa and 293 K",
            description="density of ambient air, eq. 10.1",
        ),
    ],
    balances=balances,
    description="double-acting cylinder with a proportional valve, linearised about mid-stroke",
    source="Linear ARX modelling of pneumatic actuator system (chapter 10), section 10.2, eqs. 10.2 to 10.9",
)
