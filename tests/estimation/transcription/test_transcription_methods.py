"""Every transcription leads to the same constants, and each carries where the others fail."""

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import ode, solve_ivp

from greybox.base.errors import ModelError
from greybox.estimation.noise_loop import solve
from greybox.estimation.optim.ipopt import solve_sparse
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import FitOptions, Transcription
from greybox.estimation.transcription.collocation import Collocation, solve_collocation
from greybox.estimation.transcription.eliminated_states import ProjectedShooting
from greybox.estimation.transcription.multiple_shooting import MultipleShooting
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import TranscriptionReason
from greybox.estimation.transcription.segments import (
    SegmentedProblem,
    choose_segment_rows,
    cut_in_rows,
    cut_in_seconds,
    initialise_without_continuity,
    split_into_arcs,
)
from greybox.estimation.transcription.select import TranscriptionChoice, estimate_error_growth, propose_transcription
from greybox.model.balance import Balance
from greybox.model.effects.catalogue import effect
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.integrators.esdirk import MOST_STATES
from greybox.simulation.integrators.implicit import MAX_IMPLICIT_STATES
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.oracles.independent import experiment, linear_record, multisine, rates_of, solved_record, values
from tests.support.oscillator import oscillator

RANGE = (1e-3, 1e3)


def pendulum():
    """Inverted pendulum on a cart, measured angle from upright."""
    return Model(
        "pendulum",
        [State("a", "rad"), State("w", "rad/s")],
        [Input("u", "m/s**2")],
        [Output("a", "rad")],
        [
            Parameter("g_l", "rad/s**2", 20.0, RANGE),
            Parameter("d", "1/s", 0.3, RANGE),
            Parameter("b", "rad/m", 2.0, RANGE),
        ],
        lambda x, u, p: [
            Balance("angle", "rad/s", 1, "a", rate=x.w),
            Balance("moment", "rad/s**2", 1, "w", gravity=p.g_l * ca.sin(x.a), damping=-p.d * x.w, cart=p.b * u.u),
        ],
    )


def balanced(model, rows, period, noise, seed=1):
    """A record of the pendulum while a controller holds it up; the model alone, given the record's input, falls."""
    f, p, x = rates_of(model), values(model), np.array([0.05, 0.0])
    push = multisine(np.random.default_rng(seed), rows, period, 0.3, 4, 6.0)
    u, y = [], []
    for k in range(rows):
        u.append(push[k] - 20 * x[0] - 4 * x[1])
        y.append([x[0]])
        solver = ode(lambda t, x, u=u[-1]: f(x, u, p)).set_integrator("dop853", rtol=1e-11, atol=1e-13)
        x = solver.set_initial_value(x).integrate(period)
    return experiment(model, np.arange(rows) * period, np.array(u)[:, None], np.array(y), noise, seed)


@pytest.fixture(scope="module")
def duffing():
    model = oscillator("duffing", 0.3, 4.0, 6.0, 2.0)
    u = multisine(np.random.default_rng(0), 500, 0.02, 0.05, 1.5, 3.0)
    data = solved_record(model, u, np.arange(500) * 0.02, [0.3, 0.0])
    return model, model.start(d=0.45, k=2.6, c=9.0, b=1.3), data, {"x": 1e-3}, False, 8


@pytest.fixture(scope="module")
def pneumatic():
    model = pneumatic_cylinder.free("V_total")
    t = np.arange(300) * 0.01
    u = 1.25 * np.cos(0.4 * np.pi * t) + 2.0 * np.cos(1.6 * np.pi * t) + 0.5 * np.sign(np.sin(9.1 * t))
    half = model.values["P_S"] / 2
    data = linear_record(model, u, 0.01, [0.0, 0.0, half, half])
    return model, model.start(**{q.name: 1.4 * q.value for q in model.free_parameters}), data, {}, True, 0


def problem(start, data, noise, at_rest, substeps=0):
    return prepare_problem(start, data, noise, FitOptions(at_rest=at_rest, substeps=substeps))


def by_single(p, at_rest, substeps):
    return solve(p, FitOptions(at_rest=at_rest, substeps=substeps)).variables


def lifted(p, rows):
    return MultipleShooting(SegmentedProblem.of(p, cut_in_rows(p, rows)))


def by_multiple(p, rows=60):
    found = lifted(p, rows).solve()
    assert found.status.success, found.status
    assert found.gap < 1e-7
    return found.variables


