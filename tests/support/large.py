"""Problems larger than any rig's: many states, constants, terms, rows, records."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from greybox import Balance, Experiment, Fit, FitOptions, Input, Model, Output, Parameter, State, fit, read_csv

PERIOD = 1e-3
LAG = 0.05
NOISE = 1e-3


def rod(states: int) -> Model:
    """A rod of as many pieces, heated at one end; its temperature at the end of the first tenth is measured."""
    names = [f"T{k}" for k in range(states)]

    def balances(x, u, p):
        for k, name in enumerate(names):
            value = getattr(x, name)
            terms = {"left": p.G * ((u.heat if k == 0 else getattr(x, names[k - 1])) - value)}
            if k + 1 < states:
                terms["right"] = p.G * (getattr(x, names[k + 1]) - value)
            yield Balance(f"piece_{k}", "W", p.C, name, **terms)

    return Model(
        f"rod_{states}",
        [State(name, "K") for name in names],
        [Input("heat", "K")],
        [Output(names[states // 10], "K")],
        [Parameter("C", "J/K", 1.0, (0.1, 10.0), fixed=True), Parameter("G", "W/K", 150.0, (1.0, 1e4))],
        lambda x, u, p: list(balances(x, u, p)),
    )


def curve(constants: int, free: int) -> Model:
    """A lag driven by a curve of its input, of as many constants, the first of which are free and the others at their value."""
    heights = np.sin(6 * np.arange(constants) / constants)

    def drive(u, p):
        return sum(getattr(p, f"c{k}") * ca.exp(-(((u - k / constants) * constants) ** 2)) for k in range(constants))

    return Model(
        f"curve_{constants}",
        [State("x", "m")],
        [Input("u", "1")],
        [Output("x", "m")],
        [Parameter("T", "s", LAG, (1e-3, 10.0), fixed=True)]
        + [
            Parameter(f"c{k}", "m", 0.5 if k < free else float(heights[k]), (-10.0, 10.0), fixed=k >= free)
            for k in range(constants)
        ],
        lambda x, u, p: [Balance("lag", "m", p.T, "x", drive=drive(u.u, p), own=-x.x)],
    )


def long_sum(terms: int) -> Model:
    """A lag whose balance has as many terms."""

    def summands(u, p):
        return {f"drive_{k}": p.a * u.u * float(np.sin(k) / terms + 1 / terms) for k in range(terms)}

    return Model(
        f"sum_{terms}",
        [State("x", "m")],
        [Input("u", "m")],
        [Output("x", "m")],
        [Parameter("T", "s", LAG, (1e-3, 10.0)), Parameter("a", "1", 1.0, (1e-3, 1e3), fixed=True)],
        lambda x, u, p: [Balance("lag", "m", p.T, "x", **summands(u, p), own=-x.x)],
    )


def lag() -> Model:
    """A lag."""
    return Model(
        "lag",
        [State("x", "m")],
        [Input("u", "m")],
        [Output("x", "m")],
        [Parameter("T", "s", 0.1, (1e-3, 10.0))],
        lambda x, u, p: [Balance("lag", "m", p.T, "x", drive=u.u, own=-x.x)],
    )


def lag_signals(rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Input and answer (N,) of a lag of `LAG` with noise, from its own difference equation."""
    rng = np.random.default_rng(seed)
    drive = np.repeat(rng.normal(size=rows // 50 + 1), 50)[:rows]
    share = np.exp(-PERIOD / LAG)
    return drive, lfilter([0, 1 - share], [1, -share], drive) + NOISE * rng.normal(size=rows)


def lag_record(rows: int, seed: int) -> Experiment:
    """A record of these."""
    drive, answer = lag_signals(rows, seed)
    return Experiment(f"run {seed}", PERIOD * np.arange(rows), {"u": drive}, {"x": answer})


def write_lag_file(path: Path, rows: int) -> Path:
    """The same as a text file, as a logger writes it."""
    drive, answer = lag_signals(rows, 1)
    with open(path, "w") as file:
        file.write("time [s],u [m],x [m]\n")
        for first in range(0, rows, 100_000):
            last = min(first + 100_000, rows)
            file.write("".join(f"{k / 1000:.3f},{drive[k]:.5f},{answer[k]:.6f}\n" for k in range(first, last)))
    return path


def _simulate_rod(states: int, conductance: float, drive: np.ndarray) -> np.ndarray:
    """The temperature (N,) that is measured, for a heat capacity of one, from the matrix exponential."""
    rates = np.zeros((states + 1, states + 1))
    for k in range(states):
        rates[k, k] = -conductance * (2 if k + 1 < states else 1)
        rates[k, k - 1 if k else states] = conductance
        if k + 1 < states:
            rates[k, k + 1] = conductance
    step = expm(rates * PERIOD)[:states]
    x, course = np.zeros(states), []
    for value in drive:
        course.append(x[states // 10])
        x = step @ np.append(x, value)
    return np.array(course)


def _fit_rod(states: int) -> tuple[Fit, str, float]:
    rng, conductance = np.random.default_rng(1), 200.0
    drive = np.repeat(rng.normal(size=20), 20)
    answer = _simulate_rod(states, conductance, drive) + 1e-4 * rng.normal(size=len(drive))
    record = Experiment("rod", PERIOD * np.arange(len(drive)), {"heat": drive}, {f"T{states // 10}": answer})
    return fit(rod(states), record, options=FitOptions(at_rest=True)), "G", conductance


def _fit_curve(constants: int) -> tuple[Fit, str, float]:
    rng, k = np.random.default_rng(1), np.arange(constants)
    heights = np.sin(6 * k / constants)
    drive = rng.uniform(size=20 * constants)
    target = np.exp(-((np.subtract.outer(drive, k / constants) * constants) ** 2)) @ heights
    share = np.exp(-PERIOD / LAG)
    answer = lfilter([0, 1 - share], [1, -share], target) + 1e-4 * rng.normal(size=len(drive))
    record = Experiment("curve", PERIOD * np.arange(len(drive)), {"u": drive}, {"x": answer})
    return fit(curve(constants, constants // 10), record, options=FitOptions(at_rest=True)), "c7", float(heights[7])


def solve(task: str, size: str) -> tuple[float, float, float]:
    """A constant as it is estimated, as it is, and its standard deviation; of a task that only reads the rows, as they are."""
    if task == "read":
        rows = read_csv(size, lag()).rows
        return rows, rows, 1.0
    if task == "rows":
        estimate, name, truth = fit(lag(), read_csv(size, lag())), "T", LAG
    elif task == "records":
        estimate, name, truth = fit(lag(), [lag_record(200, k) for k in range(int(size))]), "T", LAG
    elif task == "long_sum":
        terms = int(size)
        gain = float(np.sum(np.sin(np.arange(terms)) / terms + 1 / terms))
        record = lag_record(2000, 1)
        scaled = Experiment("sum", record.time, {"u": record.inputs["u"] / gain}, record.outputs)
        estimate, name, truth = fit(long_sum(terms), scaled), "T", LAG
    else:
        estimate, name, truth = {"rod": _fit_rod, "curve": _fit_curve}[task](int(size))
    constant = estimate.parameters[name]
    return constant.value, truth, constant.std or np.inf
