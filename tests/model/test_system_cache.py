"""A model with other numbers has the same equations: they are not written out again, and are what they would be."""

from __future__ import annotations

from dataclasses import fields, replace

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox.effects import applicable_effects
from greybox.errors import ModelError, UnitError
from greybox.model import Model, Rule
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder


def anew(model: Model) -> Model:
    """The same model, stated and checked from the beginning."""
    return type(model)(**{f.name: getattr(model, f.name) for f in fields(model) if f.init})


def rates(model: Model) -> np.ndarray:
    """Every expression of the model at one point of states, inputs and constants."""
    s = model.system
    f = ca.Function(
        "f", [s.x, s.u, s.p, s.direction], [ca.vertcat(*s.free_run_expressions, s.explicit, s.diffusion, s.storages)]
    )
    x, u = 0.3 + 0.1 * np.arange(s.x.numel()), 0.2 + np.arange(s.u.numel())
    return f(x, u, list(model.values.values()), 0.5).full().ravel()


@pytest.mark.parametrize("plant", [micro_actuator, pneumatic_cylinder], ids=lambda m: m.name)
def test_every_effect_of_the_catalogue_added_twice_is_the_model_stated_anew(plant: Model) -> None:
    plain = anew(plant)
    for entry in applicable_effects(plain):
        first = plain + entry
        moved = first.start(**{q.name: 1.1 * q.value for q in first.parameters[:2]})
        q = entry.parameters[0]
        again = plain.start(**{plain.parameters[0].name: moved.values[plain.parameters[0].name]}) + replace(
            entry, parameters=(replace(q, value=0.5 * (q.value + min(q.bounds[1], 2 * q.value))), *entry.parameters[1:])
        )
        assert (again.system is first.system) == (not first.system.delays)
        for model in (first, moved, again):
            other = anew(model)
            assert model.values == other.values
            assert model.all_parameters == other.all_parameters
            assert model.noisy_states == other.noisy_states
            assert [b.own for b in model.bound_effects] == [b.own for b in other.bound_effects]
            np.testing.assert_array_equal(rates(model), rates(other), err_msg=model.title)


def test_an_effect_of_the_same_name_with_another_equation_is_another_effect() -> None:
    entry = gb.effect("cubic_stiffness")
    base = anew(micro_actuator)
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
