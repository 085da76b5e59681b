"""Cases on everyday plants: the twin is the plant of the template, effects are as strong as drawn, and a case can be drawn again."""

from __future__ import annotations

import numpy as np
import pytest

import greybox as gb
from fits.studies.plant_cases import SETUPS, make
from fits.studies.plant_twins import PLANTS, simulate
from greybox.shell.project import find_model

AT_REST = gb.FitOptions(at_rest=True)


@pytest.mark.parametrize("plant", sorted(SETUPS))
def test_the_plain_twin_is_the_model_of_the_template(plant: str) -> None:
    case = make(3, "complete", plant, 400)
    model = find_model(case.model).fix(**case.known).start(**{name: case.base[name] for name in case.start})
    run = gb.validate(model, case.estimation, noise=case.sigma, options=AT_REST)
    assert all(signal.noise_ratio == pytest.approx(1.0, abs=0.15) for signal in run.misfit.values())


@pytest.mark.rest
@pytest.mark.parametrize("plant", sorted(SETUPS))
def test_a_foreign_effect_shows_and_the_case_can_be_drawn_again(plant: str) -> None:
    case, again = (make(11, "foreign", plant, 120) for _ in range(2))
    for name, values in case.validation.outputs.items():
        np.testing.assert_array_equal(values, again.validation.outputs[name])
    assert case.right == tuple((name,) for name in case.effects)
    assert set(case.effects) <= set(SETUPS[plant].foreign)


@pytest.mark.rest
def test_a_body_on_a_dry_slope_comes_to_rest_where_work_and_friction_balance() -> None:
    """A mass without spring or damper, thrown by a force of one sample, slides ``v^2 M / (2 Fc)`` and stays."""
    p = {"M": 2.0, "B": 0.0, "K": 0.0, "Kf": 1.0}
    push, friction, period = 40.0, 5.0, 0.01
    rows = simulate(PLANTS["stage"], p, {"coulomb_friction": {"Fc": friction}}, [[push], *[[0.0]] * 60], period, 500)
    position = np.array(rows)[:, 0]
    acceleration = (push - friction) / p["M"]
    speed = acceleration * period
    expected = 0.5 * speed * period + speed**2 * p["M"] / (2 * friction)
    assert position[-1] == pytest.approx(expected, rel=1e-3)
    assert position[-1] == position[-10]
