"""Micro-motion actuator: a compliant four-bar mechanism driven by a square hollow coil. Whole device, SI units.

The mechanism is one lumped mass on one lumped spring and damper (eq. 9), moved by the coil's force `Kf i` (eq.
10). The coil is a resistance and an inductance in series with the back electromotive force `Kv v` (eqs. 11,
14)::

    x'    = v
    M v'  = Kf i - B v - K x
    La i' = u - Ra i - Kv v

From `u` to `x` this is equation 16.1, third order; with `La = 0` it is equation 16.2, second order, the model
`micro_actuator_no_inductance`. The paper counts `M`, `B` and `K` for one quarter of the mechanism and the coil
circuit for the whole device; here everything is the whole device (four quarters), and only there energy
conservation makes `Kf = Kv`. `models.micro_actuator_geometry` leads from links and hinges to `M`, `B` and `K`.

What a record can tell: from `u` and `x` alone the four coefficients of equation 16.1 (three without `La`); with
`i` measured as well everything but the common scale of `M`, `B`, `K` and `Kf`. One weighed mass closes it.

Numbers: the paper identifies a gain of 29.539 um/V and the poles -25.596 +- 767.98j 1/s (section 4.2, eq. 17).
`M`, `Ra` and `La` are assumed; `B`, `K` and `Kf = Kv` follow from them so that gain and slow poles are the
paper's.

Source: Y.-L. Wang, Micro motion actuator of compliant mechanism for parameter estimation (accepted 2010),
section 4.2, equations 5 to 17.
"""

from greybox import Balance, Input, Model, Output, Parameter, State

# What may hide in a coil and a flexure: no joint with play, no valve.
CANDIDATES = (
    *("coulomb_friction", "stribeck_friction", "lugre_friction", "quadratic_damping"),
    *("cubic_stiffness", "quadratic_stiffness", "viscoelastic_creep", "bouc_wen_hysteresis", "second_mode"),
    *("force_constant_droop", "winding_heating", "eddy_current", "constant_load"),
    *("input_saturation", "soft_saturation", "input_dead_zone", "transport_delay", "input_offset"),
    *("sensor_drift", "sensor_lag"),
    *("end_stop", "end_stops", "cogging", "gain_by_sign"),
)
FITTED = "derived: eq. 16.1 with gain and poles of section 4.2, the assumed M, Ra, La, and Kf = Kv"
FITTED_NO_INDUCTANCE = "derived: eq. 16.2 with gain and poles of section 4.2, the assumed M and Ra, and Kf = Kv"
ASSUMED = "assumed, plausible"

DISPLACEMENT = State("x", "m", role="displacement", description="displacement of the moving link, eq. 9")
VELOCITY = State("v", "m/s", role="velocity", description="velocity of the moving link, eq. 9")
CURRENT = State("i", "A", role="current", description="coil current, eq. 10")
VOLTAGE = Input("u", "V", role="drive", description="coil voltage, V(s) of eq. 14")

MASS = Parameter(
    "M", "kg", 0.010, (1e-4, 1.0), source=ASSUMED, role="mass", description="moving mass of the whole device, eq. 5"
)
RESISTANCE = Parameter(
    "Ra", "ohm", 8.0, (0.1, 1000.0), source=ASSUMED, role="resistance", description="coil resistance, eq. 14"
)
INDUCTANCE = Parameter(
    "La",
    "H",
    0.5e-3,
    (1e-6, 0.1),
    source="assumed, plausible ('very small', section 4.2)",
    role="inductance",
    description="coil inductance, eq. 14",
)


def lumped(B: float, K: float, Kf: float, source: str) -> list[Parameter]:
    """The lumped constants of equations 6, 7, 10 and 11."""
    return [
        Parameter(
            "B", "N*s/m", B, (1e-4, 100.0), source=source, role="damping", description="structural damping, eq. 6"
        ),
        Parameter(
            "K", "N/m", K, (10.0, 1e6), source=source, role="stiffness", description="stiffness of the hinges, eq. 7"
        ),
        Parameter(
            "Kf", "N/A", Kf, (1e-2, 100.0), source=source, role="force_constant", description="force constant, eq. 10"
        ),
        Parameter(
            "Kv",
            "V*s/m",
            Kf,
            (1e-2, 100.0),
            source=source,
            role="back_emf_constant",
            description="back EMF constant, eq. 11",
        ),
    ]


def balances(x, u, p):
    return [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        # eq. 9 with eq. 10
        Balance("force", "N", p.M, "v", coil=p.Kf * x.i, damping=-p.B * x.v, spring=-p.K * x.x),
        # eq. 14 with eq. 11
        Balance("voltage", "V", p.La, "i", supply=u.u, resistance=-p.Ra * x.i, back_emf=-p.Kv * x.v),
    ]


def algebraic_current(x, u, p):
    """Equation 14 with La = 0: the current follows the voltage at once."""
    return (u.u - p.Kv * x.v) / p.Ra


def balances_no_inductance(x, u, p):
    coil = p.Kf * algebraic_current(x, u, p)
    return [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", coil=coil, damping=-p.B * x.v, spring=-p.K * x.x),
    ]


micro_actuator = Model(
    "micro_actuator",
    states=[DISPLACEMENT, VELOCITY, CURRENT],
    inputs=[VOLTAGE],
    outputs=[
        Output("x", "m", description="displacement"),
        Output("i", "A", description="coil current"),
    ],
    parameters=[MASS, *lumped(B=0.2691, K=5895.5, Kf=1.3932, source=FITTED), RESISTANCE, INDUCTANCE],
    balances=balances,
    description="compliant four-bar mechanism driven by a voice coil, whole device",
    source="Wang, Micro motion actuator of compliant mechanism for parameter estimation, section 4.2, eq. 16.1",
    candidates=CANDIDATES,
)

micro_actuator_no_inductance = Model(
    "micro_actuator_no_inductance",
    states=[DISPLACEMENT, VELOCITY],
    inputs=[VOLTAGE],
    outputs=[
        Output("x", "m", description="displacement"),
        Output("i", "A", algebraic_current, description="coil current"),
    ],
    parameters=[MASS, *lumped(B=0.2685, K=5904.4, Kf=1.3953, source=FITTED_NO_INDUCTANCE), RESISTANCE],
    balances=balances_no_inductance,
    description="the micro-motion actuator with the coil's inductance neglected, second order",
    source="Wang, Micro motion actuator of compliant mechanism for parameter estimation, section 4.2, eq. 16.2",
    candidates=CANDIDATES,
)
