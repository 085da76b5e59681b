"""Many starts: the optimum that most of them find, and how many did."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.signal import lsim

import greybox as gb
from greybox import Balance, GreyboxError, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.base.values import Severity
from greybox.data.experiment import Experiment
from greybox.estimation.findings import EstimationCode
from greybox.estimation.fit import fit
from greybox.estimation.multistart import draw_starts, group_by_optimum, multistart, summarise_starts
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import DEFAULT_POLICY, FitOptions
from greybox.estimation.result_parts import StartResult
from greybox.estimation.starts import SearchTrouble, count_open_directions, find_trouble, stands_where_it_began
from greybox.estimation.transcription.problem import TranscriptionReason
from greybox.estimation.transcription.shooting_cost import Evaluation
from models.emps import emps
from models.micro_actuator import micro_actuator
from tests.oracles.independent import experiment, linear_record, multisine
from tests.support.explosive import explosive
from tests.support.findings import codes, find
from tests.support.first_order import rooney_biegler

REST = FitOptions(at_rest=True)


def start_results(*ratios):
    return [StartResult({}, {"a": 1.0} if np.isfinite(r) else {}, r, "converged") for r in ratios]


def test_starts_are_counted_by_the_optimum_that_they_reach():
    summary = summarise_starts(start_results(1.0, 1.001, 3.4, 1.0, 3.41, 9.0, np.inf))
    assert summary.values == {"counts": [3, 2, 1], "ratios": [1.0, 3.4, 9.0], "without_result": 1}
    assert [len(g) for g in group_by_optimum(start_results(1e-9, 1e-5, 0.5))] == [2, 1]  # data without noise


def test_random_starts_are_log_uniform_within_factor_and_bounds():
    model = micro_actuator.fix("M", "Ra").bound(K=(5000.0, 7000.0))
    starts = draw_starts(model, 2000, seed=1, factor=3.0)
    assert starts == draw_starts(model, 2000, seed=1, factor=3.0) != draw_starts(model, 2000, seed=2, factor=3.0)
    share = np.log([s["B"] / model.values["B"] for s in starts]) / np.log(3.0)
    assert np.histogram(share, 4, (-1, 1))[0] == pytest.approx(500, abs=80)
    assert all(5000 <= s["K"] <= 7000 for s in starts)
    with pytest.raises(ModelError, match="factor 1 of the random starts"):
        draw_starts(model, 3, factor=1.0)


@pytest.mark.parametrize("value", [-2.0, 0.0])
def test_constants_take_either_sign_where_bounds_allow_it_and_zero_stays_where_it_has_no_size(value):
    model = emps.bound(Fv=(-np.inf, np.inf)).start(Fv=value)
    drawn = [s["Fv"] for s in draw_starts(model, 50)]
    assert all(2 / 3 <= abs(v) <= 6 for v in drawn) if value else set(drawn) == {0.0}
    if value:
        assert all(v < 0 for v in drawn[::2]) and 5 < sum(v > 0 for v in drawn[1::2]) < 20
        below = draw_starts(emps.bound(Fv=(-np.inf, np.inf)).start(Fv=value).bound(Fv=(-1e5, 0.0)), 50)
        assert all(s["Fv"] < 0 for s in below)
    bounded = [s["Fv"] for s in draw_starts(emps.bound(Fv=(0.0, 1e5)).start(Fv=0.0).bound(Fv=(0.0, 8.0)), 50)]
    assert min(bounded) < 1 and max(bounded) > 7


def test_every_start_of_the_actuator_ends_at_the_optimum():
    truth = micro_actuator.fix("M", "Ra", "Kv")
    u = multisine(np.random.default_rng(4), 2500, 2.5e-4, 5, 800, 3.0)
    noise = {"x": 2e-7, "i": 5e-3}
    data = linear_record(truth, u, 2.5e-4, noise=noise)
    found = multistart(truth, data, starts=12, seed=2, noise=noise, options=REST, workers=1)
    assert found.best_optimum_count == len(found.start_results) == 12
    assert found.summary.values["counts"] == [12]
    assert found.best.findings[0] == found.summary and str(found.summary) in str(found)
    for q in truth.free_parameters:
        assert abs(found.best.parameters[q.name].value - q.value) < 4 * found.best.parameters[q.name].std


@pytest.mark.rest
def test_processes_find_what_one_process_finds():
    truth = micro_actuator.fix("M", "Ra", "Kv", "Kf")
    data = linear_record(
        truth, multisine(np.random.default_rng(4), 1000, 2.5e-4, 5, 800, 3.0), 2.5e-4, noise={"x": 2e-7, "i": 5e-3}
    )
    seen = []
    here, there = (
        multistart(truth, data, starts=4, options=REST, workers=w, report=lambda done, of: seen.append((done, of)))
        for w in (1, 2)
    )
    assert [e.values for e in here.start_results] == [e.values for e in there.start_results]
    assert here.best.model.values == there.best.model.values
    assert seen == [(k, 4) for k in range(1, 5)] * 2


def test_a_model_that_can_be_simulated_from_no_start_says_so():
    t = np.arange(100) * 0.1
    model = explosive()
    data = experiment(model, t, np.ones((100, 1)), np.cos(t)[:, None])
    # The model's own start is searched from as a fit does, which tries others far off; three such draws do not reach that far.
    options = replace(REST, other_starts=0)
    with pytest.raises(GreyboxError, match="none of 3 starts has a result"):
        multistart(model, data, starts=3, options=options, workers=1)


TIME = 0.05 * np.arange(200)


def growth(y):
    """A record of Rooney and Biegler's curve, or of what is not."""
    return Experiment("growth", TIME, {"u": np.zeros(200)}, {"y": y})


