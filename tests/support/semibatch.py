"""A semibatch reactor with two exothermic reactions ``A -> B -> C``, published with a simulated record and the constants behind it.

The model is that of Nicholson and others, Mathematical Programming Computation 10 (2018), 187; record and constants are those of the first
experiment that parmest (Klise and others, Computer Aided Chemical Engineering 47, 2019) brings with it.
"""

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from greybox import Balance, Experiment, Input, Model, Output, Parameter, State

TRUTH = {"k1": 15.01, "k2": 85.01, "E1": 30000.0, "E2": 40000.0}
"""Frequency factors in 1/s, activation energies in kJ/kmol."""

GAS = 8.314  # kJ/(kmol K)
HEAT = 1000.0 * 3.9  # density times heat capacity of the mixture, kJ/(m^3 K)
COOLING = 0.8 * 5.0 + 0.7 * 3.0  # jacket and coil, both at the coolant's temperature, kJ/(s K m^3) for a cubic metre

MEASURED = {
    "Ca": (
        "0.3179205 2.5735850 4.6388764 5.6554581 6.1616034 6.5678243 6.1755224 6.1190611 5.3430340 5.1431251 5.0682068"
        " 3.7282923 2.6547647 2.0530294 1.6757350 0.8579867 1.0206137 0.6351041 0.6280402 0.6621175 0.4072730"
    ),
    "Cb": (
        "0.0061986 0.3042715 1.2393092 2.1926633 3.8031044 5.2138110 6.5810651 8.1984593 9.7671683 10.8841632 11.7371042"
        " 12.9216391 13.1138398 13.2111500 13.2798275 13.2476407 12.5278117 12.5444005 12.1505523 11.8325447 11.8863586"
    ),
    "Cc": (
        "0.0955828 -0.0732739 0.1080507 -0.1016482 -0.0448187 0.1874983 0.8106022 1.2381303 1.8002298 1.9945247 2.0726982"
        " 2.7198924 3.7453615 4.1562686 4.9246444 5.4164522 5.9876369 5.9686811 6.6958644 6.7257772 7.2692138"
    ),
    "T": (
        "297.666361 316.256703 323.237324 326.125838 327.670456 331.956868 331.060428 331.312249 333.457676 332.591269"
        " 334.231367 334.054908 329.238290 328.422123 327.395935 323.269229 325.160592 326.664759 325.805259 324.455529"
        " 324.005723"
    ),
}
"""Concentrations in kmol/m^3 and temperature in K, every 1080 s."""


def semibatch() -> Model:
    """Start values and bounds as published."""

    def balances(x, u, p):
        first = p.k1 * ca.exp(-p.E1 / (GAS * x.T)) * x.Ca
        second = p.k2 * ca.exp(-p.E2 / (GAS * x.T)) * x.Cb
        return [
            Balance("A", "1", 1, "Ca", feed=u.F / x.V, first=-first),
            Balance("B", "1", 1, "Cb", first=first, second=-second),
            Balance("C", "1", 1, "Cc", second=second),
            Balance("volume", "1", 1, "V", feed=0.05 * u.F),
            Balance(
                "heat",
                "1",
                HEAT,
                "T",
                feed=0.05 * 3900.0 / 1000.0 * u.F / x.V * (300.0 - x.T),
                first=40000.0 * first,
                second=50000.0 * second,
                coolant=COOLING * (u.Tc - x.T),
            ),
        ]

    starts = {"Ca": 0.0, "Cb": 0.0, "Cc": 0.0, "V": 1.0, "T": 300.0}
    return Model(
        "semibatch",
        states=[State(name, "1", value) for name, value in starts.items()],
        inputs=[Input("F", "1"), Input("Tc", "1")],
        outputs=[Output(name, "1") for name in MEASURED],
        parameters=[
            Parameter("k1", "1", 14.0, (2.0, 100.0)),
            Parameter("k2", "1", 90.0, (2.0, 150.0)),
            Parameter("E1", "1", 27000.0, (25000.0, 40000.0)),
            Parameter("E2", "1", 45000.0, (35000.0, 50000.0)),
        ],
        balances=balances,
    )


def published_record() -> Experiment:
    """Feed for three hours, then none; the coolant at 320 K."""
    time = 1080.0 * np.arange(21)
    feed = np.where(time < 10800, 0.003, 0.0)
    outputs = {name: np.array(values.split(), dtype=float) for name, values in MEASURED.items()}
    return Experiment("exp1", time, {"F": feed, "Tc": np.full(21, 320.0)}, outputs)


# Noise of a simulated record: what a fit leaves of the published one.
NOISE = {"Ca": 0.2, "Cb": 0.2, "Cc": 0.2, "T": 1.0}


def simulated_record(seed: int) -> Experiment:
    """The published experiment from the constants behind it, by a solver that is not greybox's, with white noise."""
    published, rng = published_record(), np.random.default_rng([seed, 17])
    k1, k2, e1, e2 = TRUTH.values()

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b, _, volume, temperature = x
        feed = 0.003 if t < 10800 else 0.0
        first = k1 * np.exp(-e1 / (GAS * temperature)) * a
        second = k2 * np.exp(-e2 / (GAS * temperature)) * b
        heat = 0.05 * 3900.0 / 1000.0 * feed / volume * (300.0 - temperature)
        heat += 40000.0 * first + 50000.0 * second + COOLING * (320.0 - temperature)
        return [feed / volume - first, first - second, second, 0.05 * feed, heat / HEAT]

    # Not over the step of the feed.
    state, parts = [0.0, 0.0, 0.0, 1.0, 300.0], []
    for times in (published.time[:11], published.time[10:]):
        run = solve_ivp(rates, times[[0, -1]], state, "LSODA", times, rtol=1e-10, atol=1e-10)
        state = list(run.y[:, -1])
        parts.append(run.y[:, :-1] if not parts else run.y)
    y = np.hstack(parts)[[0, 1, 2, 4]]
    outputs = {name: row + NOISE[name] * rng.standard_normal(len(row)) for name, row in zip(MEASURED, y, strict=True)}
    return Experiment(f"simulated {seed}", published.time, published.inputs, outputs)
