"""The pneumatic chain put together from parts: a valve, two chambers, a piston. SI units, absolute pressures.

Each part is a frozen value that says what it needs (constants, states of its own) and what it gives::

    valve      mass flows m_a, m_b [kg/s] into the chambers      (eqs. 10.1, 10.2)
    chambers   rates of p_a, p_b [Pa/s], force on the piston [N] (eqs. 10.3, 10.4)
    piston     the other forces [N]                              (eqs. 10.6, 10.7)

`pneumatic_chain` assembles them into one model with the states `s`, `v`, `p_a`, `p_b` and those of the parts. Any
valve goes with any chambers and any piston. What acts on the piston from outside (dry friction, loads, springs) is
an effect: `pneumatic_full + effect("coulomb_friction")`.

The gas is at ambient temperature where it is weighed, so that `R T = P_a / rho_a`.

Source: Linear ARX modelling of pneumatic actuator system (book chapter 10), section 10.2.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.model import Rule
from greybox.model.signals import Expression, NamedValues

Terms = dict[str, Expression]  # by name
Flows = tuple[Terms, Terms]  # kg/s into chamber A, and into chamber B


@dataclass(frozen=True)
class Valve:
    """`flows(x, u, p)`: named mass flows into chamber A and into B [kg/s]; `balances(x, u, p)` of its own `states`;
    `rules` that its constants must keep.
    """

    flows: Callable[[NamedValues, NamedValues, NamedValues], Flows]
    parameters: tuple[Parameter, ...]
    states: tuple[State, ...] = ()
    balances: Callable[[NamedValues, NamedValues, NamedValues], list[Balance]] | None = None
    rules: tuple[Rule, ...] = ()


@dataclass(frozen=True)
class Chambers:
    """`rates(x, p, flows)`: named terms of the rates of `p_a` and of `p_b` [Pa/s]; `force(x, p)` of the gas on the
    piston [N]; `start`: pressures at rest, as functions of the constants; `pressure_bounds`: where the equations hold.
    """

    rates: Callable[[NamedValues, NamedValues, Flows], tuple[Terms, Terms]]
    force: Callable[[NamedValues, NamedValues], Expression]
    start: tuple[Callable[[NamedValues], Expression], Callable[[NamedValues], Expression]]
    parameters: tuple[Parameter, ...]
    rules: tuple[Rule, ...] = ()
    pressure_bounds: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True)
class Piston:
    """`forces(x, p)`: named forces on the piston [N] besides that of the gas."""

    forces: Callable[[NamedValues, NamedValues], Terms]
    parameters: tuple[Parameter, ...]


SUPPLY = Parameter(
    "P_S",
    "Pa",
    8.0e5,
    (1.2e5, 2e7),
    fixed=True,
    source="derived: 700 kPa above atmosphere (section 10.2.5)",
    role="supply_pressure",
    description="absolute supply pressure, eq. 10.4",
)
AMBIENT = Parameter(
    "P_a",
    "Pa",
    1.013e5,
    (2e3, 1e6),
    fixed=True,
    source="standard atmosphere",
    role="ambient_pressure",
    description="ambient pressure, eq. 10.4",
)
DENSITY = Parameter(
    "rho_a",
    "kg/m**3",
    1.205,
    (0.05, 25.0),
    fixed=True,
    source="ideal gas: air at 1.013e5 Pa and 293 K",
    role="ambient_density",
    description="density of ambient air, eq. 10.1",
)
STROKE = Parameter(
    "stroke",
    "m",
    0.5,
    (0.01, 5.0),
    fixed=True,
    source="Table 10.1: DNC-40-500",
    description="stroke of the piston, from -stroke/2 to stroke/2",
)

SUPPLY_ABOVE_AMBIENT = Rule(
    "supply above ambient", "Pa", lambda p: p.P_S - p.P_a, "give both as absolute pressures (a gauge shows P_S - P_a)"
)
PRESSURE_POSITIVE = "give absolute pressures; a gauge shows them without the ambient pressure"


def pressure_rules() -> tuple[Rule, ...]:
    """Measured pressures are absolute, so above zero."""
    return tuple(
        Rule("absolute pressure above 0", "Pa", lambda value, p: value, PRESSURE_POSITIVE, output)
        for output in ("p_a", "p_b")
    )


def half_supply(p: NamedValues) -> Expression:
    """Both chambers rest at half the supply pressure (the 2 in the denominator of eq. 10.4)."""
    return p.P_S / 2


def pneumatic_chain(
    name: str,
    *,
    valve: Valve,
    chambers: Chambers,
    piston: Piston,
    description: str = "",
    source: str = "",
    candidates: tuple[str, ...] = (),
) -> Model:
    """One model from a valve, two chambers and a piston; input `u`, outputs `s`, `p_a`, `p_b`.

    Constants that several parts need (`stroke`) appear once. Raises ModelError for parts whose names clash.
    """

    def balances(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        rate_a, rate_b = chambers.rates(x, p, valve.flows(x, u, p))
        return [
            Balance("position", "m/s", 1, "s", velocity=x.v),
            Balance("force", "N", p.M_piston, "v", pressure=chambers.force(x, p), **piston.forces(x, p)),  # eq. 10.6
            Balance("pressure_a", "Pa/s", 1, "p_a", **rate_a),
            Balance("pressure_b", "Pa/s", 1, "p_b", **rate_b),
            *(valve.balances(x, u, p) if valve.balances else []),
        ]

    start_a, start_b = chambers.start
    everything = (*valve.parameters, *piston.parameters, *chambers.parameters, SUPPLY, AMBIENT, DENSITY)
    return Model(
        name,
        states=[
            State("s", "m", role="displacement", description="piston displacement from mid-stroke, eq. 10.3"),
            State("v", "m/s", role="velocity", description="piston velocity, eq. 10.6"),
            State(
                "p_a", "Pa", start_a, chambers.pressure_bounds, "chamber_a", "absolute pressure in chamber A, eq. 10.4"
            ),
            State(
                "p_b", "Pa", start_b, chambers.pressure_bounds, "chamber_b", "absolute pressure in chamber B, eq. 10.4"
            ),
            *valve.states,
        ],
        inputs=[Input("u", "V", role="valve", description="valve voltage, eq. 10.2")],
        outputs=[
            Output("s", "m", description="piston displacement"),
            Output("p_a", "Pa", description="absolute pressure in chamber A"),
            Output("p_b", "Pa", description="absolute pressure in chamber B"),
        ],
        parameters=list(dict.fromkeys(everything)),
        balances=balances,
        rules=(SUPPLY_ABOVE_AMBIENT, *pressure_rules(), *valve.rules, *chambers.rules),
        description=description,
        source=source,
        candidates=candidates,
    )
