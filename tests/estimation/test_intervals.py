"""Intervals against closed forms, published numbers, refits and each other; constants that move; the step's share."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import t as student

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import FitError, ModelError
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation.findings import EstimationCode
from greybox.estimation.fit import fit
from greybox.estimation.options import FitOptions
from greybox.estimation.result import load_fit
from greybox.estimation.sandwich import (
    ResidualColour,
    compute_toeplitz_form,
    estimate_residual_colour,
    give_back,
    sum_scores,
)
from greybox.estimation.uncertainty import bootstrap, profile
from greybox.show import text
from models.emps import emps
from models.micro_actuator import micro_actuator
from tests.oracles.independent import experiment, linear_record, multisine
from tests.support.findings import codes, find
from tests.support.published_plants import PREY, REST, SATURATION, TIMES, VALUES

TRUTH = micro_actuator.fix("M", "Ra")
LEVEL = {"x": 2e-7, "i": 5e-3}


def actuator_record(seed, rho=0.0, rows=1500):
    rng = np.random.default_rng([seed, 1])
    clean = linear_record(TRUTH, multisine(rng, rows, 2.5e-4, 5, 800, 3.0), 2.5e-4)

    def noise():
        return lfilter([1.0], [1.0, -rho], rng.normal(size=rows + 300) * np.sqrt(1 - rho**2))[300:]

    return replace(clean, outputs={n: y + LEVEL[n] * noise() for n, y in clean.outputs.items()})


X1 = [1.0, 0.9978287, 2.366363, 6.448709, 5.225859, 2.617129, 1.324945, 1.071534, 1.058930, 3.189685, 6.790586]
X2 = [1.0, 2.249977, 3.215969, 1.787353, 1.050747, 0.2150848, 0.109813, 1.276422, 2.493237, 3.079619, 1.665567]


def saturation_fit():
    data = Experiment("published", np.append(0.0, TIMES), {}, {"y": np.append(np.nan, VALUES)})
    return fit(SATURATION, data, options=REST)


def test_rooney_and_biegler_constants_and_covariance():
    found = saturation_fit()
    assert found.success
    assert found.parameters["a"].value == pytest.approx(19.1426, abs=1e-4)
    assert found.parameters["b"].value == pytest.approx(0.5311, abs=1e-4)
    assert found.misfit["y"].rmse ** 2 == pytest.approx(4.33171, abs=1e-5)
    a, b = found.parameters["a"].value, found.parameters["b"].value
    decay = np.exp(-b * TIMES)
    slopes = np.column_stack([1 - decay, a * TIMES * decay])
    closed = 6 * found.misfit["y"].rmse ** 2 / 4 * np.linalg.inv(slopes.T @ slopes)
    assert found.uncertainty.covariance == pytest.approx(closed, rel=1e-6)
    assert found.uncertainty.covariance == pytest.approx(np.array([[6.2286, -0.4322], [-0.4322, 0.04124]]), rel=5e-4)
    # Four degrees of freedom: Student's factor, on the logarithm of a positive constant.
    reach = student.ppf(0.975, 4) * np.sqrt(closed[0, 0]) / a
    assert found.parameters["a"].interval == pytest.approx((a * np.exp(-reach), a * np.exp(reach)), rel=1e-6)
    assert found.uncertainty.reach == pytest.approx(student.ppf(0.975, 4), rel=1e-12)
    assert "95 % is 2.78 standard deviations" in " ".join(text(found, details=True).split())


def test_lotka_volterra_constants_converge_and_the_step_is_watched():
    data = Experiment("published", np.arange(11.0), {}, {"x1": np.array(X1), "x2": np.array(X2)})
    noise = {"x1": 0.1, "x2": 0.2}
    fine = fit(PREY, data, noise=noise, options=FitOptions(substeps=64))
    assert fine.parameters["beta"].value == pytest.approx(0.69397111, rel=1e-7)
    assert fine.parameters["delta"].value == pytest.approx(0.34092149, rel=1e-7)
    automatic = fit(PREY, data, noise=noise)
    assert max(automatic.discretisation.error.values()) < 1e-6
    assert automatic.solver.cost == pytest.approx(fine.solver.cost, rel=1e-6)
    rough = fit(PREY, data, noise=noise, options=FitOptions(substeps=4))
    for name in ("beta", "delta"):
        assert automatic.parameters[name].value == pytest.approx(fine.parameters[name].value, rel=1e-7)
        step = abs(rough.parameters[name].value - fine.parameters[name].value)
        # What is left of the step's error is what halving the step announces (RK4: 15 of 16 parts of it).
        assert step / fine.parameters[name].std == pytest.approx(rough.discretisation.shift[name], rel=0.15)
        assert rough.discretisation.shift[name] < 0.01
    coarse = fit(PREY, data, noise=noise, options=FitOptions(substeps=1))
    assert max(coarse.discretisation.shift.values()) > 0.1
    assert EstimationCode.STEP_MOVES_PARAMETERS in codes(coarse.findings)


def test_the_toeplitz_form_is_that_of_the_dense_matrix():
    rng = np.random.default_rng(1)
    columns, rho = rng.normal(size=(137, 4)), 0.8 ** np.arange(137)
    assert compute_toeplitz_form(columns, rho) == pytest.approx(columns.T @ toeplitz(rho) @ columns, rel=1e-10)


@pytest.mark.parametrize("reach", [3, 40, 250])
@pytest.mark.parametrize("rows", [300, 997])
def test_the_form_of_a_long_record_is_summed_in_blocks(monkeypatch, reach, rows):
    monkeypatch.setattr("greybox.estimation.sandwich.NUMBERS_AT_A_TIME", 400)
    columns = np.random.default_rng(2).normal(size=(rows, 3))
    rho = np.where(np.arange(rows) <= reach, np.cos(0.1 * np.arange(rows)) * np.exp(-np.arange(rows) / reach), 0.0)
    assert compute_toeplitz_form(columns, rho) == pytest.approx(
        columns.T @ toeplitz(rho) @ columns, rel=1e-10, abs=1e-10
    )
    fading = 0.9 ** np.arange(rows)
    assert compute_toeplitz_form(columns, fading) == pytest.approx(columns.T @ toeplitz(fading) @ columns, rel=1e-10)


@pytest.mark.rest
def test_the_sandwich_widens_the_interval_by_what_the_colour_costs():
    """Spread of the constants over many records of AR(1) noise, against the stated standard deviation."""
    fits = [fit(TRUTH, actuator_record(seed, 0.9)) for seed in range(20)]
    assert all(f.uncertainty.kind == "sandwich" for f in fits)
    for q in TRUTH.free_parameters:
        z = [(f.parameters[q.name].value - q.value) / f.parameters[q.name].std for f in fits]
        assert 0.7 < np.std(z) < 1.35, q.name
    assert 2 < max(fits[0].uncertainty.inflation.values()) < 4
    inflation = find(fits[0].findings, EstimationCode.RESIDUAL_CORRELATED).values["inflation"]
    assert inflation == max(fits[0].uncertainty.inflation.values())
    white = fit(TRUTH, actuator_record(3))
    assert white.uncertainty.kind == "gauss_newton" and set(white.uncertainty.inflation.values()) == {1.0}


def test_the_profile_is_that_of_refits_by_scipy():
    found = saturation_fit()
    seen = profile(found, "b")

    def least(b):
        # Between the bounds of the model, which a slow rate meets.
        return (
            2 * least_squares(lambda a: VALUES - a * (1 - np.exp(-b * TIMES)), [19.0], bounds=(1, 100), xtol=1e-12).cost
        )

    scale = 6 * found.misfit["y"].rmse ** 2 / 4
    for value, rise in zip(seen.values, seen.increase, strict=True):
        assert rise == pytest.approx((least(value) - least(seen.best)) / scale, rel=1e-3, abs=1e-5)
    assert seen.threshold == pytest.approx(student.ppf(0.975, 4) ** 2)
    for end in seen.interval:
        assert (least(end) - least(seen.best)) / scale == pytest.approx(seen.threshold, rel=0.02)


def test_a_profile_that_never_rises_is_open_and_ends_at_the_bound():
    data = Experiment("early", np.linspace(0, 0.2, 30), {}, {"y": 2.0 * np.linspace(0, 0.2, 30)})
    noisy_data = replace(data, outputs={"y": data.outputs["y"] + 0.02 * np.random.default_rng(1).normal(size=30)})
    found = fit(SATURATION, noisy_data, noise={"y": 0.02}, options=REST)
    seen = profile(found, "a")
    assert seen.interval[1] == 100.0 and seen.open_sides[1]


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_profile_bootstrap_and_curvature_agree_where_the_model_is_nearly_linear(rho):
    found = fit(TRUTH, actuator_record(3, rho))
    again = bootstrap(found, np.random.default_rng(2), replicates=600)
    for name in ("K", "La"):
        stated = found.parameters[name]
        width = stated.interval[1] - stated.interval[0]
        assert profile(found, name).interval == pytest.approx(stated.interval, abs=0.05 * width)
        assert again.std[name] == pytest.approx(stated.std, rel=0.3 if rho else 0.12)
        assert again.interval[name] == pytest.approx(stated.interval, abs=(0.2 if rho else 0.12) * width)
    assert again.block > (50 if rho else 5)


def test_the_bootstrap_repeats_with_its_generator_and_respects_bounds():
    found = fit(TRUTH.bound(Kv=(1.0, 1.42)), actuator_record(3))
    one, two = (bootstrap(found, np.random.default_rng(5), replicates=50) for _ in range(2))
    assert np.array_equal(one.samples, two.samples)
    assert one.interval["Kv"][1] <= 1.42 and found.parameters["Kv"].interval[1] <= 1.42
    with pytest.raises(FitError, match="blocks of 1000 rows from a record of 1500"):
        bootstrap(found, np.random.default_rng(5), block=1000)


def test_intervals_survive_saving(tmp_path):
    found = fit(TRUTH, actuator_record(3, 0.9))
    again = load_fit(found.save(tmp_path / "fit.json"), TRUTH)
    assert profile(again, "K").interval == profile(found, "K").interval
    assert again.uncertainty.kind == "sandwich" and again.uncertainty.inflation == found.uncertainty.inflation
    assert again.uncertainty.reach == found.uncertainty.reach


def test_bad_requests_are_refused_in_words():
    found = saturation_fit()
    with pytest.raises(ModelError, match="profile of 'M': not a fitted parameter"):
        profile(found, "M")
    broken = replace(found, solver=replace(found.solver, success=False))
    with pytest.raises(FitError, match="intervals need a fit that has succeeded"):
        profile(broken, "a")


def test_a_constant_that_imitates_a_missing_effect_is_named():
    """Friction grows between two experiments; the model has one friction for both."""
    t = np.arange(3000) * 1e-3
    u = 2.5 * np.sin(2 * np.pi * 0.5 * t) + np.sin(2 * np.pi * 1.7 * t)
    noise = {"q": 1e-5}
    first, second = (
        linear_record(emps.start(Fv=v), u, 1e-3, noise=noise, seed=s, name=f"day {s}")
        for s, v in ((1, 200.0), (2, 215.0))
    )
    found = fit(emps, [first, second], noise=noise)
    shifts = find(found.findings, EstimationCode.PARAMETER_NOT_CONSTANT).values["shifts"]
    (friction,) = [shift for shift in shifts if shift["name"] == "Fv"]
    assert friction["before"] == pytest.approx(200, abs=1) and friction["after"] == pytest.approx(215, abs=1)
    assert friction["parts"] == ["experiment:'day 1'", "experiment:'day 2'"]
    again = linear_record(emps.start(Fv=200.0), u, 1e-3, noise=noise, seed=3, name="again")
    same = fit(emps, [first, again], noise=noise)
    assert EstimationCode.PARAMETER_NOT_CONSTANT not in codes(same.findings)


def test_a_constant_held_by_its_bound_in_both_parts_does_not_move():
    """A record off by a factor of 1000 drives constants into their bounds."""
    rng = np.random.default_rng(0)
    clean = linear_record(TRUTH, multisine(np.random.default_rng(1), 200, 2.5e-4, 5, 400, 2.0), 2.5e-4)
    x, i = (clean.outputs[n] + LEVEL[n] * rng.normal(size=200) for n in ("x", "i"))
    found = fit(TRUTH, replace(clean, outputs={"x": 1e-3 * x, "i": i}))
    shifts = find(found.findings, EstimationCode.PARAMETER_NOT_CONSTANT).values["shifts"]
    assert shifts and all(shift["before"] != shift["after"] for shift in shifts)


@pytest.mark.parametrize("voltage", [6.0, -6.0, 9.0])
def test_a_step_does_not_tell_friction_from_back_emf_and_gives_neither_a_value(voltage):
    """A ramp determines both; a step that the model fits badly shows one speed only: V = Fc sign(w) + kV w."""
    drive = Model(
        "drive",
        [State("w", "rad/s", role="velocity")],
        [Input("V", "V")],
        [Output("w", "rad/s")],
        [
            Parameter("kV", "V*s/rad", 2.0, (1e-3, 100)),
            Parameter("kA", "V*s^2/rad", 0.3, (1e-3, 100)),
        ],
        lambda x, u, p: [Balance("volts", "V", p.kA, "w", applied=u.V, emf=-p.kV * x.w)],
    )
    rng = np.random.default_rng(4)

    def run(name, volts, speed):
        y = speed + 0.003 * rng.normal(size=len(volts))
        return gb.Experiment.from_arrays(0.02 * np.arange(len(volts)), {"V": volts}, {"w": y}, name=name)

    t = 0.02 * np.arange(700)
    ramp = np.where(t > 1, 0.6 + 0.5 * (t - 1), 0.0)
    # dw/dt = (V - Fc - kV w) / kA with V = Fc + 0.5 (t - 1): a straight rise behind a lag of kA/kV.
    lag, s = 0.3 / 2.0, np.maximum(t - 1, 0)
    rise = 0.25 * (s - lag * (1 - np.exp(-s / lag)))
    step = np.full(100, voltage)
    late = np.maximum(0.02 * np.arange(100) - 0.01, 0)  # half a row late
    fast = np.sign(voltage) * (abs(voltage) - 0.6) / 2 * (1 - np.exp(-late / lag))
    found = fit(
        drive + gb.effect("coulomb_friction"), [run("ramp", ramp, rise), run("step", step, fast)], noise={"w": 0.003}
    )
    shifts = [s for f in found.findings if f.code == EstimationCode.PARAMETER_NOT_CONSTANT for s in f.values["shifts"]]
    low = {"kV": 1.0, "kA": 0.1, "Fc": 0.3}
    assert all(s["before"] is None or min(s["before"], s["after"]) > low[s["name"]] for s in shifts)
    assert any(s["parts"] == ["experiment:'ramp'", "experiment:'step'"] for s in shifts)


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_constant_constants_raise_no_alarm(rho):
    fits = [fit(TRUTH, actuator_record(seed, rho)) for seed in range(60)]
    alarms = [EstimationCode.PARAMETER_NOT_CONSTANT in codes(found.findings) for found in fits]
    assert sum(alarms) <= 3


@pytest.mark.slow
def test_emps_intervals_admit_both_estimators_and_the_alias_is_raised(shared_data):
    rubbing = emps + gb.effect("coulomb_friction") + gb.effect("constant_load")
    found = fit(rubbing, gb.read_csv(shared_data / "emps" / "train.csv", rubbing))
    low, high = found.parameters["M"].interval
    assert low < 90.2 and high > 95.1, "free run and inverse dynamics differ by 5 kg"
    assert found.uncertainty.kind == "sandwich" and found.uncertainty.inflation["M"] > 10
    shifts = find(found.findings, EstimationCode.PARAMETER_NOT_CONSTANT).values["shifts"]
    assert "F0" in [shift["name"] for shift in shifts]


def test_gaps_and_irregular_time_keep_the_intervals_honest():
    rng = np.random.default_rng(5)
    rows = np.append(0, np.cumsum(rng.integers(20, 31, 499)))  # of a grid of 10 us, over which the input is held
    time = rows * 1e-5
    u = 2 * np.sign(np.sin(2 * np.pi * 60 * time)) + rng.normal(0, 0.5, len(time))
    fine = linear_record(TRUTH, np.repeat(u, np.append(np.diff(rows), 1)), 1e-5)
    clean = {n: y[rows] for n, y in fine.outputs.items()}
    z = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        noise = {n: LEVEL[n] * lfilter([1.0], [1.0, -0.8], rng.normal(size=800) * 0.6)[300:] for n in LEVEL}
        y = [np.where(rng.random(500) < 0.2, np.nan, clean[n] + noise[n]) for n in ("x", "i")]
        found = fit(
            TRUTH,
            experiment(TRUTH, time, u[:, None], np.column_stack(y)),
            noise=LEVEL,
            options=FitOptions(at_rest=True, substeps=4),
        )
        assert found.uncertainty.kind == "sandwich"
        z += [(found.parameters[q.name].value - q.value) / found.parameters[q.name].std for q in TRUTH.free_parameters]
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5


class Shared:
    """All unknowns concern the one record."""

    size = 3

    def columns(self, experiment: int) -> np.ndarray:
        return np.arange(3)


def test_slow_noise_that_the_constants_have_followed_is_given_back() -> None:
    """Known noise behind a regression on slow columns: what its residual shows of size and colour is too little, and is set right."""
    rows, rho = 400, 0.95
    t = np.linspace(-1, 1, rows)
    slopes = np.stack([np.ones(rows), t, np.sin(3 * t)], axis=1)
    inverse = np.linalg.inv(slopes.T @ slopes)
    seen, found = [], []
    for seed in range(100):
        shock = np.sqrt(1 - rho**2) * np.random.default_rng(seed).normal(size=rows + 500)
        noise = lfilter([1.0], [1.0, -rho], shock)[500:]
        data = [((noise - slopes @ inverse @ slopes.T @ noise)[:, None], slopes[:, None])]
        colour = estimate_residual_colour(data, 3, False)
        behind = give_back(Shared(), data, colour, sum_scores(Shared(), data, colour), inverse)
        for colours, each in ((seen, colour), (found, behind)):
            if colour.coloured:
                colours.append((each.models[0].autocorrelation(2)[1], each.variance[0]))
    (raw, small), (right, whole) = np.mean(seen, axis=0), np.mean(found, axis=0)
    assert raw < rho - 0.02 and small < 0.8
    assert abs(right - rho) < 0.01 and abs(whole - 1) < 0.1


@pytest.mark.parametrize(("rho", "rows"), [(0.5, 400), (0.9, 1000), (-0.9, 1000), (0.95, 3000)])
def test_degrees_are_those_of_the_scatter_of_the_loudest_frequency(rho: float, rows: int) -> None:
    logarithms, degrees = [], []
    for seed in range(200):
        noise = lfilter([1.0], [1.0, -rho], np.random.default_rng(seed).normal(size=rows + 500))[500:]
        # The largest value of the spectrum, by the least squares of one row on the one before.
        slope = noise[1:] @ noise[:-1] / (noise[:-1] @ noise[:-1])
        error = noise[1:] - slope * noise[:-1]
        logarithms.append(np.log(error @ error / rows) - 2 * np.log(1 - abs(slope)))
        degrees.append(ResidualColour((AutoRegression((rho,)),), (1.0,), (rows,)).degrees)
    assert np.sqrt(2 / degrees[0]) == pytest.approx(np.std(logarithms), rel=0.2)


def test_a_white_residual_has_as_many_degrees_as_samples() -> None:
    assert ResidualColour((AutoRegression(),) * 2, (1.0, 1.0), (40, 60)).degrees == 100