def noise(seed=0):
    return 0.05 * np.random.default_rng(seed).normal(size=200)


@pytest.mark.parametrize("known", [{"y": 0.05}, None], ids=["noise given", "noise not given"])
def test_where_the_first_start_explains_nothing_others_are_tried_by_themselves(known):
    """At a rate of 1000/s the curve is a jump, and no slope leads back from it."""
    record, far = growth(15 * (1 - np.exp(-0.5 * TIME)) + noise()), rooney_biegler(asymptote=1.0, rate=1000.0)
    alone = fit(far, record, noise=known, options=FitOptions(at_rest=True, other_starts=0))
    assert alone.misfit["y"].best_fit_percent < 5 and find(alone.findings, EstimationCode.NO_START_HELPS)
    found = fit(far, record, noise=known, options=REST)
    assert found.parameters["asymptote"].value == pytest.approx(15.0, rel=0.01)
    assert found.parameters["rate"].value == pytest.approx(0.5, rel=0.01)
    told = find(found.findings, EstimationCode.OTHER_START_TAKEN)
    # At noise that is told nothing is left to find.
    assert told.values["searched"] == (1 if known else 6) == len(found.starts) - 1
    assert told.values["after"]["y"] == found.misfit["y"].best_fit_percent
    assert [s.noise_ratio for s in found.starts] == sorted(s.noise_ratio for s in found.starts)
    again = fit(far, record, noise=known, options=REST)
    assert again.model.values == found.model.values  # the draws are seeded


def test_where_no_start_helps_a_warning_says_so():
    record = growth(np.sin(3 * TIME) + noise())
    found = fit(rooney_biegler(), record, noise={"y": 0.05}, options=REST)
    told = find(found.findings, EstimationCode.NO_START_HELPS)
    assert told.severity is Severity.WARNING and told.values["searched"] == 12
    assert told.values["best_fit"] == {"y": found.misfit["y"].best_fit_percent}


HOUR = 3600.0


