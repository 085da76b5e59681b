"""From how many rows the initial state of a judged run is estimated: as many as determine it."""

import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, effect, fit, simulate
from greybox.estimation.score import score
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.validate import (
    FIRST_ROWS,
    _cut_to_first_rows,
    determine_initial_states,
    fit_first_rows,
    follow_records,
    validate,
)
from models.cascaded_tanks import cascaded_tanks

STEP = 5e-4


def linear_run(a, b, x, u, step=STEP):
    """States (N, nx) of ``x' = a x + b u`` with a held input, by the matrix exponential."""
    n = len(a)
    whole = expm(step * np.block([[a, b[:, None]], [np.zeros((1, n + 1))]]))
    rows = []
    for value in u:
        rows.append(x)
        x = whole[:n, :n] @ x + whole[:n, n] * value
    return np.array(rows)


# A drive on a spring, and behind it two slow states that only push: seconds beside milliseconds.
DRIVE = {"g": 50.0, "d": 20.0, "k": 400.0, "a": 300.0, "b": 2.0, "s": 2.0, "c": 5.0, "t": 1.0}
DRIVE_UNITS = ("m/(A*s^2)", "1/s", "1/s^2", "1/s", "1/s", "1/s", "m/(A*s^3)", "1/s")


def drive():
    def balances(x, u, p):
        return [
            Balance("position", "m/s", 1, "x", motion=x.v),
            Balance("force", "m/s^2", 1, "v", drive=p.g * x.i, drag=-p.d * x.v, spring=-p.k * x.x, load=x.w),
            Balance("current", "A/s", 1, "i", supply=p.a * u.u, loss=-p.a * x.i),
            Balance("slow", "m/s^3", 1, "w", fed=p.b * x.q, decay=-p.s * x.w),
            Balance("slower", "m/s^3", 1, "q", fed=p.c * u.u, decay=-p.t * x.q),
        ]

    states = [State("x", "m"), State("v", "m/s"), State("i", "A"), State("w", "m/s^2"), State("q", "m/s^2")]
    parameters = [Parameter(n, unit, v) for (n, v), unit in zip(DRIVE.items(), DRIVE_UNITS, strict=True)]
    return Model("drive", states, [Input("u", "A")], [Output("x", "m")], parameters, balances)


