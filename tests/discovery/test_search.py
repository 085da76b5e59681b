"""The loop of a search on records of a mass on a spring: what it tries, what it leaves alone, and that what wins is the answer."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.discovery.candidates import estimate_scales, list_candidates
from greybox.discovery.conclusion import leave_out_small
from greybox.discovery.holdout import HoldoutScores, ValidationSet
from greybox.discovery.linear import EffectPromise
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.search import EffectSearch, StepKind
from greybox.discovery.table import FitTable
from tests.support.stage import STAGE

NOISE = 2e-5
# Whole searches.
pytestmark = pytest.mark.rest
NAMES = ("coulomb_friction", "stribeck_friction", "cubic_stiffness", "input_offset", "sensor_lag")


def record(seed, hidden):
    rng = np.random.default_rng(seed)
    time, force = 5e-3 * np.arange(160), np.repeat(rng.normal(0, 6, 16), 10)
    model = STAGE
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


class Fits:
    """Refits of sets whose ends are known: those of a look, from the absent effect, and of a look that goes on."""

    def __init__(self, **ends):
        self.ends, self.carried = ends, []

    def refit_all(self, jobs):
        return [self.ends[job] for job in jobs if job is not None]

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
    EffectSearch.add_refits(loop, [(SimpleNamespace(cost=100.0), "look")])
    assert ("look" in fits.carried) == goes_on and ("carried" in added) == goes_on
    assert "absent" in added


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
