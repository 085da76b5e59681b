"""The loop of a search on records of a mass on a spring: what it tries, what it leaves alone, and that what wins is the answer."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.discovery.candidates import estimate_scales, list_candidates
from greybox.discovery.claims import Weights, name_claim, weigh_claims
from greybox.discovery.conclusion import draw_with_parts, leave_out_small
from greybox.discovery.effect_signal import estimate_effect_signals
from greybox.discovery.execution import FailureLog, SearchStage
from greybox.discovery.holdout import HoldoutScores, ValidationSet
from greybox.discovery.linear import EffectPromise
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.proposers import add_objections, list_constants_in_place
from greybox.discovery.search import EffectSearch, StepKind
from greybox.discovery.surrogate_effects import CURVE
from greybox.discovery.table import FitTable
from tests.support.stage import STAGE

NOISE = 2e-5
# Whole searches.
pytestmark = pytest.mark.rest
NAMES = ("coulomb_friction", "stribeck_friction", "cubic_stiffness", "input_offset", "sensor_lag")


def record(seed, hidden, model=STAGE, push=0.0):
    rng = np.random.default_rng(seed)
    time, force = 5e-3 * np.arange(160), push + np.repeat(rng.normal(0, 6, 16), 10)
    for name, values in hidden.items():
        model = (model + gb.effect(name)).start(**values)
    run = gb.simulate(model, {"time": time, "F": force})
    return gb.Experiment(f"run {seed}", time, {"F": force}, {"x": run.outputs["x"] + NOISE * rng.normal(size=160)})


def search(hidden, seed=1, noise=NOISE):
    """A finished search for a few effects, and the set that won."""
    told = {} if noise is None else {"x": noise}
    problem = DiscoveryProblem(STAGE, (record(seed, hidden),), told, (), gb.FitOptions(at_rest=True))
    scales = estimate_scales(problem.baseline)
    listed = list_candidates(STAGE, scales, problem.failures, [gb.effect(name) for name in NAMES])
    table = FitTable(HoldoutScores(problem, ValidationSet((record(seed + 50, hidden),))))
    loop = EffectSearch(problem, table, listed.effects, scales, DiscoveryPolicy(), lambda text: None)
    return loop, leave_out_small(table, loop.run())


@pytest.fixture(scope="module")
def of_friction():
    return search({"coulomb_friction": {"Fc": 1.0}})


def test_the_set_that_wins_is_the_simplest_that_leaves_only_noise(of_friction):
    loop, winner = of_friction
    assert winner.effects == ("coulomb_friction",)
    assert winner.model.values["Fc"] == pytest.approx(1.0, rel=0.05)
    # Its richer relative was fitted too, and the plain model is on the table.
    assert loop.table.get(("stribeck_friction",)) is not None
    assert loop.table.get(()) is loop.baseline


def test_the_path_says_what_each_round_came_to(of_friction):
    loop, _ = of_friction
    (step,) = loop.steps
    assert (step.kind, step.effects, step.accepted) == (StepKind.ADD, ("coulomb_friction",), True)
    assert step.checks[0].passed and step.checks[0].value < 1


def test_of_two_effects_each_is_found_and_what_is_without_one_is_on_the_table():
    loop, winner = search({"coulomb_friction": {"Fc": 1.0}, "input_offset": {"u0": 0.8}}, seed=5)
    assert set(winner.effects) == {"coulomb_friction", "input_offset"}
    for name in winner.effects:
        rest = loop.table.get(set(winner.effects) - {name})
        assert rest is not None and rest.noise_ratio > 1.5 * winner.noise_ratio


def test_a_constant_at_the_balance_does_not_hide_the_one_at_the_input(of_friction):
    """They are of one family, by the gain that differs by sign, and each other's equal: one alone would pass for certain."""
    loop, winner = of_friction
    names = ("constant_load", "input_offset", "gain_by_sign")
    promises = [EffectPromise(gb.effect(name), 1e6 - k) for k, name in enumerate(names)]
    # The first of the family in the catalogue is tried whatever it promises.
    candidates = [*(p.effect for p in promises), *(e for e in loop.candidates if e.name not in names)]
    chosen = replace(loop, candidates=candidates)._choose([(winner, p, 1.0 + k) for k, p in enumerate(promises)])
    assert [promise.effect.name for _, promise in chosen] == ["constant_load", "input_offset"]