def by_collocation(p, scheme, hessian="gauss-newton", elements=1):
    at_start, states = initialise_without_continuity(p, cut_in_rows(p, 60))
    program = Collocation(at_start, states, scheme=scheme, hessian=hessian, elements=elements)
    outcome = solve_sparse(**program.problem())
    assert outcome.status.success, outcome.solver_status
    return program.interpret(outcome.z)


def by_arcs(p, cuts):
    return MultipleShooting(SegmentedProblem.of(p, cuts), continuity=False).solve()


def error(variables, model):
    """Largest relative error of the free constants."""
    return np.abs(variables.fixed / values(model) - 1)[variables.which].max()


# (transcription, largest error on the duffing plant, on the linear pneumatic one): collocation has errors of its own
WAYS = {
    "single": (lambda p, rest, n: by_single(p, rest, n), 1e-7, 1e-8),
    "multiple": (lambda p, rest, n: by_multiple(p), 1e-7, 1e-8),
    "arcs": (lambda p, rest, n: by_arcs(p, cut_in_rows(p, 75)).variables, 1e-7, 1e-8),
    "Radau": (lambda p, rest, n: by_collocation(p, "radau").variables, 1e-7, 1e-5),
    "Legendre": (lambda p, rest, n: by_collocation(p, "legendre").variables, 1e-7, 1e-6),
    "Radau, exact Hessian": (lambda p, rest, n: by_collocation(p, "radau", "exact").variables, 1e-7, 1e-5),
    "Legendre, two elements a sample": (
        lambda p, rest, n: by_collocation(p, "legendre", elements=2).variables,
        1e-7,
        1e-8,
    ),
}


# The plain ones are tried on four plants by the fit's own tests.
PLAIN = ("single", "multiple", "arcs", "Radau", "Legendre")


@pytest.mark.parametrize("way", [pytest.param(w, marks=pytest.mark.slow) if w in PLAIN else w for w in WAYS])
def test_every_transcription_gives_the_true_constants_back(way, duffing, pneumatic):
    find, *allowed = WAYS[way]
    for (truth, start, data, noise, rest, substeps), most in zip((duffing, pneumatic), allowed, strict=True):
        found = find(problem(start, data, noise, rest, substeps), rest, substeps)
        assert error(found, truth) < most, truth.name


def test_multiple_shooting_ends_where_single_shooting_does_on_noisy_records_with_gaps():
    truth = micro_actuator.fix("M", "Ra")
    noise = {"x": 2e-7, "i": 5e-3}
    records = []
    for seed in (1, 2):
        u = multisine(np.random.default_rng(seed), 900, 2.5e-4, 5, 800, 3.0)
        data = linear_record(truth, u, 2.5e-4, [2e-5, 0.0, 0.05], noise, seed)
        holes = np.random.default_rng(seed).random(900) < 0.2
        records.append(replace(data, outputs={n: np.where(holes, np.nan, y) for n, y in data.outputs.items()}))
    start = truth.start(**{q.name: 1.3 * q.value for q in truth.free_parameters})
    p = problem(start, records, noise, False)
    reference = solve(p, FitOptions())
    found = lifted(p, 70).solve()
    assert found.status.success
    assert found.evaluation.cost == pytest.approx(reference.evaluation.cost, rel=1e-6)
    assert found.evaluation.count == reference.evaluation.count
    information = p.shooting(found.variables).evaluate(found.variables.here).hessian
    n = len(found.variables.which)
    a, b, c = information[:n, :n], information[:n, n:], information[n:, n:]
    projected = a - b @ np.linalg.solve(c, b.T)
    # the intervals come from this matrix: states eliminated from all segments at once or from one free run, it is the same
    np.testing.assert_allclose(
        found.evaluation.hessian[:n, :n], projected, rtol=1e-5, atol=1e-6 * np.abs(projected).max()
    )
    std = np.sqrt(np.diag(np.linalg.inv(projected / 2)))
    moved = np.log(found.variables.fixed / reference.variables.fixed)[found.variables.which]
    assert np.all(np.abs(moved) < 0.05 * std)
    joined = np.concatenate([y for y, _ in found.segmented.simulate()])
    free = np.concatenate([y for y, _ in p.shooting(found.variables).simulate(found.variables.here)])
    np.testing.assert_allclose(joined, free, atol=1e-6 * np.ptp(free, axis=0).max())