def reactions(first, second=1e-6):
    """c decays with the rate ``first`` into d, which decays with the rate ``second``; both far from what hours show."""
    return Model(
        "decay",
        [State("c", "g", 1.0), State("d", "g", 0.0)],
        [],
        [Output("c", "g"), Output("d", "g")],
        [Parameter("k", "1/h", first, (1e-8, 1e2)), Parameter("l", "1/h", second, (1e-8, 1e2))],
        lambda x, u, p: [
            Balance("c", "g/h", 1, "c", reaction=-p.k * x.c),
            Balance("d", "g/h", 1, "d", reaction=p.k * x.c, loss=-p.l * x.d),
        ],
    )


def reactions_record(hours, spread):
    """Of rates of 0.7/h and 0.05/h; ``spread`` is the noise of each row."""
    rng = np.random.default_rng(0)
    c = np.exp(-0.7 * hours)
    d = 0.7 / (0.05 - 0.7) * (np.exp(-0.7 * hours) - np.exp(-0.05 * hours))
    readings = {"c": c + spread * rng.normal(size=len(hours)), "d": d + spread * rng.normal(size=len(hours))}
    return Experiment("reactions", hours * HOUR, {}, readings, noise={"c": spread, "d": spread})


SIX_ROWS = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 8.0])


@pytest.mark.crossed(3)
@pytest.mark.parametrize("second", [1e-6, 90.0])
@pytest.mark.parametrize("first", [1e-8, 1e-6, 1e-3, 90.0])
def test_constants_far_from_the_scales_of_the_record_are_drawn_where_it_shows_them(first, second):
    record = reactions_record(SIX_ROWS, np.full(6, 0.01))
    found = fit(reactions(first, second), record, options=REST)
    assert found.model.values["k"] == pytest.approx(0.7, rel=0.1)
    assert found.model.values["l"] == pytest.approx(0.05, rel=0.2)
    assert EstimationCode.NO_START_HELPS not in codes(found.findings)


def test_other_starts_are_tried_where_one_of_the_outputs_is_not_explained():
    """The search runs to both bounds, where c has fallen before its second row: that is a third of what c does, and nothing of d."""
    record = reactions_record(np.arange(8.0), np.linspace(0.002, 0.05, 8))
    alone = fit(reactions(1e-3), record, options=replace(REST, other_starts=0))
    assert alone.misfit["c"].best_fit_percent > 30 and alone.misfit["d"].best_fit_percent < 0
    told = find(alone.findings, EstimationCode.NO_START_HELPS)
    assert told.values["best_fit"] == {"d": alone.misfit["d"].best_fit_percent}
    # The best fit is told as it is, below zero as well.
    unfollowed = find(alone.findings, EstimationCode.MODEL_DOES_NOT_FOLLOW).values["best_fit"]
    assert unfollowed == {name: alone.misfit[name].best_fit_percent for name in "cd"}
    found = fit(reactions(1e-3), record, options=REST)
    assert found.model.values["k"] == pytest.approx(0.7, rel=0.1)
    assert find(found.findings, EstimationCode.OTHER_START_TAKEN).values["before"] == told.values["best_fit"]


def test_several_starts_that_explain_nothing_are_no_worse_than_one():
    record = reactions_record(SIX_ROWS, np.full(6, 0.01))
    one = fit(reactions(1e-3), record, options=REST)
    several = multistart(reactions(1e-3), record, starts=3, options=REST, workers=1)
    assert several.best.solver.cost == pytest.approx(one.solver.cost, rel=1e-6)
    # The model's own start is the fit itself, with the others that this tries; the two drawn ones did not end at the best optimum.
    counts, ratios = several.summary.values["counts"], several.summary.values["ratios"]
    assert sum(counts) == len(several.start_results) == 3 and counts[0] < 3
    assert ratios[0] == pytest.approx(np.sqrt(one.solver.cost / 12), rel=0.01)


