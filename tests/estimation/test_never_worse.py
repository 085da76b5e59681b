"""A fit never ends worse than it began: plants, ways of solving, methods and starts, compared at one noise by runs as fine as it takes."""

from __future__ import annotations

import signal
import sys
import time
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fits.studies.published_networks import NETWORKS
from fits.studies.stiff_problems import PROBLEMS, StiffProblem
from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, effect, fit, simulate
from greybox.base.errors import ModelError
from greybox.data.noise import NoiseSource
from greybox.estimation.findings import EstimationCode
from greybox.estimation.noise_loop import compute_cost as compute_start_cost
from greybox.estimation.noise_loop import keep_best, solve
from greybox.estimation.optim.gauss_newton import run_gradient_sampling
from greybox.estimation.optim.minimisation import (
    DEFAULT_POLICY,
    GradientSamplingPolicy,
    Minimisation,
    TerminationStatus,
)
from greybox.estimation.optim.quadratic_model import QuadraticModel
from greybox.estimation.starts import SearchTrouble, draw_starts
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import Completion, TranscriptionReason
from greybox.estimation.transcription.single_shooting import solve_single_shooting
from tests.oracles.independent import multisine, solved_record
from tests.support.oscillator import oscillator

NOISE = 1e-3


def driven(*constants, rows=200, period=0.02):
    model = oscillator("driven", *constants)
    u = multisine(np.random.default_rng(0), rows, period, 0.05, 1.5, 3.0)
    return model, solved_record(model, u, np.arange(rows) * period, [0.0, 0.0], {"x": NOISE})


def delayed_lag():
    """A lag whose input comes 25 whole rows late, where the slope along the delay has a kink; its two periods begin at rest."""
    lag = Model(
        "lag",
        [State("x", "1")],
        [Input("u", "1")],
        [Output("x", "1")],
        [Parameter("k", "1/s", 2.0), Parameter("a", "1/s", 1.0)],
        lambda x, u, p: [Balance("x", "1/s", 1.0, "x", drive=p.k * u.u, loss=-p.a * x.x)],
    )
    model = (lag + effect("transport_delay")).bound(delay=(0.0, 2.0)).start(delay=0.5)
    t = 0.02 * np.arange(400)
    blank = Experiment("blank", t, {"u": np.where(t % 3 < 1.5, 1.0, 0.2)}, {}, "zero", before={"u": np.array([0.0])})
    y = simulate(model, blank).outputs["x"] + NOISE * np.random.default_rng(0).normal(size=len(t))
    return model, Experiment("delayed", t, blank.inputs, {"x": y}, "zero", before={"u": np.array([0.0])})


def stiff(name):
    return PROBLEMS[name].model(), PROBLEMS[name].record()


PLANTS = {
    "hardening": lambda: driven(0.3, 4.0, 6.0, 2.0),
    "two wells": lambda: driven(0.3, -4.0, 6.0, 2.0, rows=120, period=0.05),
    "falling": lambda: driven(0.3, -4.0, 0.01, 2.0, rows=120),
    "delayed lag": delayed_lag,
    **{name: (lambda name=name: stiff(name)) for name in ("Robertson", "HIRES", "enzyme cascade", "Oregonator")},
}
# An independent run of this one takes seconds.
QUICK = [pytest.param(name, marks=pytest.mark.slow) if name == "Oregonator" else name for name in PLANTS]
TRANSCRIPTIONS = ("automatic", "single", "multiple", "collocation-radau")
METHODS = ("automatic", "rk4", "midpoint", "radau", "esdirk")
WAYS = [(t, m) for t, m in product(TRANSCRIPTIONS, METHODS) if not t.startswith("collocation") or m == "automatic"]
# What the steps of a fit may leave in its cost.
INTEGRATION = 1e-3


def compute_cost(model, record, std):
    """Squared errors over the noise of a run whose steps are as short as it takes."""
    run = simulate(model, record).outputs
    with np.errstate(over="ignore", invalid="ignore"):
        errors = [((y - run[n]) / std[n])[np.isfinite(y)] for n, y in record.outputs.items()]
    # A run that ends on its way has no cost: nothing is as good.
    return sum(float(np.sum(e**2)) if np.isfinite(e).all() else np.inf for e in errors)