def test_an_unstable_plant_is_fitted_by_multiple_shooting_where_single_shooting_fails():
    """The pendulum falls with e^18 in the 4 s of the record; 1 mrad of noise on the angle."""
    truth = pendulum()
    p = problem(truth.start(g_l=12.0, d=0.5, b=3.2), balanced(truth, 401, 0.01, {"a": 1e-3}), {"a": 1e-3}, False, 4)
    alone = solve(p, FitOptions(substeps=4, progressive=False, transcription="single"))
    assert alone.evaluation.cost > 100 * 401
    proposal = propose_transcription(truth.system, p.variables.fixed, p.records[0])
    assert proposal.transcription == "multiple"
    assert proposal.reason.code == TranscriptionReason.UNSTABLE
    growth = estimate_error_growth(truth.system, p.variables.fixed, p.records[0])
    assert np.sqrt(12) * 0.8 < growth < np.sqrt(12)
    found = lifted(p, choose_segment_rows(growth, p.records[0])).solve()
    assert found.status.success and found.iterations < 10
    assert 0.8 * 401 < found.evaluation.cost < 1.2 * 401
    n = len(found.variables.which)
    std = np.sqrt(2 * np.diag(np.linalg.inv(found.evaluation.hessian[:n, :n])))
    away = np.log(found.variables.fixed / values(truth))
    assert np.all(np.abs(away) < 3 * std) and std.max() < 0.05


@pytest.mark.rest
def test_a_chaotic_record_is_fitted_by_multiple_shooting_where_single_shooting_fails():
    truth = oscillator("wells", 0.15, -1.0, 1.0, 1.0)
    t = np.arange(1200) * 0.05
    data = solved_record(truth, 0.3 * np.cos(1.2 * t), t, [0.5, 0.0])
    p = problem(truth.start(d=0.2, k=-1.3, c=0.8, b=1.2), data, {"x": 1e-2}, False, 4)
    alone = solve(p, FitOptions(substeps=4, progressive=False, transcription="single"))
    assert error(alone.variables, truth) > 0.1
    assert error(by_multiple(p, 40), truth) < 1e-6


def test_a_constant_stops_at_its_bound_in_multiple_shooting(duffing):
    _, start, data, noise, rest, substeps = duffing
    p = problem(start.start(k=3.0).bound(k=(1.0, 3.5)), data, noise, rest, substeps)
    found = lifted(p, 60).solve()
    assert found.status.success, found.status
    single = solve(p, FitOptions(substeps=substeps)).variables
    assert found.variables.fixed[1] == single.fixed[1] == 3.5
    np.testing.assert_allclose(found.variables.fixed, single.fixed, rtol=1e-4)


def test_a_segment_that_overflows_at_the_start_is_a_result_and_not_an_error():
    model = Model(
        "explosive",
        [State("x", "m", 1.0)],
        [Input("u", "m")],
        [Output("x", "m")],
        [Parameter("a", "1/s/m", 50.0, (1e-3, 1e3))],
        lambda x, u, p: [Balance("growth", "m/s", 1, "x", square=p.a * x.x * x.x)],
    )
    t = np.arange(100) * 0.1
    p = problem(model, experiment(model, t, np.ones((100, 1)), 2 + np.cos(t)[:, None]), {"x": 0.1}, False, 4)
    found = lifted(p, 50).solve()
    assert found.status is TerminationStatus.NO_START
    assert found.evaluation.cost == np.inf


def stiff(line):
    """A spool that follows within 20 us ahead of a slow state, and ``line`` lags after that."""
    lags = [f"l{k}" for k in range(line)]
    return Model(
        "stiff",
        [State("s", "m"), State("x", "m"), *(State(n, "m") for n in lags)],
        [Input("u", "m")],
        [Output("x", "m")],
        [
            Parameter("a", "1/s", 2.0, RANGE),
            Parameter("c", "1/m**2", 0.5, RANGE),
            Parameter("f", "1/s", 5e4, (1, 1e6), fixed=True),
            Parameter("g", "1/s", 1.0, fixed=True),
        ],
        lambda x, u, p: [
            Balance("spool", "m/s", 1, "s", command=p.f * u.u, back=-p.f * x.s, hardening=-p.f * p.c * x.s**3),
            Balance("slow", "m/s", 1, "x", inflow=p.g * x.s, decay=-p.a * x.x),
            *(Balance(n, "m/s", 1, n, inflow=p.a * x[m], decay=-p.a * x[n]) for m, n in pairwise(["x", *lags])),
        ],
    )