def test_a_start_that_finds_the_way_tries_no_other():
    found = fit(rooney_biegler(rate=5.0), growth(15 * (1 - np.exp(-0.5 * TIME)) + noise()), options=REST)
    assert found.starts == ()
    assert not codes(found.findings) & {EstimationCode.OTHER_START_TAKEN, EstimationCode.NO_START_HELPS}


def two_exponentials(**starts):
    """y = a exp(-p x) + b exp(-q x), of an input x."""
    return Model(
        "two",
        [State("s", "1")],  # a model has a state: this one rests, and nothing depends on it
        [Input("x", "1")],
        [Output("y", "1", lambda x, u, p: p.a * ca.exp(-p.p * u.x) + p.b * ca.exp(-p.q * u.x))],
        [Parameter(name, "1", value) for name, value in starts.items()],
        lambda x, u, p: [Balance("rest", "1", 1, "s", decay=-x.s)],
    )


def two_exponentials_record():
    x = np.linspace(0, 10, 60)
    y = 2 * np.exp(-1.5 * x) + np.exp(-0.2 * x) + 0.01 * np.random.default_rng(0).normal(size=60)
    return Experiment("r", np.arange(60.0), {"x": x}, {"y": y})


LOST = {EstimationCode.DIRECTION_UNDETERMINED, EstimationCode.PARAMETER_UNDETERMINED}


@pytest.mark.parametrize("rates", [(60.0, 80.0), (100.0, 150.0)])
def test_a_search_that_lost_constants_on_its_way_is_begun_elsewhere(rates):
    """A rate whose term has left the record before its second row has no slope any more."""
    model = two_exponentials(a=1.0, p=rates[0], b=1.0, q=rates[1])
    alone = fit(model, two_exponentials_record(), options=replace(REST, other_starts=0))
    assert alone.misfit["y"].rmse > 0.1 and codes(alone.findings) & LOST
    found = fit(model, two_exponentials_record(), options=REST)
    assert found.misfit["y"].rmse < 0.011 and len(found.starts) == 7
    assert sorted(found.model.values[name] for name in "pq") == pytest.approx([0.2, 1.5], rel=0.1)
    taken = find(found.findings, EstimationCode.OTHER_START_TAKEN)
    assert taken.values["trouble"] == SearchTrouble.LOST_CONSTANTS and "change nothing" in str(taken)


def test_equal_rates_end_as_two():
    """Of equal rates both terms stay one, unless rounding parts them on the way: which of these it is the machine decides."""
    found = fit(two_exponentials(a=1.0, p=1.0, b=1.0, q=1.0), two_exponentials_record(), options=REST)
    assert found.misfit["y"].rmse < 0.011 and len(found.starts) in (0, 7)
    assert sorted(found.model.values[name] for name in "pq") == pytest.approx([0.2, 1.5], rel=0.1)


def test_a_rate_that_ran_away_is_searched_for_elsewhere():
    """Two lags in a row of rates 2 and 0.1 in pulses; from this start the fast one grows without end, and leaves a single lag behind."""
    rates = {"k": 1000.0, "fast": 2.0, "slow": 0.1}
    lags = Model(
        "lags",
        [State("a", "1"), State("b", "1")],
        [Input("u", "1")],
        [Output("b", "1")],
        [Parameter(name, "1", value, (0.0, np.inf)) for name, value in rates.items()],
        lambda x, u, p: [
            Balance("first", "1", 1, "a", drive=p.k * u.u, loss=-p.fast * x.a),
            Balance("second", "1", 1, "b", gain=p.fast * x.a, loss=-p.slow * x.b),
        ],
    )
    t = np.linspace(0, 60, 121)
    u = np.where(t % 20 < 8, 1.0, 0.0)
    held = lsim(([rates["k"] * rates["fast"]], np.polymul([1, rates["fast"]], [1, rates["slow"]])), u, t, interp=False)[
        1
    ]
    y = held + 0.02 * np.ptp(held) * np.random.default_rng(0).normal(size=len(t))
    begun = lags.start(k=114.0, fast=3.2, slow=1.2)
    record, known = Experiment("r", t, {"u": u}, {"b": y}), {"b": 0.02 * np.ptp(held)}
    alone = fit(begun, record, noise=known, options=replace(REST, other_starts=0))
    assert alone.model.values["fast"] > 1e3
    found = fit(begun, record, noise=known, options=REST)
    assert found.model.values["fast"] == pytest.approx(2.0, rel=0.2)
    assert find(found.findings, EstimationCode.OTHER_START_TAKEN).values["trouble"] == SearchTrouble.LOST_CONSTANTS