def check_no_worse(model, record, **options):
    """The fit, whose cost is no higher than that of the run of its start, under the noise that it ended with."""
    found = fit(model, record, options=FitOptions(at_rest=True, other_starts=0, **options))
    began, ended = (compute_cost(m, record, found.noise.std) for m in (model, found.model))
    # Of segments of an unstable plant a free run need not follow: theirs is the cost that the fit has.
    ended = ended if np.isfinite(ended) else found.solver.cost
    assert not ended > began * (1 + INTEGRATION), (began, ended, found.status)
    return found


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize("name", QUICK)
def test_a_fit_begun_at_the_true_constants_stays_as_good(name):
    check_no_worse(*PLANTS[name]())


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS, ids="-".join)
@pytest.mark.parametrize("name", PLANTS)
def test_no_way_of_solving_ends_worse_than_it_began(name, way):
    model, record = PLANTS[name]()
    for start in [{}, *draw_starts(model, 4, seed=0, factor=3.0)]:
        try:
            check_no_worse(model.start(**start), record, transcription=way[0], method=way[1])
        except ModelError:
            # A way that does not take such a model says so before any work.
            assert (name, way[0]) == ("delayed lag", "collocation-radau") or (name, way[1]) == ("delayed lag", "esdirk")


def test_segments_that_led_astray_give_way_to_the_run_of_the_start(monkeypatch):
    """A solution is made worse by hand; its status says that it failed, as one at its iteration limit does."""
    model, record = driven(0.3, 4.0, 6.0, 2.0)
    options = FitOptions(at_rest=True, transcription="multiple")
    problem = prepare_problem(model, record, {"x": NOISE}, options)
    found = solve(problem, options)
    astray = problem.variables.start_at({"k": 400.0})
    failed = replace(
        found,
        status=TerminationStatus.ITERATION_LIMIT,
        variables=astray,
        evaluation=problem.shooting(astray).evaluate(astray.here),
    )
    kept = keep_best(failed, problem.variables, options)
    assert kept.status.success
    assert kept.strategy.values["completion"] == Completion.WENT_ON
    assert kept.evaluation.cost == pytest.approx(found.evaluation.cost, rel=1e-6)
    # The better of the two is gone on from: here the end, which is nearer than the start.
    searched = []

    def note(problem, options, report):
        searched.append(problem.variables)
        return solve_single_shooting(problem, options, report)

    monkeypatch.setattr(sys.modules["greybox.estimation.noise_loop"], "solve_single_shooting", note)
    keep_best(failed, problem.variables.start_at({"k": 4000.0}), options)
    assert searched == [astray]
    # After Ctrl-C the better point is handed out, and nothing is searched any more.
    stopped = keep_best(replace(failed, status=TerminationStatus.INTERRUPTED), problem.variables, options)
    assert stopped.status is TerminationStatus.INTERRUPTED
    assert stopped.variables is problem.variables
    assert stopped.evaluations == failed.evaluations


def test_a_start_that_costs_more_over_its_first_part_is_not_run_over_the_whole(monkeypatch):
    """No term of a cost is negative: the first rows are enough to tell that the end is better; from the end itself they are not."""
    model, record = driven(0.3, 4.0, 6.0, 2.0, rows=400)
    options = FitOptions(at_rest=True, transcription="single")
    problem = prepare_problem(model.start(k=5.0), record, {"x": NOISE}, options)
    found = solve(problem, options)
    run = []

    def count(problem, variables):
        run.append(len(problem.records[0].u))
        return compute_start_cost(problem, variables)

    monkeypatch.setattr(sys.modules["greybox.estimation.noise_loop"], "compute_cost", count)
    assert keep_best(found, problem.variables, options) is found
    assert run == [60]
    assert keep_best(found, found.variables, options) is found
    assert run == [60, 60, 400]


@pytest.mark.parametrize("name", ["Robertson", pytest.param("Oregonator", marks=pytest.mark.slow)])
def test_a_free_run_that_follows_takes_the_place_of_segments_where_a_model_is_stiff(name):
    """Errors grow in some points; a free run follows all the same, with steps that follow the error."""
    problem = PROBLEMS[name]
    std = dict(zip(problem.measured, problem.std.tolist(), strict=True))
    found = fit(problem.model(), problem.record(), noise=std, options=FitOptions(at_rest=True, other_starts=0))
    assert found.success
    assert found.solver.statistics["transcription"] == "single"
    # Seen from a few steps, or after segments that led nowhere.
    said = found.solver.strategy.values
    assert said["reason"] == TranscriptionReason.FREE_RUN_FOLLOWS or said["completion"] == Completion.WENT_ON
    assert problem.squares({n: found.parameters[n].value for n in problem.names}) < problem.squares({})


