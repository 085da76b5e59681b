"""Twins make the same run, by integrators that are not greybox; models that have none get none."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from greybox import Balance, FitOptions, Input, Model, Output, Parameter, State, fit
from greybox.data.experiment import Experiment
from greybox.estimation.check import check
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode
from greybox.estimation.identifiability.transfer_functions import PolynomialValues, transfer_function_coefficients
from greybox.estimation.identifiability.twins import Twin, find_twins
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.simulation.simulate import simulate
from models.emps import emps
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record
from tests.support.exchange_plants import (
    absorption,
    concentration,
    parallel_lags,
    positive,
    softened_lags,
    three_lags,
    two_lags,
    two_lags_record,
)
from tests.support.findings import find

REST = FitOptions(at_rest=True)
TIME = 0.05 * np.arange(400)
LEVELS = np.repeat(np.random.default_rng(0).uniform(0, 2, 40), 10)


def twins_of(model: Model, *, rest: bool = True, time: np.ndarray = TIME) -> list[Twin]:
    record = simulate(model, {"time": time, **{i.name: LEVELS for i in model.inputs}}).record(
        {}, np.random.default_rng(0)
    )
    noise = {name: 0.01 * float(np.std(y)) for name, y in record.outputs.items()}
    return list(find_twins(prepare_problem(model, record, noise, FitOptions(at_rest=rest))))


def test_flip_flop_has_the_volume_change_with_the_rates():
    (twin,) = twins_of(absorption(1.8, 0.055, 0.37))
    assert twin.values == pytest.approx({"ka": 0.055, "ke": 1.8, "V": 0.37 * 0.055 / 1.8}, rel=1e-6)
    assert (twin.pairs, twin.others, twin.told_by) == ((("ka", "ke"),), ("V",), ("depot",))
    here, there = (
        concentration(TIME, 1.8, 0.055, 0.37),
        concentration(TIME, *(twin.values[n] for n in ("ka", "ke", "V"))),
    )
    assert there == pytest.approx(here, abs=1e-6)


def test_what_moves_with_rates_that_are_nearly_equal_belongs_to_them():
    """They are asked where they are apart: the volume there is another one."""
    (twin,) = twins_of(absorption(0.40, 0.42, 0.37))
    assert twin.values == pytest.approx({"ka": 0.42, "ke": 0.40, "V": 0.37 * 0.42 / 0.40}, rel=1e-6)


def test_a_sensor_or_a_bound_decides():
    assert twins_of(absorption(1.8, 0.055, 0.37, depot_measured=True)) == []
    assert twins_of(absorption(1.8, 0.055, 0.37).bound(ka=(0.1, 50.0))) == []
    assert twins_of(absorption(1.8, 0.055, 0.37).fix("V")) == []


@pytest.mark.parametrize("rest", [True, False])
def test_three_lags_have_five_twins(rest):
    taus = (0.5, 1.5, 0.9)
    found = twins_of(three_lags(*taus), rest=rest)
    values = {tuple(round(twin.values.get(f"tau{k + 1}", taus[k]), 4) for k in range(3)) for twin in found}
    assert values == {*itertools.permutations(taus)} - {taus}
    # Each lag is of one kind: any of the twins is a run of the same transfer function.
    assert all(pair in [("tau1", "tau2"), ("tau1", "tau3"), ("tau2", "tau3")] for twin in found for pair in twin.pairs)


def test_parallel_lags_change_places_with_their_gains():
    (twin,) = twins_of(parallel_lags(2.0, 0.5, 0.7, 1.5))
    assert twin.values == pytest.approx({"k1": 0.7, "tau1": 1.5, "k2": 2.0, "tau2": 0.5}, rel=1e-6)
    assert {*twin.pairs} == {("k1", "k2"), ("tau1", "tau2")} and not twin.others


def test_another_root_is_a_twin_without_an_exchange():
    model = Model(
        "square",
        [State("y", "1", 1.0)],
        [],
        [Output("y", "1")],
        [Parameter("q", "1", 1.8, (-3.0, 5.0)), Parameter("rate", "1/s", 1.0, fixed=True)],
        lambda x, u, p: [Balance("loss", "1/s", 1, "y", loss=-p.rate * (p.q - 1) ** 2 * x.y)],
    )
    (twin,) = twins_of(model)
    # (q - 1)^2 = 0.64 at 1.8 and at 0.2
    assert twin.values == pytest.approx({"q": 0.2}) and twin.pairs == ()
    assert twins_of(model.bound(q=(1.0, 5.0))) == []


def test_a_nonlinear_model_is_run_with_its_constants_exchanged():
    model = softened_lags(0.5, 1.5, 2.0)
    assert not model.system.linear
    (twin,) = twins_of(model)
    assert twin.pairs == (("tau1", "tau2"),) and not twin.others
    # With the gain over one lag instead the gain follows.
    ends = []
    for tau1, tau2, gain in ((0.5, 1.5, 2.0), (1.5, 0.5, 2.0)):

        def rates(t, x, tau1=tau1, tau2=tau2, gain=gain):
            u = LEVELS[min(int(t / 0.05), len(LEVELS) - 1)]
            return [(np.sin(u) - x[0]) / tau1, (x[0] * gain - x[1]) / tau2]

        ends.append(solve_ivp(rates, (0, 5), [0, 0], rtol=1e-8, atol=1e-10, max_step=0.01).y[1, -1])
    assert ends[0] == pytest.approx(ends[1], rel=1e-4)


def test_a_nonlinear_flip_flop_has_its_volume_follow():
    def balances(x, u, p):
        return [
            Balance("gut", "mg/s", 1, "depot", dose=u.u * abs(u.u) / p.one, absorbed=-p.ka * x.depot),
            Balance("blood", "mg/(l*s)", 1, "c", absorbed=p.ka * x.depot / p.V, cleared=-p.ke * x.c),
        ]

    model = Model(
        "bolus",
        [State("depot", "mg"), State("c", "mg/l")],
        [Input("u", "mg/s")],
        [Output("c", "mg/l")],
        [
            positive("ka", "1/s", 2.0),
            positive("V", "l", 0.7),
            positive("ke", "1/s", 0.5),
            Parameter("one", "mg/s", 1.0, fixed=True),
        ],
        balances,
    )
    assert not model.system.linear
    (twin,) = twins_of(model)
    assert twin.values == pytest.approx({"ka": 0.5, "ke": 2.0, "V": 0.7 * 0.5 / 2.0}, rel=1e-4)


def test_equal_constants_are_asked_where_they_are_apart():
    (twin,) = twins_of(two_lags(tau1=0.2, tau2=0.2))
    assert twin.pairs == (("tau1", "tau2"),) and twin.values == pytest.approx({"tau1": 0.2, "tau2": 0.2})
    # A lag that scales the gain as well is no such one, however near its value is to the other's.
    gained = Model(
        "gained",
        [State("v", "V"), State("w", "V")],
        [Input("u", "V")],
        [Output("w", "V")],
        [positive("tau1", "s", 0.2), positive("tau2", "s", 0.2001)],
        lambda x, u, p: [
            Balance("first", "V", p.tau1, "v", drive=u.u * p.tau1 / p.tau2, decay=-x.v),
            Balance("second", "V", p.tau2, "w", feed=x.v, decay=-x.w),
        ],
    )
    assert twins_of(gained) == []


@pytest.mark.parametrize("model", [micro_actuator.fix("M", "Ra"), micro_actuator, emps], ids=lambda m: m.title)
def test_plants_without_a_twin_have_none(model):
    assert twins_of(model, time=TIME * {"micro_actuator": 4e-4, "emps": 0.02}[model.name]) == []


def test_where_directions_are_open_nothing_they_touch_is_a_twin():
    """Of a ladder of two resistors and two capacitors, whose end is seen, two combinations are determined and no constant is."""
    ladder = Model(
        "ladder",
        [State("a", "V"), State("b", "V")],
        [Input("u", "V")],
        [Output("b", "V")],
        [positive("R1", "ohm", 2.0), positive("R2", "ohm", 0.7), positive("C1", "F", 0.5), positive("C2", "F", 1.5)],
        lambda x, u, p: [
            Balance("A", "A", p.C1, "a", left=(u.u - x.a) / p.R1, right=-(x.a - x.b) / p.R2),
            Balance("B", "A", p.C2, "b", left=(x.a - x.b) / p.R2),
        ],
    )
    assert twins_of(ladder) == []


def test_the_coefficients_at_rest_are_those_of_the_response_and_its_start():
    """``C(s) = (4 ka / V) / (s^2 + (ka + ke) s + ka ke)``."""
    model = absorption(1.8, 0.055, 0.37)
    found = PolynomialValues.of(transfer_function_coefficients(model.system, [0], at_rest=True))
    p = np.array([[1.8, 0.055, 0.37], [0.3, 0.2, 2.0]])
    values, slopes = found.at(p, np.arange(3))
    expected = np.column_stack([p[:, 0] + p[:, 1], p[:, 0] * p[:, 1], 4 * p[:, 0] / p[:, 2]])
    assert np.sort(values) == pytest.approx(np.sort(expected))
    step = 1e-6
    for k in range(3):
        moved = p.copy()
        moved[:, k] *= np.exp(step)
        assert (found.at(moved, np.arange(3))[0] - values) / step == pytest.approx(slopes[:, :, k], rel=1e-5, abs=1e-8)


def test_a_check_expects_an_exchange_of_lags_that_start_equal():
    """Their slopes are equal there; a record determines both all the same, as it does where they differ."""
    equal, apart = (check(two_lags(tau1=tau, tau2=0.2), two_lags_record(0.3, 0.1, 0)) for tau in (0.2, 0.3))
    assert equal.complete and apart.complete
    (seen,) = equal.other_answers
    assert seen.values["equal"] and seen.values["exchanged"] == ["tau1", "tau2"]
    assert not apart.other_answers[0].values["equal"]


def test_a_check_and_a_fit_name_the_other_answer():
    time = np.array([0, 0.25, 0.5, 1, 2, 4, 5, 7, 9, 12, 24.0])
    y = concentration(time, 1.8, 0.055, 0.37) + 0.1 * np.random.default_rng(0).standard_normal(len(time))
    record = Experiment("subject", time, {}, {"c": y})
    model = absorption(1.5, 0.08, 0.5)
    (seen,) = check(model, record, noise={"c": 0.1}, options=REST).other_answers
    assert seen.values["exchanged"] == ["ka", "ke"] and seen.values["others"] == ["V"]
    ends = [fit(m, record, noise={"c": 0.1}, options=REST) for m in (model, absorption(0.05, 2.0, 0.05))]
    for one, other in (ends, ends[::-1]):
        twin = find(one.findings, IdentifiabilityCode.OTHER_ANSWER)
        assert twin.values["values"] == pytest.approx(
            {n: other.parameters[n].value for n in ("ka", "ke", "V")}, rel=1e-3
        )
        assert twin.values["told_by"] == ["depot"]
    # A prior has decided.
    decided = fit(model.prior(ka=(1.7, 0.3)), record, noise={"c": 0.1}, options=REST)
    assert find(decided.findings, IdentifiabilityCode.OTHER_ANSWER) is None


def test_the_twin_of_a_second_order_rig_is_run_by_scipy():
    model = parallel_lags(2.0, 0.5, 0.7, 1.5)
    (twin,) = twins_of(model)
    here, there = (linear_record(m, LEVELS, 0.05).outputs["y"] for m in (model, model.start(**twin.values)))
    assert there == pytest.approx(here, abs=1e-9)