def test_constants_that_no_record_tells_apart_are_not_lost():
    model = Model(
        "product",
        [State("s", "1")],
        [Input("x", "1")],
        [Output("y", "1", lambda x, u, p: p.a * p.b * u.x)],
        [Parameter(name, "1", 1.0) for name in "ab"],
        lambda x, u, p: [Balance("rest", "1", 1, "s", decay=-x.s)],
    )
    x = np.linspace(0, 10, 60)
    record = Experiment("r", np.arange(60.0), {"x": x}, {"y": 0.5 * x + 0.2 * np.sin(3 * x)})
    found = fit(model, record, options=REST)
    assert EstimationCode.DIRECTION_UNDETERMINED in codes(found.findings)
    assert found.starts == ()


def test_a_run_that_goes_far_astray_elsewhere_does_not_show_what_is_lost_here():
    """Of a constant that begins at 1e-5 a thousand times that changes nothing; thirty times the growth would show it beside the noise, and
    not beside the errors of such a run.
    """
    model = Model(
        "growth",
        [State("x", "1", 1.0)],
        [Input("s", "1")],
        [Output("y", "1", lambda x, u, p: x.x * (1 + p.bend * u.s**2))],
        [Parameter("rate", "1/s", 0.5), Parameter("bend", "1", 1e-5)],
        lambda x, u, p: [Balance("growth", "1/s", 1, "x", more=p.rate * x.x)],
    )
    t, s = np.linspace(0, 1, 60), np.cos(np.linspace(0, 5, 60))
    record = Experiment("r", t, {"s": s}, {"y": np.exp(t) * (1 + 0.3 * s**2) + 0.1 * np.sin(20 * t)})
    found = fit(model, record, noise={"y": 0.01}, options=REST)
    assert EstimationCode.MISFIT_ABOVE_NOISE in codes(found.findings)
    assert found.model.values["bend"] == pytest.approx(0.3, rel=0.2)
    assert found.starts == ()


def test_what_arcs_do_not_show_is_not_held_against_free_runs():
    """A drift from 1e-5/s on changes nothing within half a second, where each arc has a first state of its own, and much within twenty."""
    model = Model(
        "drifting",
        [State("x", "1"), State("z", "1")],
        [Input("u", "1")],
        [Output("y", "1", lambda x, u, p: x.x + x.z)],
        [Parameter("k", "1/s", 1.1), Parameter("drift", "1/s", 1e-5)],
        lambda x, u, p: [
            Balance("lag", "1/s", 1, "x", drive=p.k * u.u, loss=-p.k * x.x),
            Balance("drift", "1/s", 1, "z", drift=p.drift),
        ],
    )
    t = np.linspace(0, 20, 401)
    u = np.sign(np.sin(0.9 * t))
    y = lsim(([1.0], [1.0, 1.0]), u, t, interp=False)[1] + 1e-5 * t + 0.05 * np.sin(23 * t)
    y += 0.01 * np.random.default_rng(0).normal(size=len(t))
    found = fit(
        model, Experiment("r", t, {"u": u}, {"y": y}, "zero"), noise={"y": 0.01}, options=FitOptions(arc_length=0.5)
    )
    assert EstimationCode.MISFIT_ABOVE_NOISE in codes(found.findings)
    assert found.starts == ()