@pytest.mark.crossed(3)
@pytest.mark.parametrize("delay", [0.5, 0.41, 0.3, 0.6])
def test_periods_that_show_how_a_record_began_are_no_noise(delay):
    """Two periods that differ by a transient: an autoregression of that, in place of noise, hid three hundred times the noise."""
    model, record = delayed_lag()
    found = fit(model.start(delay=delay), record, options=FitOptions(at_rest=True))
    assert found.misfit["x"].rmse == pytest.approx(NOISE, rel=0.1)
    assert found.noise.sources["x"] is not NoiseSource.REPEATED_PERIODS
    for name, true in (("k", 2.0), ("a", 1.0), ("delay", 0.5)):
        assert abs(found.parameters[name].value - true) < 4 * found.parameters[name].std


@pytest.mark.crossed(3)
@pytest.mark.parametrize("start", [{}, {"k": 1.5}, {"b": 20.0, "k": 40.0}], ids=["true", "near", "far"])
@pytest.mark.parametrize("name", ["hardening", "two wells"])
def test_a_fit_with_process_noise_is_as_likely_as_its_start_at_least(name, start):
    """The start's likelihood is that of a fit of the levels of the noise alone."""
    model, record = PLANTS[name]()
    noisy = model.with_process_noise(model.states[1].name).start(**start)
    found = fit(noisy, record, options=FitOptions(at_rest=True))
    held = noisy.fix(*(q.name for q in model.free_parameters))
    began = fit(held, record, options=FitOptions(at_rest=True))
    # Half of the decrease for which an intensity is kept above zero.
    assert found.prediction.log_likelihood >= began.prediction.log_likelihood - 0.05


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    "name", ["HIRES", "Robertson", "cell cycle", "nitrile", pytest.param("Oregonator", marks=pytest.mark.slow)]
)
def test_a_run_of_a_stiff_model_is_followed_where_explicit_steps_end(name):
    """The step of an implicit method is no matter of its stability: asked for what an explicit one needs, it ended at once.

    The cell cycle has states that begin at zero beside large ones, the nitrile a root of what is used up; the Oregonator asks for few
    explicit steps where it begins, and for very many later.
    """
    problem = (PROBLEMS | NETWORKS)[name]
    run = simulate(problem.model(), problem.record())
    for column, output in enumerate(problem.measured):
        np.testing.assert_allclose(run.outputs[output], problem.truth[:, column], rtol=1e-4, atol=1e-8)


@pytest.mark.rest
def test_a_run_that_halving_does_not_settle_is_followed():
    """Explicit steps as short as they may be went astray at the first spike, with finite numbers: 4e6 in place of 3800."""
    problem, s, q, w = PROBLEMS["Oregonator"], 98.876406, 2.8830985e-5, 91.919743
    run = simulate(problem.model().start(s=s, q=q, w=w), problem.record())
    truth = solve_ivp(
        lambda _, x: [
            s * (x[1] - x[0] * x[1] + x[0] - 1e-6 * q * x[0] ** 2),
            (x[2] - x[1] - x[0] * x[1]) / s,
            w * (x[0] - x[2]),
        ],
        (0.0, 360.0),
        list(problem.beginning.values()),
        "LSODA",
        problem.time,
        rtol=1e-10,
        atol=1e-12,
    ).y
    for name, expected in zip("yz", truth[1:], strict=True):
        np.testing.assert_allclose(run.outputs[name], expected, rtol=1e-4, atol=1e-5 * expected.max())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["immune cells", "cell cycle", "nitrile"])
def test_published_constants_are_held(name):
    """At those of the first, the run at the usual steps grows without end, and at shorter ones it does not."""
    problem = NETWORKS[name]
    std = dict(zip(problem.measured, problem.std.tolist(), strict=True))
    found = fit(problem.model(), problem.record(), noise=std, options=FitOptions(at_rest=True))
    assert problem.squares({n: found.parameters[n].value for n in problem.names}) <= problem.squares({})


