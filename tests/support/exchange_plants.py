"""Plants with constants that may change places, and their runs in closed form."""

from __future__ import annotations

import casadi as ca
import numpy as np

from greybox import Balance, Experiment, Input, Model, Output, Parameter, State

TIME = 0.01 * np.arange(300)
STEP_AT, STEP, NOISE = 0.5, 10.0, 10.0


def positive(name: str, unit: str, value: float) -> Parameter:
    return Parameter(name, unit, value, (1e-3 * value, 1e3 * value))


def two_lags(**starts: float) -> Model:
    """A gain and two lags in a row, of which the second is measured."""
    values = {"k": 200.0, "tau1": 0.3, "tau2": 0.1, **starts}
    return Model(
        "two_lags",
        [State("v", "V"), State("w", "V")],
        [Input("u", "V")],
        [Output("w", "V")],
        [positive(name, "1" if name == "k" else "s", value) for name, value in values.items()],
        lambda x, u, p: [
            Balance("first", "V", p.tau1, "v", drive=p.k * u.u, decay=-x.v),
            Balance("second", "V", p.tau2, "w", feed=x.v, decay=-x.w),
        ],
    )


def two_lags_step(k: float, tau1: float, tau2: float, time: np.ndarray = TIME) -> np.ndarray:
    """Its response to a step at rest, also where both are equal: ``1 - (1 + s / tau) e^(-s / tau)``."""
    s = np.clip(time - STEP_AT, 0, None)
    mean, half = (tau1 + tau2) / 2, (tau1 - tau2) / 2
    if abs(half) < 1e-6 * mean:
        return k * STEP * (1 - (1 + s / mean) * np.exp(-s / mean))
    return k * STEP * (1 - (tau1 * np.exp(-s / tau1) - tau2 * np.exp(-s / tau2)) / (tau1 - tau2))


def two_lags_record(tau1: float, tau2: float, seed: int) -> Experiment:
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(TIME))
    u = np.where(TIME >= STEP_AT - 1e-9, STEP, 0.0)
    return Experiment("step", TIME, {"u": u}, {"w": two_lags_step(245.0, tau1, tau2) + noise})


def absorption(ka: float, ke: float, volume: float, *, depot_measured: bool = False) -> Model:
    """A dose of 4 that is absorbed from a depot and cleared from a volume: first-order both."""
    return Model(
        "absorption",
        [State("depot", "mg", 4.0), State("c", "mg/l", 0.0)],
        [],
        [Output("c", "mg/l"), *([Output("depot", "mg")] if depot_measured else [])],
        [positive("ka", "1/s", ka), positive("ke", "1/s", ke), positive("V", "l", volume)],
        lambda x, u, p: [
            Balance("gut", "mg/s", 1, "depot", absorbed=-p.ka * x.depot),
            Balance("blood", "mg/(l*s)", 1, "c", absorbed=p.ka * x.depot / p.V, cleared=-p.ke * x.c),
        ],
    )


def concentration(time: np.ndarray, ka: float, ke: float, volume: float) -> np.ndarray:
    """Bateman's function."""
    return 4 / volume * ka / (ka - ke) * (np.exp(-ke * time) - np.exp(-ka * time))


def three_lags(*taus: float) -> Model:
    names = ("tau1", "tau2", "tau3")
    return Model(
        "three_lags",
        [State(name, "V") for name in "abc"],
        [Input("u", "V")],
        [Output("c", "V")],
        [positive(name, "s", tau) for name, tau in zip(names, taus, strict=True)],
        lambda x, u, p: [
            Balance("A", "V", p.tau1, "a", drive=u.u, decay=-x.a),
            Balance("B", "V", p.tau2, "b", drive=x.a, decay=-x.b),
            Balance("C", "V", p.tau3, "c", drive=x.b, decay=-x.c),
        ],
    )


def parallel_lags(k1: float, tau1: float, k2: float, tau2: float) -> Model:
    parameters = [
        positive("k1", "1", k1),
        positive("tau1", "s", tau1),
        positive("k2", "1", k2),
        positive("tau2", "s", tau2),
    ]
    return Model(
        "parallel_lags",
        [State("a", "V"), State("b", "V")],
        [Input("u", "V")],
        [Output("y", "V", lambda x, u, p: x.a + x.b)],
        parameters,
        lambda x, u, p: [
            Balance("A", "V", p.tau1, "a", drive=p.k1 * u.u, decay=-x.a),
            Balance("B", "V", p.tau2, "b", drive=p.k2 * u.u, decay=-x.b),
        ],
    )


def softened_lags(tau1: float, tau2: float, gain: float) -> Model:
    """Two lags behind a sine of the input, which no transfer function tells, and a gain behind them that one of them divides."""
    return Model(
        "softened_lags",
        [State("a", "rad"), State("b", "rad*s")],
        [Input("u", "rad")],
        [Output("b", "rad*s")],
        [positive("tau1", "s", tau1), positive("tau2", "s", tau2), positive("g", "s", gain)],
        lambda x, u, p: [
            Balance("A", "rad", p.tau1, "a", drive=ca.sin(u.u), decay=-x.a),
            Balance("B", "rad", 1, "b", drive=x.a * p.g / p.tau2, decay=-x.b / p.tau2),
        ],
    )