def test_records_of_nothing_but_noise_are_told_and_not_searched():
    found = fit(rooney_biegler(), growth(noise()), noise={"y": 0.05}, options=REST)
    assert found.starts == ()
    assert EstimationCode.NOTHING_TO_EXPLAIN in codes(found.findings)


@pytest.mark.parametrize(
    ("status", "end", "stands"),
    [
        (TerminationStatus.STUCK, 0.5, True),
        (TerminationStatus.STUCK, 0.6, False),
        (TerminationStatus.CONVERGED, 0.5, False),
    ],
)
def test_a_search_that_got_stuck_where_it_began_is_known(status, end, stands):
    begin = rooney_biegler(rate=0.5)
    optimum = SimpleNamespace(model=begin, fitted_model=begin.start(rate=end), status=status, policy=DEFAULT_POLICY)
    assert stands_where_it_began(optimum) is stands


STEPS = np.repeat(np.random.default_rng(5).choice([-8.0, -4.0, 0.0, 3.0, 9.0], 30), 10)


def lag_model():
    return Model(
        "lag",
        [State("w", "rpm")],
        [Input("U", "V")],
        [Output("w", "rpm")],
        [Parameter("tau", "s", 0.2, (1e-3, 100.0)), Parameter("k", "rpm/V", 200.0, (1.0, 1e4))],
        lambda x, u, p: [Balance("speed", "rpm", p.tau, "w", drive=p.k * u.U, decay=-x.w)],
    )


@pytest.mark.rest
@pytest.mark.parametrize(
    "effects",
    [
        pytest.param({"drive_lag": {"tau_u": 0.07}}, marks=pytest.mark.slow),
        pytest.param({"sensor_lag": {"tau_s": 0.06}}, marks=pytest.mark.slow),
        {"input_offset": {"u0": 0.8}},
        pytest.param({"input_dead_zone": {"d": 1.2}, "drive_lag": {"tau_u": 0.05}}, marks=pytest.mark.slow),
        {"gain_by_sign": {"g": -0.2}, "sensor_lag": {"tau_s": 0.05}},
    ],
    ids="+".join,
)
def test_several_starts_of_a_model_with_effects_are_never_worse_than_one(effects):
    """Constants of an effect that changes nothing yet have no slope: a start drawn about their neutral value stays there."""
    model, time = lag_model(), 0.01 * np.arange(300)
    for name in effects:
        model = model + gb.effect(name)
    truth = {"tau": 0.25, "k": 240.0} | {k: v for values in effects.values() for k, v in values.items()}
    run = gb.simulate(model.start(**truth), {"time": time, "U": STEPS}).outputs["w"]
    record = Experiment("r", time, {"U": STEPS}, {"w": run + 0.5 * np.random.default_rng(3).normal(size=300)})
    one = fit(model, record)
    several = multistart(model, record, starts=3, workers=1)
    assert several.best.misfit["w"].rmse <= 1.005 * one.misfit["w"].rmse
    assert several.start_results[0].noise_ratio <= several.start_results[-1].noise_ratio


def test_a_start_that_did_not_move_a_constant_is_no_agreement():
    ended = [StartResult({"a": a, "b": b}, {"a": 2.0, "b": b}, 1.0, "converged") for a, b in ((1, 1), (3, 2), (2, 1))]
    summary = summarise_starts(ended)
    assert summary.values["counts"] == [3] and summary.values["unmoved"] == {"b": 1}
    assert "1 of the first did not move b and say nothing of it" in str(summary)


def polarity(name, value, balance, bounds=(-30.0, 30.0)):
    """A model of plain numbers with one constant of unknown sign."""
    return Model(
        name,
        [State("x", "1"), State("v", "1")],
        [Input("u", "1")],
        [Output("x", "1")],
        [Parameter("c", "1", value, bounds)],
        lambda x, u, p: [Balance("a", "1", 1, "x", v=x.v), Balance("b", "1", 1, "v", **balance(x, u, p))],
    )