@pytest.mark.rest
def test_a_stiff_plant_gets_implicit_steps_or_collocation_and_is_fitted_by_radau_points():
    """Sampled every 50 ms: RK4 would need thousands of steps a sample. Implicit steps that follow the error take many
    states, Radau points any number."""
    model = stiff(line=0)
    f, p = rates_of(model), values(model)
    t, u = np.arange(80) * 0.05, 1.5 * np.sin(np.arange(80) * 0.25)
    x, y = np.zeros(2), []
    for k in range(80):
        y.append([x[1]])
        run = solve_ivp(lambda _, x, k=k: f(x, u[k], p), (0, 0.05), x, method="LSODA", rtol=1e-9, atol=1e-11)
        x = run.y[:, -1]
    data = experiment(model, t, u[:, None], np.array(y))
    for line, expected in {
        0: ("single", "esdirk"),
        MAX_IMPLICIT_STATES - 1: ("single", "esdirk"),
        MOST_STATES - 1: ("collocation-radau", ""),
    }.items():
        larger = stiff(line)
        prepared = prepare_problem(larger, data, {"x": 1e-4}, FitOptions(at_rest=True, substeps=1))
        transcription, reason, implicit = propose_transcription(larger.system, p, prepared.records[0])
        assert (transcription, implicit) == expected
        assert reason.values["fastest"] == pytest.approx(2e-5, rel=0.05)
        code = TranscriptionReason.STIFF_IMPLICIT if implicit else TranscriptionReason.STIFF_COLLOCATION
        assert reason.code == code
    start = model.start(a=3.0, c=0.2)
    prepared = prepare_problem(start, data, {"x": 1e-4}, FitOptions(at_rest=True, substeps=1))
    program = Collocation(prepared, [np.column_stack([u, np.array(y)])])
    outcome = solve_sparse(**program.problem())
    assert outcome.status.success
    assert error(program.interpret(outcome.z).variables, model) < 1e-3


def test_states_keep_their_physical_bounds_in_collocation():
    model = cascaded_tanks
    t = np.arange(60) * 4.0
    u = np.where(t < 80, 3.0, 0.0)
    low = np.array([s.bounds[0] for s in model.all_states])
    data = solved_record(model, u, t, [2.0, 2.0])
    p = problem(model, data, {o.name: 0.01 for o in model.outputs}, False, 4)
    program = Collocation(p, [np.full((60, 2), -1.0)])
    given = program.problem()
    assert (given["start"][len(p.variables.which) :] >= 0).all()
    outcome = solve_sparse(**given)
    assert all((x >= low).all() for x in program.interpret(outcome.z).states)


def test_who_goes_on_from_collocation_has_steps_as_fine_as_its_points():
    model = oscillator("duffing", 0.3, 4.0, 6.0, 2.0)
    data = solved_record(model, np.sin(np.arange(60) * 0.3), np.arange(60) * 0.1, [0.3, 0.0])
    problem = prepare_problem(model, data, {"x": 1e-3}, FitOptions(method="rk4", substeps=1))
    choice = TranscriptionChoice(Transcription("collocation-radau"), None, problem)
    solution = solve_collocation(choice, FitOptions(substeps=2))
    assert solution.problem.step.substeps >= 3 * 2


def test_collocation_refuses_unknown_options_and_equations_that_stick(duffing):
    model, _, data, noise, rest, substeps = duffing
    p = problem(model, data, noise, rest, substeps)
    start = [np.zeros((500, 2))]
    with pytest.raises(ModelError, match="unknown collocation points 'radaus'; did you mean 'radau'"):
        Collocation(p, start, scheme="radaus")
    with pytest.raises(ModelError, match="degree 12: give 1 to 9"):
        Collocation(p, start, degree=12)
    with pytest.raises(ModelError, match=r"unknown Hessian 'gauss'.*gauss-newton"):
        Collocation(p, start, hessian="gauss")
    dry = emps + effect("coulomb_friction")
    q = problem(dry, linear_record(emps, np.sin(np.arange(50)), 1e-3), {"q": 1e-5}, True)
    with pytest.raises(ModelError, match="coulomb_friction sticks or switches"):
        Collocation(q, start)