def drive_record(seed=0, rows=12000, noise=1e-4):
    rng = np.random.default_rng(seed)
    p = DRIVE
    u = np.repeat(rng.normal(size=rows // 200), 200)
    a = np.zeros((5, 5))
    a[0, 1] = 1.0
    a[1] = -p["k"], -p["d"], p["g"], 1.0, 0.0
    a[2, 2] = -p["a"]
    a[3, 3:] = -p["s"], p["b"]
    a[4, 4] = -p["t"]
    x = linear_run(a, np.array([0, 0, p["a"], 0, p["c"]]), np.array([0.02, 0.1, 0.3, 1.0, 2.0]), u)[:, 0]
    return Experiment.from_arrays(
        STEP * np.arange(rows), inputs={"u": u}, outputs={"x": x + noise * rng.normal(size=rows)}
    )


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_a_state_that_a_few_rows_do_not_show_is_estimated_from_more(noise):
    # 25 ms determine neither of the two slow states: from these the error is some thousand times the noise
    judged = validate(drive(), drive_record(noise=noise), noise={"x": noise})
    assert judged.misfit["x"].noise_ratio == pytest.approx(1.0, abs=0.05)


def test_a_run_that_is_sensitive_to_its_beginning_is_followed_into_the_record():
    # Two wells, only the speed measured: a state far off ends in the other well, and its slope shows no way back.
    def balances(x, u, p):
        return [
            Balance("position", "1/s", 1, "x", velocity=p.r * x.v),
            Balance("force", "1/s", 1, "v", damping=-p.b * x.v, spring=p.k * (x.x - x.x**3)),
        ]

    quantities = [Parameter("r", "1/s", 1.0), Parameter("b", "1/s", 0.2), Parameter("k", "1/s", 1.0)]
    wells = Model("wells", [State("x", "1", 1.7), State("v", "1", 0.2)], [], [Output("v", "1")], quantities, balances)
    time = np.linspace(0, 14, 201)

    def slope(_, z):
        return [z[1], -0.2 * z[1] + z[0] - z[0] ** 3]

    run = solve_ivp(slope, (0, 14), (-0.4, 1.1), "DOP853", time, rtol=1e-9, atol=1e-9).y[1]
    record = Experiment("two", time, {}, {"v": run + 0.007 * np.random.default_rng(2).normal(size=201)})
    judged = validate(wells, record, noise={"v": 0.007})
    assert judged.misfit["v"].noise_ratio == pytest.approx(1.0, abs=0.15)


def test_one_of_many_models_is_followed_with_its_constants_and_its_step():
    # its constants are free in the problem of the fit, and one is wrong by a fifth: it stays so
    record, model = drive_record(), drive().start(d=24.0)
    problem, options = prepare_problem(model, record, {"x": 1e-4}, FitOptions()), FitOptions(transcription="single")
    run, rows = follow_records(problem, options)
    alone = validate(model, record, noise={"x": 1e-4}, options=options)
    assert run.misfit["x"].rmse == pytest.approx(alone.misfit["x"].rmse, rel=0.02)
    assert run.misfit["x"].noise_ratio > 2 and rows[0] > FIRST_ROWS
    # from where it began it begins there again, from as many rows
    initial = replace(problem.variables.initial, guess=np.array([list(run.traces[0].initial_state.values())]))
    begun = replace(problem, variables=replace(problem.variables, initial=initial))
    again, same_rows = follow_records(begun, options, least=rows)
    assert same_rows == rows and again.misfit["x"].rmse == pytest.approx(run.misfit["x"].rmse, rel=1e-3)


def test_rows_that_were_asked_for_are_taken():
    judged = validate(drive(), drive_record(), noise={"x": 1e-4}, initial_rows=50)
    assert judged.misfit["x"].noise_ratio > 100


def first_order(rate):
    def balances(x, u, p):
        return [Balance("storage", "V/s", 1, "y", decay=-p.a * x.y, input=p.a * u.u)]

    return Model(
        "lag", [State("y", "V")], [Input("u", "V")], [Output("y", "V")], [Parameter("a", "1/s", rate)], balances
    )


def test_a_beginning_has_two_rows_for_each_state_at_least_and_no_more_than_there_are():
    problem = prepare_problem(drive(), drive_record(rows=200), {"x": 1e-4}, FitOptions())
    rows = [len(r.samples(r.y)) for n in (1, 30, 999) for r in _cut_to_first_rows(problem, [n]).records]
    assert rows == [2 * len(drive().states), 30, 200]


@pytest.mark.parametrize("rate", [1.0, 10.0, 200.0])
def test_the_rows_follow_from_the_time_constant(rate, monkeypatch):
    # y = exp(-a t): the rows up to t hold the share 1 - exp(-2 a t) of the information
    rows = 4000
    record = Experiment.from_arrays(
        STEP * np.arange(rows),
        inputs={"u": np.zeros(rows)},
        outputs={"y": np.exp(-rate * STEP * np.arange(rows))},
        allow_constant_input=True,
    )
    model = first_order(rate)
    problem = prepare_problem(model.fix("a"), record, {"y": 1e-3}, FitOptions())
    every = 1 - np.exp(-2 * rate * STEP * rows)
    half = -np.log(1 - 0.5 * every) / (2 * rate * STEP)
    taken: list[int] = []
    monkeypatch.setattr(
        sys.modules[validate.__module__],
        "fit_first_rows",
        lambda p, rows, o: taken.extend(rows) or fit_first_rows(p, rows, o),
    )
    determine_initial_states(problem, FitOptions())
    chosen = taken[-1]
    assert max(half, FIRST_ROWS) <= chosen <= max(2 * half + 1, FIRST_ROWS)


def test_one_free_run_has_one_error():
    rng = np.random.default_rng(3)
    rate, rows = 5.0, 3000
    records = []
    for _ in range(2):
        u = np.repeat(rng.normal(size=rows // 100), 100)
        y = linear_run(np.array([[-rate]]), np.array([rate]), np.array([1.0]), u)[:, 0]
        # what the model lacks is no noise
        y = y + 0.2 * y**2 + 1e-3 * rng.normal(size=rows)
        records.append(Experiment.from_arrays(STEP * np.arange(rows), inputs={"u": u}, outputs={"y": y}))
    found = fit(first_order(3.0), records[0], noise={"y": 1e-3}, validation=records[1])
    table = score(found, records[1], steps=(1,)).outputs["y"]
    assert table.rmse == found.validation.misfit["y"].rmse
    assert table.ahead[1] < table.rmse


def test_an_offset_that_an_initial_state_can_stand_for_is_not_determined() -> None:
    # F = K x + F0 with x free at the start: K x(0) + F0 is all that the record shows. Rounding made it a variance of -3e15.
    model = Model(
        "spring",
        states=[State("x", "mm")],
        inputs=[Input("v", "mm/s")],
        outputs=[Output("F", "N", lambda x, u, p: p.K * x.x + p.F0)],
        parameters=[Parameter("K", "N/mm", 2.0, (-10.0, 100.0)), Parameter("F0", "N", 5.0, (-1e3, 1e3))],
        balances=lambda x, u, p: [Balance("motion", "mm/s", 1, "x", v=u.v)],
    )
    time = 0.01 * np.arange(600)
    generator = np.random.default_rng(1)
    v = 40 * np.sin(5 * time) + 20 * np.sin(17 * time)
    force = 3.0 * np.cumsum(np.r_[0.0, v[:-1]]) * 0.01 + 200.0 + 10 * np.abs(v) ** 0.5 + generator.standard_normal(600)
    result = fit(model, Experiment("run", time, {"v": v}, {"F": force}))
    assert result.parameters["F0"].std is None and result.parameters["K"].std is not None
    assert (np.diag(result.uncertainty.covariance) > 0).all()


PLAY_TIME = 0.02 * np.arange(600)


def axis(rate, *loss, start=0.0):
    """A position that an input drives, with play."""
    return Model(
        "axis",
        [State("y", "V", start, role="displacement")],
        [Input("u", "V", role="drive")],
        [Output("y", "V")],
        [Parameter("k", "1/s", rate, (1e-3, 1e3))],
        lambda x, u, p: [Balance("position", "V/s", 1, "y", drive=p.k * u.u, **dict.fromkeys(loss, -p.k * x.y))],
    )


def play_record(model, seed, offset, **begin):
    u = offset + np.sin(0.5 * PLAY_TIME) ** 2 + 0.2 * np.sin(2 * PLAY_TIME)
    y = simulate(model, {"time": PLAY_TIME, "u": u}, initial=begin).outputs["y"]
    return Experiment(
        "r", PLAY_TIME, {"u": u}, {"y": y + 1e-3 * np.random.default_rng(seed).normal(size=len(PLAY_TIME))}
    )


@pytest.mark.parametrize("begins", [[3.6], [3.0], [2.5], [3.4, 2.7]])
def test_what_is_before_a_play_is_found_where_the_play_closes_late(begins):
    """From zero, or from the reading, it never closes: what is read has no slope there."""
    model = (axis(0.3) + effect("backlash")).start(gap=2.0)
    records = [play_record(model, seed, 0.0, y=y, w=1.7) for seed, y in enumerate(begins)]
    judged = validate(model, records, noise={"y": 1e-3})
    assert judged.misfit["y"].noise_ratio < 1.1
    assert [trace.initial_state["y"] for trace in judged.traces] == pytest.approx(begins, abs=0.01)
    found = fit(model.start(k=0.25, gap=1.9), records, noise={"y": 1e-3})
    assert found.misfit["y"].noise_ratio < 1.1


@pytest.mark.parametrize("begin", [1.5, 2.0, 3.0])
def test_an_input_behind_play_begins_anywhere_between_its_ends(begin):
    model = (axis(0.7, "loss") + effect("input_hysteresis")).start(h=1.5)
    record = play_record(model, 0, 2.0, y=1.7, w=begin)
    judged = validate(model, record, noise={"y": 1e-3})
    assert judged.misfit["y"].noise_ratio < 1.1
    assert judged.traces[0].initial_state["w"] == pytest.approx(begin, abs=0.01)
    assert fit(model.start(k=0.6, h=1.4), record, noise={"y": 1e-3}).misfit["y"].noise_ratio < 1.1


@pytest.mark.parametrize("start", [-2.0, 2.0])
def test_a_state_before_a_play_lies_within_it_about_its_reading_wherever_it_was_declared(start):
    model = (axis(0.3, start=start) + effect("backlash")).start(gap=2.0)
    record = play_record(model, 0, 0.0, y=3.0, w=1.7)
    placed = prepare_problem(model, [record], {"y": 1e-3}, FitOptions())
    assert placed.variables.initial.guess[0, 0] == pytest.approx(3.0, abs=0.05)


def test_a_told_state_keeps_its_guess_at_a_play():
    model = (axis(0.3) + effect("backlash")).start(gap=2.0)
    record = play_record(model, 0, 0.0, y=3.0, w=1.7)
    told = prepare_problem(model, [record], {"y": 1e-3}, FitOptions(), initial=[{"y": 0.5}])
    placed = prepare_problem(model, [record], {"y": 1e-3}, FitOptions())
    assert told.variables.initial.guess[0, 0] == 0.5
    assert placed.variables.initial.guess[0, 0] == pytest.approx(3.0, abs=0.05)
    assert prepare_problem(model, [record], {"y": 1e-3}, FitOptions(at_rest=True)).variables.initial.guess[0, 0] == 0


# Constants of two tanks that overflow, in V and s; the upper tank feeds the lower one by its outlet and by what it spills there.
TANKS = {"k1": 0.037, "k3": 0.043, "k4": 0.03, "edge": 7.5, "share": 0.78, "ko": 1.0}
LOWER_EDGE, LOWER_OVERFLOW = 10.0, 1.0


@cache
def tanks_record(seed, rows=512, step=4.0, noise=0.02):
    """Levels of two tanks by SciPy; the upper one begins at a third of what the model declares."""
    rng, p, inlet = np.random.default_rng(seed), TANKS, cascaded_tanks.values["k2"]
    u = np.repeat(rng.uniform(1, 6, rows // 8), 8)

    def rate(_, x, pump):
        upper, lower = np.maximum(x, 0.0)
        spill, loss = p["ko"] * max(upper - p["edge"], 0.0), LOWER_OVERFLOW * max(lower - LOWER_EDGE, 0.0)
        into = inlet * np.sqrt(upper) + p["share"] * spill * inlet / p["k1"]
        return [p["k4"] * pump - p["k1"] * np.sqrt(upper) - spill, into - p["k3"] * np.sqrt(lower) - loss]

    x = [np.array([5.0, 6.7])]
    for pump in u[:-1]:
        x.append(solve_ivp(rate, (0, step), x[-1], args=(pump,), rtol=1e-8, atol=1e-8).y[:, -1])
    y = np.array(x)[:, 1] + noise * rng.standard_normal(rows)
    return Experiment(name="tanks", time=step * np.arange(rows), inputs={"u": u}, outputs={"y": y})


@pytest.mark.crossed(3)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("other_starts", [0, 6])
def test_a_fit_that_begins_at_the_true_constants_ends_there(seed, other_starts):
    # The first, short part of the record lies between two edges, and leads to constants from which the rest cannot be run or is missed.
    model = cascaded_tanks + effect("upper_overflow") + effect("lower_overflow")
    lower = {"lower_overflow.edge": LOWER_EDGE, "lower_overflow.ko": LOWER_OVERFLOW}
    record = tanks_record(seed)
    found = fit(model.start(**TANKS, **lower), record, noise={"y": 0.02}, options=FitOptions(other_starts=other_starts))
    assert found.success
    assert found.misfit["y"].rmse < 1.05 * 0.02
    assert found.parameters["k3"].value == pytest.approx(TANKS["k3"], rel=0.1)
