"""How one candidate is refitted: many starts are looked at first, and nothing is fitted twice."""

from dataclasses import replace

import casadi as ca
import numpy as np

import greybox as gb
from greybox.discovery import problem as refits
from greybox.discovery.execution import RefitJob
from greybox.discovery.problem import DiscoveryProblem


def tone_model():
    """A sum of a lag and a tone of unknown frequency: its cost has a minimum beside every one."""
    return gb.Model(
        "tone",
        states=[gb.State("x", "V", 0.0)],
        inputs=[gb.Input("u", "V"), gb.Input("stamp", "s")],
        outputs=[gb.Output("y", "V", lambda x, u, p: x.x + p.a * ca.sin(p.w * u.stamp))],
        parameters=[
            gb.Parameter("k", "1/s", 1.5, (0.1, 10.0)),
            gb.Parameter("a", "V", 0.2, (0.0, 10.0)),
            gb.Parameter("w", "1/s", 3.0, (0.1, 50.0)),
        ],
        balances=lambda x, u, p: [gb.Balance("rate", "V/s", 1, "x", decay=-p.k * x.x, drive=p.k * u.u)],
    )


def tone_record(noise=0.01):
    """The lag by its step in closed form, under steps; the tone has 7 rad/s."""
    generator, period, rows, x, y = np.random.default_rng(4), 0.02, 500, 0.0, []
    u, time = np.repeat(generator.normal(size=20), 25), 0.02 * np.arange(500)
    for value in u:
        y.append(x)
        x = value + (x - value) * np.exp(-2.0 * period)
    measured = np.array(y) + 0.5 * np.sin(7.0 * time) + noise * generator.normal(size=rows)
    return gb.Experiment("tone", time, {"u": u, "stamp": time}, {"y": measured})


def tone_problem():
    return DiscoveryProblem(tone_model(), (tone_record(),), {"y": 0.01}, (), gb.FitOptions(at_rest=True))


def test_of_many_starts_only_the_most_promising_are_searched_from_to_the_end(monkeypatch):
    begun = []

    def solve(problem, options):
        begun.append(options.iterations)
        return solve_whole(problem, options)

    solve_whole = refits.solve
    problem = tone_problem()
    assert problem.baseline.cost > 10 * problem.baseline.count  # its own start ends beside another minimum
    monkeypatch.setattr(refits, "solve", solve)
    frequencies = np.linspace(1.0, 15.0, 12)
    starts = tuple({"k": 1.5, "a": 0.3, "w": float(w)} for w in frequencies)
    fit = problem.refit(RefitJob(problem.model, starts, len(starts), 40))
    assert begun.count(refits.LOOK_ITERATIONS) == len(starts)
    assert begun.count(40) == refits.MOST_SEARCHED
    assert abs(fit.model.values["w"] - 7.0) < 0.01 and abs(fit.model.values["a"] - 0.5) < 0.01
    assert fit.per_sample < 1.3


def test_a_candidate_that_a_refit_leaves_where_it_is_is_not_refitted_again():
    problem = tone_problem()
    start = problem.refit_best(problem.model, [{"k": 1.9, "a": 0.4, "w": 6.9}], 1, 1)
    before = problem.executor.finished
    converged = problem.converge(start)
    assert converged.cost < start.cost and problem.executor.finished == before + 1
    assert problem.converge(converged) is converged
    assert problem.executor.finished == before + 1


def test_a_refit_that_still_falls_at_its_limit_begins_again_where_the_user_did():
    problem = DiscoveryProblem(
        tone_model().start(k=1.95, a=0.48, w=7.0), (tone_record(),), {"y": 0.01}, (), gb.FitOptions(at_rest=True)
    )
    astray = problem.refit_best(problem.model, [{"k": 9.0, "a": 0.0, "w": 6.9}], 1, 1)
    assert astray.promised_decrease > refits.STILL_FALLING * astray.cost
    converged = problem.converge(astray, iterations=1)
    assert abs(converged.model.values["w"] - 7.0) < 0.01 and converged.per_sample < 1.3


def test_a_refit_goes_on_as_long_as_it_falls():
    problem = tone_problem()
    start = problem.refit_best(problem.model, [{"k": 0.3, "a": 0.1, "w": 7.2}], 1, 1)
    short = problem.refit_best(problem.model, [start.model.values], 1, 1, like=start)
    assert short.is_falling and short.per_sample > 2.0
    converged = problem.converge(start, iterations=1)
    assert not converged.is_falling and converged.per_sample < 1.3


def test_what_is_known_under_one_noise_is_not_known_under_another():
    problem = tone_problem()
    problem.settled.add(problem.baseline.key)
    other = replace(problem, noise={"y": 0.1})
    assert not other.settled


def test_a_refit_that_the_time_limit_leaves_out_may_still_be_made_in_its_reserve():
    problem = tone_problem()
    start = problem.refit_best(problem.model, [{"k": 1.9, "a": 0.4, "w": 6.9}], 1, 1)
    problem.executor.deadline = 0.0
    assert problem.converge(start) is start
    problem.executor.release_reserve()
    assert problem.converge(start).cost < start.cost