def test_eliminating_initial_states_keeps_cost_gradient_and_optimum(duffing):
    _, start, data, noise, _, substeps = duffing
    arcs = split_into_arcs(data, rows=50)
    p = problem(start, arcs, noise, False, substeps)
    shooting = p.shooting()
    projected = ProjectedShooting(shooting)
    projected.carry_states()
    z = np.array([-0.2, 0.1, 0.05, 0.1])
    here = projected.evaluate(z)
    full = shooting.evaluate(projected.full(z))
    assert full.cost == pytest.approx(here.cost, rel=1e-9)
    n = len(z)
    assert (
        np.abs(full.gradient[n:]).max() < 1e-4 * np.abs(full.gradient[:n]).max()
    )  # the initial states are at their best
    slopes = [(projected.evaluate(z + 1e-5 * e).cost - projected.evaluate(z - 1e-5 * e).cost) / 2e-5 for e in np.eye(n)]
    np.testing.assert_allclose(here.gradient, slopes, rtol=1e-6)
    a, b, c = full.hessian[:n, :n], full.hessian[:n, n:], full.hessian[n:, n:]
    np.testing.assert_allclose(here.hessian, a - b @ np.linalg.solve(c, b.T), rtol=1e-6)


def test_short_arcs_forget_a_drift_that_spoils_the_long_run():
    """An unknown load that grows along the record: over the whole of it the friction takes the blame, over short arcs little."""
    rows, period = 3000, 2e-3
    t = np.arange(rows) * period
    truth = emps + effect("constant_load")
    u = 2.0 * np.sin(2 * np.pi * 0.9 * t) + np.sin(2 * np.pi * 3.1 * t)
    load = next(n for n in truth.values if n not in emps.values)
    loads = np.linspace(-6.0, 6.0, 20)
    x, parts = np.zeros(2), []
    for k, force in enumerate(loads):  # the load steps up slowly, unseen by the model that is fitted
        part = linear_record(truth.start(**{load: force}), u[150 * k : 150 * (k + 1) + 1], period, x)
        q = part.outputs["q"]
        v = (3 * q[-1] - 4 * q[-2] + q[-3]) / (2 * period)
        parts.append(q[:-1] if k < 19 else q[:150])
        x = np.array([q[-1], v])
    data = experiment(emps, t, u[:, None], np.concatenate(parts)[:, None], {"q": 1e-5}, 1)
    p = problem(emps.start(M=80.0), data, {"q": 1e-5}, False)
    whole = solve(p, FitOptions()).variables
    found = by_arcs(p, cut_in_seconds(p, 0.3))
    assert found.status.success or found.status is TerminationStatus.STUCK
    free = [q.name for q in emps.free_parameters]
    names = list(emps.values)
    for name in free:
        k = names.index(name)
        off = [abs(v.fixed[k] / emps.values[name] - 1) for v in (whole, found.variables)]
        assert off[1] < 0.5 * off[0], name
    assert found.evaluation.cost < 0.2 * p.shooting(whole).evaluate(whole.here).cost


def test_a_transcription_is_proposed_with_its_reason(pneumatic):
    u = multisine(np.random.default_rng(1), 400, 2.5e-4, 5, 800, 3.0)
    p = problem(micro_actuator, linear_record(micro_actuator, u, 2.5e-4), None, True)
    assert propose_transcription(micro_actuator.system, values(micro_actuator), p.records[0])[0] == "single"
    truth, start, data, noise, rest, _ = pneumatic
    q = problem(start, data, noise, rest)
    proposal = propose_transcription(truth.system, values(truth), q.records[0])
    assert proposal.transcription == "single"
    assert proposal.reason.code == TranscriptionReason.INTEGRATING_GROWING
    assert proposal.reason.values["time_constants"] > 50
    short = propose_transcription(truth.system, values(truth), q.records[0].first(50))
    assert short.reason.code == TranscriptionReason.INTEGRATING_SHORT


def test_segments_of_several_records_keep_their_own_initial_states(duffing):
    """Two records with initial states of their own, given nodes, and the layout of `DecisionVector`: nothing is mixed up."""
    model, start, data, noise, rest, substeps = duffing
    other = solved_record(model, 2 * np.cos(np.arange(260) * 0.05), np.arange(260) * 0.02, [-0.2, 1.0])
    p = problem(start, [data, other], noise, rest, substeps)
    found = lifted(p, (100, 40)).solve()
    assert found.status.success
    assert [len(places) - 1 for places in found.segmented.cuts] == [5, 7]  # 20 rows of 40 stay a segment
    assert len(found.segmented.starts_record) == 12
    np.testing.assert_allclose(found.variables.initial.guess, [[0.3, 0.0], [-0.2, 1.0]], atol=1e-6)
    assert p.shooting(found.variables).evaluate(found.variables.here).cost < 1e-6