def test_its_equal_elsewhere_is_fitted_from_where_an_effect_ended():
    """From the plain model the two may end in different valleys: the one that came further would pass for certain."""
    listed = [gb.effect(name) for name in ("constant_load", "input_offset", "gain_by_sign")]
    hidden = {"constant_load": {"F0": 1.5}}
    problem = DiscoveryProblem(STAGE, (record(3, hidden),), {"x": NOISE}, (), gb.FitOptions(at_rest=True))
    table = FitTable(HoldoutScores(problem, ValidationSet((record(53, hidden),))))
    scales = estimate_scales(problem.baseline)
    loop = EffectSearch(problem, table, listed, scales, DiscoveryPolicy(), lambda text: None)
    model = STAGE + listed[0]
    load = problem.refit_best(model, [{**model.values, "F0": 1.5}])
    table.add(load)
    loop._add_relatives(load)
    assert table.get(("input_offset",)).noise_ratio == pytest.approx(load.noise_ratio, rel=1e-3)


@pytest.mark.parametrize("noise", [NOISE, None])
def test_a_complete_model_keeps_no_effect(noise):
    loop, winner = search({}, seed=9, noise=noise)
    assert winner.effects == ()
    assert all(not step.accepted for step in loop.steps)


def test_a_search_without_time_tries_nothing(monkeypatch):
    problem = DiscoveryProblem(STAGE, (record(1, {}),), {"x": NOISE}, (), gb.FitOptions(at_rest=True))
    scales = estimate_scales(problem.baseline)
    listed = list_candidates(STAGE, scales, problem.failures, [gb.effect("cubic_stiffness")])
    table = FitTable(HoldoutScores(problem, ValidationSet((record(2, {}),))))
    loop = EffectSearch(problem, table, listed.effects, scales, DiscoveryPolicy(), lambda text: None)
    monkeypatch.setattr(type(problem.executor), "is_late", property(lambda refits: True))
    assert loop.run() is loop.baseline
    assert not loop.screened and problem.executor.skipped >= 1


# A voice coil on a spring with its current, and a lag of the sensor of its position.
COIL = Model(
    "coil",
    states=[State("x", "m", role="displacement"), State("v", "m/s", role="velocity"), State("i", "A", role="current")],
    inputs=[Input("u", "V", role="drive")],
    outputs=[Output("x", "m"), Output("i", "A")],
    parameters=[
        Parameter("M", "kg", 0.012, fixed=True),
        Parameter("R", "ohm", 9.1, fixed=True),
        Parameter("B", "N*s/m", 0.27, (0.0, 1e3)),
        Parameter("K", "N/m", 4400.0, (1.0, 1e6)),
        Parameter("Kf", "N/A", 1.32, (1e-2, 100.0)),
        Parameter("Kv", "V*s/m", 1.31, (1e-2, 100.0)),
        Parameter("L", "H", 9e-4, (1e-6, 1.0)),
    ],
    balances=lambda x, u, p: [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", coil=p.Kf * x.i, spring=-p.K * x.x, damping=-p.B * x.v),
        Balance("voltage", "V", p.L, "i", source=u.u, resistance=-p.R * x.i, back_emf=-p.Kv * x.v),
    ],
)


def read_late(tau, seed=2, rows=600, h=2.5e-4):
    """A record of a coil whose position is read through a lag, exact over each interval by the matrix exponential."""
    m, b, k, kf, ohm, henry = 0.012, 0.23, 5000.0, 1.42, 9.1, 1e-3
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-6, 6, 20), rows // 20)
    rates = np.zeros((5, 5))
    rates[:4] = [
        [0, 1, 0, 0, 0],
        [-k / m, -b / m, kf / m, 0, 0],
        [0, -kf / henry, -ohm / henry, 0, 1 / henry],
        [1 / tau, 0, 0, -1 / tau, 0],
    ]
    step, z = expm(h * rates), np.zeros((rows, 4))
    for n in range(rows - 1):
        z[n + 1] = step[:4, :4] @ z[n] + step[:4, 4] * u[n]
    readings = {"x": z[:, 3] + 1e-7 * rng.normal(size=rows), "i": z[:, 2] + 5e-3 * rng.normal(size=rows)}
    return gb.Experiment(f"run {seed}", h * np.arange(rows), {"u": u}, readings)


@pytest.mark.parametrize("tau", [3e-4, 1e-3, 3e-3])
def test_a_lag_is_searched_for_until_its_end_from_every_scale_of_time(tau):
    """Without it the damping and the inductance have gone to where they imitate it, and a lag that begins too short stays there."""
    problem = DiscoveryProblem(COIL, (read_late(tau),), {"x": 1e-7, "i": 5e-3}, (), gb.FitOptions(at_rest=True))
    scales = estimate_scales(problem.baseline)
    listed = list_candidates(COIL, scales, problem.failures, [gb.effect("sensor_lag")])
    table = FitTable(HoldoutScores(problem, ValidationSet((read_late(tau, seed=7),))))
    loop = EffectSearch(problem, table, listed.effects, scales, DiscoveryPolicy(), lambda text: None)
    loop._add_promising([loop.baseline])
    fit = table.get({"sensor_lag"})
    assert fit.model.values["tau_s"] == pytest.approx(tau, rel=0.02)
    assert fit.noise_ratio < 1.1 < 2 < loop.baseline.noise_ratio


