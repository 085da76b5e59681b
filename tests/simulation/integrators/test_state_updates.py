"""Play: a state that is set after each step, against the play operator evaluated densely; and everything at once."""

import casadi as ca
import numpy as np
import pytest

from greybox import Balance, Effect, Parameter, State
from greybox.base.errors import ModelError, UnitError
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.integrators.runge_kutta import rk4
from tests.support.stepping import (
    KERNELS,
    bouc_wen,
    delay,
    differences,
    orders,
    oscillator,
    path,
    play,
    record,
    slopes,
    stribeck,
    values,
)

PUSH = 12 * np.sin(0.21 * np.arange(160))


def operator(positions, gap, start):
    """The play operator over densely given positions."""
    w, found = start, []
    for s in positions:
        w = min(max(w, s - gap), s + gap)
        found.append(w)
    return np.array(found)


def test_play_is_the_play_operator_on_the_motion():
    model = oscillator() + play(0.02)
    step, p = rk4(model.system, 2), values(model)
    y, x = path(step, record(PUSH, 0.05), p, [0.0, 0.0, 0.0])
    dense = path(rk4(model.system, 2), record(np.repeat(PUSH, 1), 0.05), p, [0.0, 0.0, 0.0])[1][:, 0]
    fine = path(rk4(oscillator().system, 1), record(np.repeat(PUSH, 200), 0.05 / 200), p[:3], [0.0, 0.0])[1][:, 0]
    exact = operator(fine, 0.02, 0.0)[::200]
    assert np.array_equal(y[:, 0], x[:, 2])
    assert np.allclose(dense, fine[::200], atol=1e-4)
    assert np.mean(np.diff(exact) == 0.0) > 0.02  # the play is crossed now and then
    errors = [
        np.abs(path(rk4(model.system, n), record(PUSH, 0.05), p, np.zeros(3))[0][:, 0] - exact).max()
        for n in (2, 4, 8, 16)
    ]
    assert orders(errors).mean() > 1.7, errors  # reversals inside a substep
    assert errors[-1] < 2e-5


def test_play_is_exact_while_the_motion_keeps_its_direction():
    model = oscillator(K=1e-9, B=1e-9) + play(0.3)
    y, x = path(rk4(model.system), record(np.ones(40), 0.1), values(model), [0.0, 0.5, 0.0])
    assert np.allclose(y[:, 0], np.maximum(x[:, 0] - 0.3, 0), rtol=1e-14, atol=1e-14)
    assert y[0, 0] == 0.0
    assert y[-1, 0] > 1


@pytest.mark.parametrize("kernel", KERNELS)
def test_slopes_through_play_are_those_of_finite_differences(kernel):
    model = oscillator() + play(0.02)
    step, p, x0 = rk4(model.system, 2), values(model), [0.05, 0.0, 0.04]
    jacobian = slopes(step, record(PUSH, 0.05), p, x0, kernel)
    for k in range(len(p)):
        difference = differences(step, record(PUSH, 0.05), p, x0, k)
        assert np.allclose(jacobian[:, :, k], difference, rtol=1e-4, atol=1e-6 * np.abs(difference).max())


def test_no_gap_is_no_play():
    model = oscillator() + play(0.0)
    y, x = path(rk4(model.system), record(PUSH, 0.05), values(model), np.zeros(3))
    assert np.array_equal(y[:, 0], x[:, 0])


def test_a_model_with_play_is_not_linear():
    model = oscillator() + play()
    assert not model.system.linear
    assert discretise(model.system, values(model), np.zeros((1, 3)), np.array([0.05])).name == "RK4"


def everything():
    """Delay, dry friction, hysteresis and play in one model."""
    return oscillator() + bouc_wen() + stribeck(1.0, 2.0, 0.1) + play(0.01) + delay(0.2, 0.07)


@pytest.mark.rest
def test_delay_dry_friction_relaxing_states_and_play_work_together():
    model = everything()
    p = values(model)
    found = [
        path(
            discretise(model.system, p, np.zeros((1, 4)), np.array([0.05]), substeps=n),
            record(PUSH, 0.05),
            p,
            np.zeros(4),
        )[1]
        for n in (8, 16, 32, 256)
    ]
    errors = [np.abs(x - found[-1])[:, [0, 3]].max() for x in found[:-1]]
    assert errors[-1] < 1e-4 * np.abs(found[-1][:, 0]).max()
    assert errors[0] > 4 * errors[-1]
    assert np.mean(found[-1][:, 1] == 0.0) > 0.01  # it sticks
    assert np.mean(np.diff(found[-1][:, 3]) == 0.0) > 0.01  # the play is crossed


@pytest.mark.rest
def test_both_kernels_run_everything_alike():
    model = everything()
    step, p = discretise(model.system, values(model), np.zeros((1, 4)), np.array([0.05]), substeps=4), values(model)
    runs = [path(step, record(PUSH, 0.05), p, np.zeros(4), kernel)[1] for kernel in KERNELS]
    assert np.allclose(*runs, rtol=1e-9, atol=1e-12)
    jacobians = [slopes(step, record(PUSH, 0.05), p, np.zeros(4), kernel) for kernel in KERNELS]
    assert np.allclose(*jacobians, rtol=1e-6, atol=1e-9 * np.abs(jacobians[0]).max())


def changed(**hooks):
    return oscillator() + Effect(
        "play", "sensor", [Parameter("gap", "{sensor}", 0.1, (0, 1))], states=[State("w", "{sensor}")], **hooks
    )


def test_an_update_that_cannot_be_is_refused():
    with pytest.raises(ModelError, match=r"sets 'v', which is not a state of its own; known: w"):
        changed(update=lambda x, u, p: {"v": x.v}).system  # noqa: B018
    with pytest.raises(UnitError, match=r"update of state 'w': has unit m/s, expected m"):
        changed(update=lambda x, u, p: {"w": x.v}).system  # noqa: B018
    with pytest.raises(ModelError, match=r"sets the state 'w' after each step, but balance 'play.w' gives its rate"):
        changed(update=lambda x, u, p: {"w": x.x}, balances=lambda x, u, p: [Balance("w", "m/s", 1, "w", a=x.v)]).system  # noqa: B018
    with pytest.raises(ModelError, match=r"no balance gives the rate of 'w'"):
        changed().system  # noqa: B018


def test_the_equations_show_what_is_set():
    model = changed(update=lambda x, u, p: {"w": ca.fmax(x.w, x.x - p.gap)})
    assert "after a step" in str(model)
    assert "w becomes max(w, x - gap)" in str(model)