@pytest.mark.slow
@pytest.mark.parametrize("draw", [0, 4], ids=["three times off", "ended at another rhythm"])
def test_a_relaxation_oscillation_from_far_off_is_found_from_other_starts(draw):
    """They are ranked by the steps of the search, as few of them run at explicit ones; another rhythm is an optimum above the noise."""
    problem, generator = PROBLEMS["Oregonator"], np.random.default_rng(1)
    starts = [problem.draw_start(3.0, None), *(problem.draw_start(10.0, generator) for _ in range(draw))]
    std = dict(zip(problem.measured, problem.std.tolist(), strict=True))
    found = fit(problem.model().start(**starts[-1]), problem.record(), noise=std, options=FitOptions(at_rest=True))
    assert found.success
    assert problem.squares({n: found.parameters[n].value for n in problem.names}) < problem.squares({})
    (taken,) = (f for f in found.findings if f.code == EstimationCode.OTHER_START_TAKEN)
    assert taken.values["trouble"] == (SearchTrouble.ANOTHER_COURSE if draw else SearchTrouble.EXPLAINS_NOTHING)


def rotifers():
    """Rotifers that feed on algae in a chemostat (Fussmann and others, Science 290, 2000), with constants of their size: three periods."""

    def rates(x, u, p):
        grown, eaten = p.grow * x.n / (p.half + x.n), p.eat * x.c / (p.full + x.c)
        return {
            "n": u.d * (80.0 - x.n) - grown * x.c,
            "c": grown * x.c - eaten * x.b / p.yield_ - u.d * x.c,
            "r": eaten * x.r - (u.d + 0.455) * x.r,
            "b": eaten * x.r - (u.d + 0.055) * x.b,
        }

    return StiffProblem(
        rates,
        {"n": 20.0, "c": 30.0, "r": 2.0, "b": 3.0},
        {"grow": 3.3, "half": 4.3, "eat": 2.25, "full": 15.0, "yield_": 0.25},
        np.linspace(0.0, 40.0, 121),
        ("c", "b"),
        {"d": np.full(121, 0.69)},
    )


@pytest.mark.slow
def test_a_start_that_explicit_steps_do_not_run_is_searched_from_by_others():
    """Errors grow there, and segments had no start."""
    problem = rotifers()
    std = dict(zip(problem.measured, problem.std.tolist(), strict=True))
    start = problem.model().start(**problem.draw_start(3.0, None))
    found = fit(start, problem.record(), noise=std, options=FitOptions(at_rest=True))
    assert found.success
    assert problem.squares({n: found.parameters[n].value for n in problem.names}) < problem.squares({})


@pytest.mark.slow
@pytest.mark.parametrize(("name", "draw"), [("thermal chain", 2), ("thermal chain", 3), ("motor", 2), ("measles", 1)])
def test_rates_from_anywhere_within_a_decade_are_found_and_none_runs_away(name, draw):
    """Along a plain scale one step took a conductance that the record hardly shows to zero or to 1e20, and each run there to a second."""
    problem = PROBLEMS[name]
    std = dict(zip(problem.measured, problem.std.tolist(), strict=True))
    generator = np.random.default_rng(1)
    starts = [problem.draw_start(10.0, generator) for _ in range(draw)]
    found = fit(problem.model().start(**starts[-1]), problem.record(), noise=std, options=FitOptions(at_rest=True))
    values = {n: found.parameters[n].value for n in problem.names}
    assert found.success
    assert problem.squares(values) <= problem.squares({})
    assert all(1e-5 < values[n] / problem.constants[n] < 1e5 for n in problem.names)


def test_steps_that_follow_the_error_end_where_they_run_away():
    """A hard spring that is pressed by 1e8 m swings at 3e9 rad/s: over 4 s that asks for 1e11 of them."""
    model, record = driven(1e-3, 4.0, 1e3, 2.0)
    began = time.perf_counter()
    run = simulate(model, record, initial={"x": 1e8}, method="esdirk")
    assert run.overflow is not None
    assert time.perf_counter() - began < 20.0