def test_a_set_that_wins_with_a_curve_has_won_against_the_curve_alone():
    """Of a load beside a stiffness that is not there, the constant in its place does all; the stiffness was never taken away."""
    problem = DiscoveryProblem(
        STAGE, (record(3, {"constant_load": {"F0": 0.5}}),), {"x": NOISE}, (), gb.FitOptions(at_rest=True)
    )
    table = FitTable(HoldoutScores(problem, ValidationSet((record(53, {"constant_load": {"F0": 0.5}}),))))
    loop = EffectSearch(problem, table, [], estimate_scales(problem.baseline), DiscoveryPolicy(), lambda text: None)
    stiff = problem.refit_best(STAGE + gb.effect("cubic_stiffness"), [STAGE.values])
    constant = next(c for c in list_constants_in_place(gb.effect("coulomb_friction"), stiff) if c.site == "force")
    both = problem.refit_best(stiff.model + constant, [stiff.model.values])
    table.add(stiff, both)
    draws = draw_with_parts(loop, (stiff,))
    alone = table.get((CURVE,))
    assert alone is not None
    assert draws.sets[Weights.of(draws).leading].candidate is alone


def claim_before_and_after_objections(model, records, name):
    """What is claimed of one effect that leaves only noise, before its objections stand on the table and with them."""
    problem = DiscoveryProblem(model, records[:1], {"x": NOISE}, (), gb.FitOptions(at_rest=True))
    table = FitTable(HoldoutScores(problem, ValidationSet((records[1],))))
    scales = estimate_scales(problem.baseline)
    listed = list_candidates(model, scales, problem.failures, [gb.effect(name)])
    loop = EffectSearch(problem, table, listed.effects, scales, DiscoveryPolicy(), lambda text: None)
    loop._add_promising([loop.baseline])
    fit = problem.converge(table.get({name}))
    table.add(fit)
    assert fit.noise_ratio < 1.2 < 2 < loop.baseline.noise_ratio
    before = name_claim(weigh_claims(loop.draw(always=(fit,)), (), (), 0.0, {name}), name)
    add_objections(loop, fit, estimate_effect_signals(problem, fit))
    return before, name_claim(weigh_claims(loop.draw(always=(fit,)), (), (), 0.0, {name}), name)


def test_an_end_stop_that_is_never_left_is_no_more_certain_than_a_straight_line():
    """A spring that is stiffer than its user holds it for, always pressed: a stop that is always touched does the same."""
    records = [record(seed, {}, STAGE.start(K=360.0), push=30.0) for seed in (4, 54)]
    before, after = claim_before_and_after_objections(STAGE.fix(K=300.0), records, "end_stop")
    assert before.is_established and not after.is_established


def test_a_lag_of_the_sensor_is_no_more_certain_than_one_of_the_drive():
    """Even where nobody lists the lag of the drive: through a linear plant it does the same at either end."""
    records = [record(seed, {"drive_lag": {"tau_u": 0.03}}) for seed in (4, 54)]
    before, after = claim_before_and_after_objections(STAGE, records, "sensor_lag")
    assert before.is_established and not after.is_established
    # A sensor that is known not to be slow objects to nothing.
    _, of_fast = claim_before_and_after_objections(replace(STAGE, lacks=("slow_sensor",)), records, "drive_lag")
    assert of_fast.is_established


@dataclass(frozen=True)
class Look:
    """A refit that is planned."""

    model: SimpleNamespace


class Fits:
    """Refits of sets whose ends are known: those of a look, from the absent effect, and of a look that goes on."""

    def __init__(self, **ends):
        self.ends, self.carried = ends, []

    def refit_all(self, jobs):
        return [self.ends["look" if isinstance(job, Look) else job] for job in jobs if job is not None]

    def plan_refit(self, model, *_, **__):
        self.carried.append(model.name)
        return "carried"


def ended(name, cost, promised=0.0):
    return SimpleNamespace(
        name=name, effects=(name,), cost=cost, promised_decrease=promised, model=SimpleNamespace(name=name, values={})
    )