@pytest.mark.parametrize(
    ("name", "truth", "balance"),
    [
        ("gain", -6.0, lambda x, u, p: {"drive": p.c * u.u, "drag": -3.0 * x.v, "spring": -20.0 * x.x}),
        ("stiffness", -9.0, lambda x, u, p: {"spring": p.c * x.x, "drag": -1.0 * x.v, "drive": u.u}),
        ("feedback", -12.0, lambda x, u, p: {"loop": p.c * x.v, "drive": u.u}),
    ],
)
def test_a_start_of_the_wrong_sign_is_left_where_bounds_allow_it(name, truth, balance):
    model = polarity(name, 1.0, balance)
    time = 0.02 * np.arange(400)
    u = np.random.default_rng(2).normal(size=400)
    run = gb.simulate(model.start(c=truth), {"time": time, "u": u}).outputs["x"]
    record = Experiment("r", time, {"u": u}, {"x": run + 1e-4 * np.random.default_rng(3).normal(size=400)})
    found = fit(model, record, options=REST)
    assert found.success and found.model.values["c"] == pytest.approx(truth, rel=0.02)


def test_a_direction_is_open_where_its_step_changes_the_cost_by_less_than_the_variance_or_than_rounding():
    """A cost of 2 of 200 residuals, whose variance is 0.01; d'Hd / 2 of steps of one: 4, 0.005 and 1e-9."""
    hessian = 2 * np.diag([4.0, 0.005, 1e-9])
    evaluation = Evaluation(2.0, np.zeros(3), hessian, np.array([2.0]), np.array([200]))
    variables = SimpleNamespace(which=np.arange(3), spans=np.ones(3))

    def count(step, rounding=0.0):
        return count_open_directions(variables, evaluation, np.array(step), rounding)

    assert [count([1.0, 1.0, 1.0]), count([1.0, 2.0, 1.0]), count([0.01, 2.0, 1e4])] == [2, 1, 1]
    # Of the largest of them, 0.02 / 4 = 0.005.
    assert [count([1.0, 2.0, 1e4], rounding) for rounding in (0.004, 0.006)] == [0, 1]


@pytest.mark.parametrize(
    ("reason", "adaptive", "level", "rmse", "trouble"),
    [
        (TranscriptionReason.UNSTABLE, True, True, 2.0, SearchTrouble.ANOTHER_COURSE),
        (TranscriptionReason.FREE_RUN_FOLLOWS, True, True, 2.0, SearchTrouble.ANOTHER_COURSE),
        (TranscriptionReason.STABLE, True, True, 2.0, None),
        (TranscriptionReason.UNSTABLE, False, True, 2.0, None),
        (TranscriptionReason.UNSTABLE, True, False, 2.0, None),
        (TranscriptionReason.UNSTABLE, True, True, 1.0, None),
    ],
)
def test_an_unstable_stiff_run_above_a_known_noise_may_follow_another_course(
    monkeypatch, reason, adaptive, level, rmse, trouble
):
    monkeypatch.setattr("greybox.estimation.starts.is_at_noise", lambda _: rmse <= 1.0)
    problem = SimpleNamespace(
        step=SimpleNamespace(adaptive=adaptive or None), noise=SimpleNamespace(is_level_known=level)
    )
    unmoved = SimpleNamespace(values={}, free_parameters=())
    ended = SimpleNamespace(
        evaluation=SimpleNamespace(cost=1.0),
        model=unmoved,
        fitted_model=unmoved,
        misfit={},
        status=TerminationStatus.CONVERGED,
        solution=SimpleNamespace(strategy=SimpleNamespace(values={"reason": reason}), problem=problem),
    )
    assert find_trouble(ended, problem, looks_elsewhere=False) is trouble