@pytest.mark.crossed(3)
@pytest.mark.parametrize("transcription", ["automatic", "single", "multiple"])
@pytest.mark.parametrize("factor", [0.3, 1.0, 2.0])
def test_growth_that_is_the_plants_own_is_no_chaos(transcription, factor):
    """A culture that doubles nine times while errors grow as it does: rate and first amount are those of least squares."""
    time_rows = np.linspace(0, 12, 60)
    y = 0.02 * np.exp(0.52 * time_rows) + 0.05 * np.random.default_rng(0).normal(size=60)
    model = Model(
        "culture",
        [State("n", "g", lambda p: p.n0)],
        [],
        [Output("n", "g")],
        [Parameter("rate", "1/s", 0.52 * factor, (1e-3, 10.0)), Parameter("n0", "g", 0.02 * factor, (1e-6, 10.0))],
        lambda x, u, p: [Balance("growth", "g/s", 1, "n", division=p.rate * x.n)],
    )
    record = Experiment("culture", time_rows, {}, {"n": y})
    found = fit(model, record, noise={"n": 0.05}, options=FitOptions(at_rest=True, transcription=transcription))
    least = least_squares(
        lambda z: np.exp(z[1] + np.exp(z[0]) * time_rows) - y, np.log([0.5, 0.02]), x_scale=0.01, xtol=1e-14, ftol=1e-14
    )
    assert found.success
    assert [found.parameters[n].value for n in ("rate", "n0")] == pytest.approx(np.exp(least.x), rel=1e-5)


def test_steps_on_which_constants_depend_are_made_shorter_or_told():
    model, record = driven(0.3, 4.0, 6.0, 2.0, period=0.2)
    codes = (EstimationCode.INTEGRATION_TOO_COARSE, EstimationCode.STEP_MOVES_PARAMETERS)
    fine = fit(model, record, noise={"x": NOISE}, options=FitOptions(at_rest=True, method="radau"))
    assert max(fine.discretisation.shift.values()) < 0.1
    assert not [f for f in fine.solver.details if f.code in codes]
    coarse = fit(model, record, noise={"x": NOISE}, options=FitOptions(at_rest=True, method="radau", substeps=1))
    assert [f.code for f in coarse.solver.details if f.code in codes] == list(codes)
    assert "With half the integration step the parameters change" in coarse.solver.status_message


@pytest.mark.rest
def test_segments_at_steps_that_are_too_long_go_on_by_a_free_run_with_shorter_ones():
    """Segments end with some doublings of their steps: constants were left three standard deviations off, and worse than they began."""
    model, record = driven(0.3, 4.0, 6.0, 2.0, period=0.2)
    found = check_no_worse(model, record, transcription="multiple", method="midpoint")
    assert max(found.discretisation.shift.values()) < 0.1
    assert found.solver.strategy.values["completion"] == Completion.FREE_RUN
    exact = fit(model, record, options=FitOptions(at_rest=True, method="rk4", substeps=64))
    for name, constant in exact.parameters.items():
        assert abs(found.parameters[name].value - constant.value) < 0.2 * constant.std


def test_ctrl_c_among_other_starts_keeps_what_is_found(monkeypatch):
    model, record = driven(0.3, 4.0, 6.0, 2.0)
    options = FitOptions(at_rest=True, transcription="single", progressive=False)
    lost = model.start(d=900.0, k=900.0, c=900.0, b=1e-3)
    alone = fit(lost, record, options=replace(options, other_starts=0, iterations=2))
    drawn = []

    def interrupt(*arguments, **keywords):
        if not drawn:  # the second one would end at once
            signal.raise_signal(signal.SIGINT)
        drawn.append(1)
        return draw_starts(*arguments, **keywords)

    monkeypatch.setattr(sys.modules["greybox.estimation.starts"], "draw_starts", interrupt)
    kept = fit(lost, record, options=replace(options, iterations=2))
    assert drawn
    assert {n: q.value for n, q in kept.parameters.items()} == {n: q.value for n, q in alone.parameters.items()}


def test_gradient_sampling_leaves_out_runs_about_to_overflow():
    """Slopes that are no numbers beside a cost that is one ended in a traceback."""

    def evaluate(z):
        slope = np.array([1.0, np.inf if z[0] > 0 else -1.0])
        return QuadraticModel(float(np.abs(z).sum()), slope, np.eye(2))

    search = Minimisation(evaluate, 1.0, None, None, DEFAULT_POLICY)
    bound = np.full(2, np.inf)
    search(np.array([-1e-3, 1.0]))
    status = run_gradient_sampling(search, -bound, bound, GradientSamplingPolicy())
    assert status in (TerminationStatus.KINK, TerminationStatus.ACCEPTABLE, TerminationStatus.STUCK)
