"""The Kalman filter, its slopes, the smoother and predictions against statsmodels, scipy and finite differences."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

from greybox.data.experiment import Experiment
from greybox.model.effects.catalogue import effect
from greybox.simulation.filtering.kalman_filter import KalmanFilter, discretise_process_noise, to_symmetric_arrays
from greybox.simulation.filtering.smoother import predict_outputs, smooth_states
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.records import to_record
from models.micro_actuator import micro_actuator
from models.pneumatic_full import pneumatic_full
from tests.oracles.independent import linear_matrices, multisine, values
from tests.support.filters import NOISE, check_slopes, discrete, filter_of, intensity, tank_record

START = np.array([2e-6, 1e-3, 0.05])
ACTUATOR = micro_actuator.with_process_noise(v=0.5, i=0.2)
KINDS = ("held", "linear", "irregular", "gaps")


def once(steps, model, h):
    """`discrete`, each length once."""
    key = round(h, 12)
    if key not in steps:
        steps[key] = discrete(model, h)
    return steps[key]


def record(kind, rows=300, seed=1, model=ACTUATOR):
    """A record that the model itself makes: inputs, noise on the states and on the outputs."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) * 2.5e-4
    if kind == "irregular":
        time = np.cumsum(rng.choice([2e-4, 2.5e-4, 7e-4], rows))
    u = multisine(rng, rows, 2.5e-4, 5, 800, 3.0)
    *_, c, d, _, _ = linear_matrices(model)
    x, y, steps = START.copy(), [], {}
    for k in range(rows):
        y.append(c @ x + d[:, 0] * u[k] + [NOISE[o.name] * rng.normal() for o in model.outputs])
        if k + 1 < rows:
            phi, early, late, steady, noise = once(steps, model, time[k + 1] - time[k])
            following = u[k + 1] if kind == "linear" else u[k]
            x = phi @ x + early[:, 0] * u[k] + late[:, 0] * following + steady
            x = x + np.linalg.cholesky(noise + 1e-12 * np.diag(np.diag(noise))) @ rng.normal(size=len(x))
    y = np.array(y)
    if kind == "gaps":
        y[rng.random(y.shape) < 0.2] = np.nan
        y[100:130] = np.nan
    outputs = {o.name: y[:, j] for j, o in enumerate(model.outputs)}
    return Experiment("twin", time, {"u": u}, outputs, hold="first" if kind == "linear" else "zero")


def statsmodels_smoother(model, data, x0, covariance):
    """The same record filtered and smoothed by statsmodels, from matrices that scipy made."""
    smoother = pytest.importorskip("statsmodels.tsa.statespace.kalman_smoother")
    rows, nx, ny = data.rows, len(x0), len(model.outputs)
    *_, c, d, _, offset = linear_matrices(model)
    u = data.inputs["u"]
    found = smoother.KalmanSmoother(k_endog=ny, k_states=nx, k_posdef=nx, tolerance=0)
    found.bind(np.column_stack([data.outputs[o.name] for o in model.outputs]))
    transition, intercept, noise = np.zeros((nx, nx, rows)), np.zeros((nx, rows)), np.zeros((nx, nx, rows))
    steps = {}
    for k in range(rows - 1):
        phi, early, late, steady, q = once(steps, model, data.time[k + 1] - data.time[k])
        following = u[k + 1] if data.hold == "first" else u[k]
        transition[:, :, k], noise[:, :, k] = phi, q
        intercept[:, k] = early[:, 0] * u[k] + late[:, 0] * following + steady
    found["design"], found["obs_intercept"] = c, np.outer(d[:, 0], u) + offset[:, None]
    found["obs_cov"] = np.diag([NOISE[o.name] ** 2 for o in model.outputs])
    found["transition"], found["state_intercept"], found["selection"] = transition, intercept, np.eye(nx)
    found["state_cov"] = noise
    found.initialize_known(x0, covariance)
    return found.smooth()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("known", [True, False], ids=["start known", "start uncertain"])
def test_likelihood_and_states_are_those_of_statsmodels(kind, known):
    data = record(kind)
    covariance = np.zeros((3, 3)) if known else np.diag([1e-6, 1e-2, 1e-1]) ** 2
    kalman, rows, pn = filter_of(ACTUATOR, data)
    assert kalman.step.per_interval
    ours = smooth_states(kalman, rows, pn, START, covariance)
    theirs = statsmodels_smoother(ACTUATOR, data, START, covariance)
    assert ours.log_likelihood == pytest.approx(theirs.llf, rel=1e-8)
    assert kalman.run(rows, pn, START, covariance).log_likelihood == ours.log_likelihood
    for mean, spread, expected, variance in (
        (ours.filtered, ours.filtered_covariance, theirs.filtered_state, theirs.filtered_state_cov),
        (ours.mean, ours.covariance, theirs.smoothed_state, theirs.smoothed_state_cov),
    ):
        size = np.abs(expected.T).max(axis=0)
        assert np.abs(mean - expected.T).max(axis=0) / size == pytest.approx(0, abs=1e-8)
        scale = np.sqrt(np.diagonal(variance.mean(axis=2)))
        assert np.abs(spread - variance.T).max(axis=0) / np.outer(scale, scale) == pytest.approx(0, abs=1e-8)


