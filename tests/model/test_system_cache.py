"""Models with the same statement share one system, and it is what writing the equations out again would give."""

from __future__ import annotations

import copy
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import ModelError, UnitError
from greybox.model.build_system import SystemCache, build_checked_system
from greybox.model.effects.catalogue import applicable_effects
from greybox.model.model import Model
from greybox.model.signals import Parameter
from greybox.model.system import System
from greybox.model.validation import Rule
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder


def rates(model: Model, system: System | None = None) -> np.ndarray:
    """Every expression of the model at one point of states, inputs and parameters."""
    s = system or model.system
    f = ca.Function(
        "f", [s.x, s.u, s.p, s.direction], [ca.vertcat(*s.free_run_expressions, s.explicit, s.diffusion, s.storages)]
    )
    x, u = 0.3 + 0.1 * np.arange(s.x.numel()), 0.2 + np.arange(s.u.numel())
    return f(x, u, list(model.values.values()), 0.5).full().ravel()


@pytest.mark.rest
@pytest.mark.parametrize("plant", [micro_actuator, pneumatic_cylinder], ids=lambda m: m.name)
def test_models_that_differ_in_numbers_share_the_system_that_would_be_built(plant: Model) -> None:
    for entry in (e for e in applicable_effects(plant) if e.parameters):
        first = plant + entry
        moved = first.start(**{q.name: 1.1 * q.value for q in first.parameters[:2]})
        q = entry.parameters[0]
        again = plant.start(**{plant.parameters[0].name: moved.values[plant.parameters[0].name]}) + replace(
            entry, parameters=(replace(q, value=0.5 * (q.value + min(q.bounds[1], 2 * q.value))), *entry.parameters[1:])
        )
        for model in (first, moved, again):
            assert model.system is first.system
            built = build_checked_system(model.statement)
            assert built.states == model.system.states
            assert [e.model_names for e in built.effects] == [b.model_names for b in model.bound_effects]
            np.testing.assert_array_equal(rates(model), rates(model, built), err_msg=model.title)


def test_other_states_units_or_ties_are_another_system() -> None:
    plain = micro_actuator
    spare = Parameter("spare", "N", 1.0)
    for other in (
        replace(plain, name="another"),
        replace(plain, parameters=(*plain.parameters, spare)),
        plain.with_process_noise("v"),
        plain.tie(Kv="Kf"),
    ):
        assert other.system is not plain.system
    assert replace(plain, description="told otherwise").fix("M").prior(K=(100.0, 1.0)).system is plain.system


def test_a_cache_keeps_the_systems_that_were_used_last() -> None:
    cache = SystemCache(size=2)
    statements = [replace(micro_actuator, name=name).statement for name in ("a", "b", "c")]
    first = cache.system(statements[0])
    assert cache.system(statements[0]) is first
    cache.system(statements[1])
    cache.system(statements[2])
    assert len(cache) == 2
    assert cache.system(statements[0]) is not first
    cache.clear()
    assert len(cache) == 0


def test_a_copy_of_a_model_finds_its_system() -> None:
    assert copy.copy(micro_actuator).system is micro_actuator.system


def test_an_effect_of_the_same_name_with_another_equation_is_another_effect() -> None:
    entry = gb.effect("cubic_stiffness")
    base = micro_actuator
    twice = replace(entry, terms=lambda x, u, p: 2 * entry.terms(x, u, p))
    one, two = base + entry, base + twice
    assert one.system is not two.system
    one, two = (m.start(K3=1e6) for m in (one, two))
    plain, single, double = rates(base)[1], rates(one)[1], rates(two)[1]
    assert double - plain == pytest.approx(2 * (single - plain)) != 0
    with pytest.raises(UnitError):
        base + replace(entry, terms=lambda x, u, p: x.v + entry.terms(x, u, p))


def test_an_effect_is_refused_twice_and_rules_are_asked_again() -> None:
    entry = gb.effect("coulomb_friction")
    with pytest.raises(ModelError, match="already has"):
        micro_actuator + entry + entry
    rule = Rule("mass below ten grams", "kg", lambda p: 0.01 - p.M, "give another mass")
    light = replace(micro_actuator.start(M=0.005), rules=(rule,))
    with pytest.raises(ModelError, match="mass below ten grams"):
        light.start(M=0.02)
    with pytest.raises(ModelError, match="mass below ten grams"):
        (light + entry).fix(M=0.02)


def test_the_longest_delay_follows_the_bounds() -> None:
    late = micro_actuator + gb.effect("transport_delay")
    name = gb.effect("transport_delay").parameters[0].name
    shorter = late.bound(**{name: (0.0, 2e-4)})
    assert shorter.system.delays[0].longest == pytest.approx(2e-4)
    assert late.system.delays[0].longest > 2e-4
    assert late.start(**{name: 1e-4}).system is late.system
    assert late.fix(**{name: 1e-4}).system.delays[0].longest == pytest.approx(1e-4)