@pytest.mark.parametrize(("promised", "goes_on"), [(60.0, True), (30.0, False)])
def test_a_look_above_the_smaller_set_goes_on_where_it_promises_to_pass_it(promised, goes_on):
    """The smaller set may have ended with its constants at their bounds: from there, the effect absent, nothing leads away."""
    fits = Fits(look=ended("look", 150.0, promised), absent=ended("absent", 100.0), carried=ended("carried", 5.0))
    added = []
    table = SimpleNamespace(add=lambda *sets: added.extend(each.name for each in sets), candidates=())
    loop = SimpleNamespace(problem=fits, table=table, _best=lambda _: [], _plan_absent=lambda *_: "absent")
    look = Look(SimpleNamespace(effects=()))
    EffectSearch.add_refits(loop, [(SimpleNamespace(cost=100.0), look)])
    assert ("look" in fits.carried) == goes_on and ("carried" in added) == goes_on
    assert "absent" in added


def test_a_part_that_another_needs_does_not_keep_the_others_in_place():
    """A curve over the state of a hysteresis has no place without it."""

    def refit_without(fit, name):
        if name == "hysteresis":
            raise ModelError("the curve has no variable")
        return SimpleNamespace(effects=("hysteresis",), cost=2.0)

    failures, added = FailureLog(), []
    problem = SimpleNamespace(failures=failures, refit_without=refit_without)
    loop = SimpleNamespace(problem=problem, table=SimpleNamespace(add=added.append), baseline=SimpleNamespace(cost=1.0))
    EffectSearch.drop_parts(loop, SimpleNamespace(effects=("hysteresis", "curve")))
    assert [fit.effects for fit in added] == [("hysteresis",)]
    assert failures.find(SearchStage.EVIDENCE, ("curve",)) is not None


@pytest.mark.parametrize(("left_out", "looked_at"), [(frozenset(), ["drag", "load"]), (frozenset({"creep"}), ["load"])])
def test_the_usual_effects_alone_are_looked_at_for_sets_that_nobody_has_fitted(left_out, looked_at):
    effects = [SimpleNamespace(name=name) for name in ("friction", "drag", "load")]
    fitted = {frozenset({"friction", "drag"}): "a set"}
    asked = []
    loop = SimpleNamespace(
        candidates=effects,
        left_out=left_out,
        problem=SimpleNamespace(executor=SimpleNamespace(is_late=False)),
        table=SimpleNamespace(get=lambda names: fitted.get(frozenset(names))),
        promise=lambda base, left, shapes: (asked.extend(e.name for e in left), (0.0, []))[1],
        _screened=set(),
        _shapes={},
        _root=lambda name: name,
    )
    base = SimpleNamespace(effects=("friction",), model=SimpleNamespace(bound_effects=()), given=())
    EffectSearch._screen(loop, base)
    assert asked == looked_at
    # Once each, fitted or not: what is known comes up no second time.
    EffectSearch._screen(loop, base)
    assert asked == looked_at
    # In the place of an effect those that nobody has fitted are looked at again: there were better ones beside other sets.
    EffectSearch._screen(loop, base, anew=True)
    assert asked == [*looked_at, "load"]


@pytest.mark.parametrize(("effects", "beside"), [(("load", "drag"), ["rest of load", "rest of drag"]), (("load",), [])])
def test_an_answer_of_several_effects_is_held_against_others_in_the_place_of_each(effects, beside):
    """A constant at an input and one at a balance are equals, whichever of them the search has met first."""
    looked_at = []
    loop = SimpleNamespace(
        table=SimpleNamespace(without=lambda _, name: f"rest of {name}"),
        _add_promising=lambda rests, anew: looked_at.extend(rests) if anew else None,
    )
    EffectSearch.add_in_place(loop, SimpleNamespace(effects=effects))
    assert looked_at == beside


@pytest.mark.parametrize(("left", "is_finished"), [(0.0, True), (0.6, False)])
def test_a_set_at_the_noise_of_the_fitted_records_is_not_the_last_where_others_show_more(
    monkeypatch, left, is_finished
):
    monkeypatch.setattr("greybox.discovery.search.excess_autocorrelation", lambda *_: 0.0)
    monkeypatch.setattr("greybox.discovery.search.measure_structure", lambda *_, **__: left)
    monkeypatch.setattr("greybox.discovery.search.is_level_known", lambda _: True)
    loop = SimpleNamespace(
        laws=None, further=False, problem=SimpleNamespace(noise_model=None), table=SimpleNamespace(scores=None)
    )
    fit = SimpleNamespace(effects=("spring",), per_sample=1.0, count=1000)
    assert EffectSearch._is_finished(loop, fit) is is_finished