def test_innovations_are_white_and_of_unit_variance_when_the_model_is_right():
    data = record("held", rows=6000)
    kalman, rows, pn = filter_of(ACTUATOR, data)
    e = kalman.run(rows, pn, START).innovation
    assert e.std(axis=0) == pytest.approx([1, 1], abs=4 / np.sqrt(2 * len(e)))
    for j in range(2):
        assert abs(np.corrcoef(e[1:, j], e[:-1, j])[0, 1]) < 4 / np.sqrt(len(e))


@pytest.mark.parametrize("kind", KINDS)
def test_slopes_of_the_likelihood_are_finite_differences(kind):
    data = record(kind, rows=120)
    model = micro_actuator.with_process_noise("v", "i").start(noise_v=0.5, noise_i=0.2)
    kalman, rows, pn = filter_of(model, data)
    check_slopes(kalman, rows, pn, START)


@pytest.mark.rest
def test_runge_kutta_meets_the_exact_filter():
    """The extended filter on a linear model is the exact one, to the fourth order of its step."""
    data = record("held", rows=300)
    exact, rows, pn = filter_of(ACTUATOR, data)
    likelihood = exact.run(rows, pn, START).log_likelihood
    errors = []
    for substeps in (4, 8, 16):
        kalman, *_ = filter_of(ACTUATOR, data, "rk4", substeps)
        errors.append(abs(kalman.run(rows, pn, START).log_likelihood - likelihood))
    assert errors[1] < errors[0] / 10 and errors[2] < errors[1] / 10
    assert errors[2] < 1e-3


def test_without_process_noise_the_filter_runs_freely():
    data = record("gaps", rows=120)
    for method in ("exact", "rk4"):
        kalman, rows, pn = filter_of(micro_actuator, data, method)
        assert np.array_equal(kalman.run(rows, pn, START).predicted, kalman.simulate_free_run(rows, pn, START))
        outputs = predict_outputs(kalman, rows, pn, START, 3)
        assert outputs == pytest.approx(predict_outputs(kalman, rows, pn, START, 50), rel=1e-9)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("method", ["exact", "rk4"])
@pytest.mark.parametrize("kind", ["held", "linear", "gaps"])
def test_predictions_ahead_are_the_chain_of_one_step_predictions(method, kind):
    """The measurements of the last k samples hidden from the filter, its prediction is the one over k samples."""
    data = record(kind, rows=90)
    kalman, rows, pn = filter_of(ACTUATOR, data, method)
    for steps in (1, 2, 7):
        ahead = predict_outputs(kalman, rows, pn, START, steps)
        for end in (steps, 40, 89):
            hidden = rows.first(end + 1)
            hidden.y[end - steps + 1 :] = np.nan
            one = kalman.run(hidden, pn, START).predicted[end]
            expected = kalman.step.outputs(one, rows.u[end], values(ACTUATOR)).full().ravel()
            rows = to_record(ACTUATOR, data)
            assert ahead[end] == pytest.approx(expected, rel=1e-9), (steps, end)


def test_noise_that_gathers_over_a_stiff_interval_stays_finite():
    """The winding current settles within a hundredth of the interval: what is left is its stationary variance."""
    model = micro_actuator.with_process_noise(i=0.3).start(La=1e-6)
    added, slopes = discretise_process_noise(model.system)(values(model), np.array([2.5e-4]), np.arange(7))
    found, a = to_symmetric_arrays(added[0], 3), linear_matrices(model)[0]
    assert np.all(np.linalg.eigvalsh(found / np.sqrt(np.outer(np.diag(found), np.diag(found)))) > -1e-9)
    assert found[2, 2] == pytest.approx(0.3**2 / (2 * 8 / 1e-6), rel=1e-3)
    assert np.isfinite(slopes).all()
    forever, decay = solve_continuous_lyapunov(a, -intensity(model)), expm(a * 2.5e-4)
    assert found == pytest.approx(forever - decay @ forever @ decay.T, rel=1e-6)


def test_noise_of_a_model_that_runs_away_overflows_without_a_warning():
    """Warnings are errors: that the numbers are not finite is told by the run that follows."""
    constants = values(ACTUATOR)
    constants[[q.name for q in ACTUATOR.all_parameters].index("K")] = -1e14
    added, _ = discretise_process_noise(ACTUATOR.system)(constants, np.array([2.5e-4]), np.arange(7))
    assert not np.isfinite(added).all()


