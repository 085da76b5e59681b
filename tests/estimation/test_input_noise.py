"""The noise of measured inputs: what it adds to the intervals, what it takes from the constants, and when it is not counted."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lsim

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.estimation.findings import EstimationCode

STEP, ROWS, TAU, GAIN = 0.05, 1000, 0.5, 2.0
TIME = STEP * np.arange(ROWS)


def lag(*fixed: str, tau: float = TAU) -> Model:
    model = Model(
        "lag",
        states=[State("y", "V")],
        inputs=[Input("u", "V")],
        outputs=[Output("y", "V")],
        parameters=[Parameter("K", "1", 1.0, (1e-3, 1e3)), Parameter("tau", "s", tau, (1e-3, 1e3))],
        balances=lambda x, u, p: [Balance("lag", "V", p.tau, "y", drive=p.K * u.u, decay=-x.y)],
    )
    return model.fix(*fixed)


def sines(rng: np.random.Generator) -> np.ndarray:
    return np.sum([np.sin(2 * np.pi * f * TIME + rng.uniform(0, 6)) for f in (0.05, 0.17, 0.4, 0.9)], axis=0)


def answer(u: np.ndarray, tau: float = TAU) -> np.ndarray:
    return lsim(([[-1 / tau]], [[GAIN / tau]], [[1.0]], [[0.0]]), u, TIME, interp=True, X0=[0.0])[1]


def measure(level: float, seed: int, tau: float = TAU, acts: bool = False, noise: float = 0.02) -> Experiment:
    """A record whose input has ``level`` of noise, of the sensor or one that ``acts``, and its output ``noise``."""
    rng = np.random.default_rng(seed)
    u = sines(rng)
    seen = u + level * rng.normal(size=ROWS)
    y = answer(seen if acts else u, tau) + noise * rng.normal(size=ROWS)
    return Experiment.from_arrays(TIME, {"u": seen}, {"y": y}, hold="first")


def find(fit: gb.Fit, *codes: EstimationCode) -> list:
    return [f for f in fit.findings if f.code in codes]


def test_the_interval_and_the_bias_are_those_of_the_regression() -> None:
    level, noise = 0.5, 0.2
    record = measure(level, 1, noise=noise)
    fit = gb.fit(lag("tau"), record, noise={"y": noise}, options=gb.FitOptions(at_rest=True))
    # y = K G u with the answer G of the lag to straight pieces: K = f'y / f'f with f = G u.
    pulse = np.zeros(ROWS)
    pulse[1] = 1.0
    G = toeplitz(answer(pulse)[1:] / GAIN, np.zeros(ROWS - 1))
    f = G @ record.inputs["u"][1:]
    added, bias = GAIN * level * np.linalg.norm(G.T @ f) / (f @ f), -GAIN * level**2 * np.sum(G**2) / (f @ f)
    white = fit.misfit["y"].rmse / np.linalg.norm(f)
    (finding,) = find(fit, EstimationCode.INPUT_NOISE_BIASES)
    # Sixteen draws know a deviation within a quarter, and a residual that is coloured by it counts a part of it twice.
    assert fit.parameters["K"].std == pytest.approx(np.hypot(added, white), rel=0.5)
    assert finding.values["levels"]["u"][0] == pytest.approx(level, rel=0.15)
    before, after, _ = finding.values["changes"]["K"]
    assert before - after == pytest.approx(bias, rel=0.25)


def test_noise_that_acted_is_none_of_a_sensor() -> None:
    # A plant as fast as the sampling shows whether the fastest part of its input acted.
    for seed in range(4):
        acted = gb.fit(lag(tau=0.08), measure(0.05, seed, 0.08, acts=True))
        measured = gb.fit(lag(tau=0.08), measure(0.05, seed, 0.08))
        assert not find(acted, EstimationCode.INPUT_NOISE_COUNTED, EstimationCode.INPUT_NOISE_BIASES)
        assert find(measured, EstimationCode.INPUT_NOISE_COUNTED, EstimationCode.INPUT_NOISE_BIASES)
        assert measured.parameters["tau"].std > 1.5 * acted.parameters["tau"].std


def spring() -> Model:
    return Model(
        "spring",
        states=[State("x", "m"), State("v", "m/s")],
        inputs=[Input("F", "N")],
        outputs=[Output("x", "m")],
        parameters=[
            Parameter("m", "kg", 0.5, (1e-3, 1e3)),
            Parameter("b", "N*s/m", 1.0, (1e-3, 1e3)),
            Parameter("k", "N/m", 10.0, (1e-3, 1e4)),
        ],
        balances=lambda x, u, p: [
            Balance("position", "m/s", 1, "x", speed=x.v),
            Balance("force", "N", p.m, "v", drive=u.F, drag=-p.b * x.v, spring=-p.k * x.x),
        ],
    )


def vessel() -> Model:
    return Model(
        "vessel",
        states=[State("h", "m", 1.0, bounds=(0.01, 10.0))],
        inputs=[Input("q", "l/s")],
        outputs=[Output("h", "m")],
        parameters=[Parameter("A", "l/m", 80.0, (1.0, 1e4)), Parameter("c", "l/s/m", 3.0, (0.01, 100.0))],
        balances=lambda x, u, p: [Balance("volume", "l/s", p.A, "h", inflow=u.q, outflow=-p.c * x.h)],
    )


def room() -> Model:
    return Model(
        "room",
        states=[State("T", "K", 293.0)],
        inputs=[Input("Ta", "K"), Input("P", "W")],
        outputs=[Output("T", "K")],
        parameters=[Parameter("C", "J/K", 1e6, (1e4, 1e9)), Parameter("h", "W/K", 60.0, (1.0, 1e4))],
        balances=lambda x, u, p: [Balance("air", "W", p.C, "T", heater=u.P, loss=-p.h * (x.T - u.Ta))],
    )


# Model, truth, step, matrices A and B of its state, offset and amplitude of its inputs.
SMOOTH = {
    "lag": (lag(), {"K": 2.0, "tau": 0.5}, 0.05, [[-2.0]], [[4.0]], [(0.0, 1.0)]),
    "spring": (
        spring(),
        {"m": 0.8, "b": 1.6, "k": 20.0},
        0.02,
        [[0.0, 1.0], [-25.0, -2.0]],
        [[0.0], [1.25]],
        [(0.0, 5.0)],
    ),
    "vessel": (vessel(), {"A": 50.0, "c": 2.0}, 2.0, [[-0.04]], [[0.02]], [(3.0, 1.0)]),
    "room": (room(), {"C": 2e6, "h": 90.0}, 600.0, [[-4.5e-5]], [[4.5e-5, 5e-7]], [(280.0, 5.0), (1500.0, 700.0)]),
}


def measure_smooth(name: str, seed: int, level: float) -> tuple[Model, dict[str, float], Experiment]:
    """A record of smooth inputs that run on between rows, as ten times as many rows show it; ``level``: their noise over their movement."""
    model, truth, step, a, b, scales = SMOOTH[name]
    rng, rows, finer = np.random.default_rng([seed, len(name)]), 600, 10
    fine = np.arange(finer * (rows - 1) + 1) / finer
    u = []
    for offset, amplitude in scales:
        frequencies, phases = np.exp(rng.uniform(np.log(0.002), np.log(0.05), 6)), rng.uniform(0, 2 * np.pi, 6)
        waves = np.sin(2 * np.pi * np.outer(fine, frequencies) + phases).sum(axis=1)
        u.append(offset + amplitude * waves / waves.std())
    u = np.array(u).T
    start = np.linalg.solve(np.array(a), -np.array(b) @ u[0])
    _, y, _ = lsim((a, b, np.eye(len(a))[:1], np.zeros((1, len(scales)))), u, step * fine, interp=True, X0=start)
    u, y = u[::finer], np.ravel(y)[::finer]
    seen = u + level * u.std(axis=0) * rng.normal(size=u.shape)
    read = y + 0.02 * y.std() * rng.normal(size=rows)
    names = [i.name for i in model.inputs]
    output = {model.outputs[0].name: read}
    return model, truth, Experiment.from_arrays(step * np.arange(rows), dict(zip(names, seen.T, strict=True)), output)


def count_inside(records: int, level: float) -> tuple[int, int]:
    """Of the constants of fits by default options without a warning: those inside of their intervals, and all."""
    inside = counted = 0
    for name in SMOOTH:
        for seed in range(records):
            model, truth, record = measure_smooth(name, seed, level)
            fit = gb.fit(model, record)
            if any(f.severity != "note" for f in fit.findings):
                continue
            for constant, value in truth.items():
                low, high = fit.parameters[constant].interval
                inside += low <= value <= high
                counted += 1
    return inside, counted


@pytest.mark.rest
def test_intervals_of_a_few_records_with_noisy_smooth_inputs() -> None:
    inside, counted = count_inside(3, 0.01)
    assert counted > 15 and inside >= 0.8 * counted


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.0, 0.003, 0.01, 0.03])
def test_intervals_hold_the_truth_or_a_finding_stands_beside(level: float) -> None:
    inside, counted = count_inside(50, level)
    assert inside >= 0.9 * counted