def extended_filter(model, data, x0, noise, sub=2000):
    """The textbook extended filter of a scalar model by itself: fine Euler steps of mean and variance, joint update."""
    c, gust = model.values["c"], model.values["gust"]
    x, P, total = x0, 0.0, 0.0
    R = np.diag(np.square(noise))
    for k in range(data.rows):
        H = np.array([[1.0], [c / (2 * np.sqrt(x))]])
        v = np.array([data.outputs["h"][k] - x, data.outputs["out"][k] - c * np.sqrt(x)])
        there = np.isfinite(v)
        if there.any():
            H, v, r = H[there], v[there], R[np.ix_(there, there)]
            S = H * P @ H.T + r
            total += v @ np.linalg.solve(S, v) + np.log(np.linalg.det(2 * np.pi * S))
            K = P * H.T @ np.linalg.inv(S)
            x, P = x + (K @ v)[0], (1 - (K @ H)[0, 0]) * P
        if k + 1 < data.rows:
            h = (data.time[k + 1] - data.time[k]) / sub
            for _ in range(sub):  # Heun, on the mean and on the linearised variance
                q = data.inputs["q"][k]
                f, a = q - c * np.sqrt(x), -c / (2 * np.sqrt(x))
                g = 2 * a * P + gust**2
                x1, P1 = x + h * f, P + h * g
                a1 = -c / (2 * np.sqrt(x1))
                x, P = x + h / 2 * (f + q - c * np.sqrt(x1)), P + h / 2 * (g + 2 * a1 * P1 + gust**2)
    return -total / 2


def test_the_extended_filter_is_the_textbook_one():
    model, data = tank_record()
    kalman, rows, _ = filter_of(model, data)
    pn = np.array([0.05, 0.003, 0.005, 1e-3])
    expected = extended_filter(model, data, 0.4, pn[2:])
    errors = [abs(kalman.with_substeps(n).run(rows, pn, np.array([0.4])).log_likelihood - expected) for n in (1, 4, 16)]
    assert errors[-1] < 1e-5 * abs(expected)
    assert errors[0] > errors[-1]
    check_slopes(kalman, rows, pn, np.array([0.4]))


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(
    "model",
    [
        micro_actuator + effect("coulomb_friction"),
        micro_actuator + effect("lugre_friction"),
        micro_actuator + effect("backlash"),
        micro_actuator + effect("transport_delay"),
    ],
    ids=lambda m: m.effects[-1].name,
)
def test_the_filter_of_every_kind_of_step_follows_its_record_and_has_exact_slopes(model):
    from greybox.simulation.simulate import simulate

    start = {"Fc": 0.05, "Fs": 0.06, "gap": 2e-7, "delay": 1e-4}
    model = model.start(**{n: v for n, v in start.items() if n in model.values}).with_process_noise(v=0.2)
    rng = np.random.default_rng(3)
    u = multisine(rng, 200, 2.5e-4, 5, 400, 2.0)
    run = simulate(model, {"time": np.arange(200) * 2.5e-4, "u": u}).record(NOISE, rng)
    kalman, rows, pn = filter_of(model, run)
    x0 = np.zeros(model.system.x.numel())
    found = kalman.run(rows, pn, x0)
    assert np.isfinite(found.log_likelihood)
    assert np.all(np.abs(found.innovation.mean(axis=0)) < 0.5) and np.all(found.innovation.std(axis=0) < 1.3)
    spread = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2).max(axis=0))
    assert np.all(np.linalg.eigvalsh(found.covariance / np.outer(spread, spread)) > -1e-9)
    ahead = predict_outputs(kalman, rows, pn, x0, 1)
    expected = np.array(
        [
            kalman.step.outputs(x, u, pn[: model.system.p.numel()]).full().ravel()
            for x, u in zip(found.predicted, rows.read_by(kalman.step).u, strict=True)
        ]
    )
    assert ahead == pytest.approx(expected, rel=1e-7, abs=1e-12)


@pytest.mark.rest
def test_a_large_plant_can_be_filtered():
    model = pneumatic_full.with_process_noise(v=0.05)
    rng = np.random.default_rng(4)
    from greybox.simulation.simulate import simulate

    time = np.arange(150) * 0.005
    data = simulate(model, {"time": time, model.inputs[0].name: 2 * np.sign(np.sin(6 * time))})
    noise = {o.name: 1e-3 * np.ptp(data.outputs[o.name]) + 1e-9 for o in model.outputs}
    seen = data.record(noise, rng)
    rows = to_record(model, seen)
    p = values(model)
    x0 = np.array([v[0] for v in data.states.values()])
    kalman = KalmanFilter.of(model.system, discretise(model.system, p, x0[None], rows.lengths))
    pn = np.append(p, list(noise.values()))
    found = kalman.run(rows, pn, x0)
    assert np.isfinite(found.log_likelihood)
    assert np.all(found.innovation.std(axis=0) < 1.2)
