"""A robust fit against scipy, its cost against finite differences, and what outliers do to it: little."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from greybox import FitOptions, fit, load_fit, validate
from greybox.base.errors import ModelError
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_sources import estimate_noise
from greybox.data.noise.spectrum import estimate_noise_from_differences
from greybox.estimation.findings import EstimationCode
from greybox.estimation.options import parse_loss
from greybox.estimation.residuals import residual_tests
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.shooting_cost import WhitenedShooting
from greybox.estimation.uncertainty import bootstrap, profile
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record, multisine
from tests.support.findings import codes, find
from tests.support.published_plants import REST, SATURATION, TIMES, VALUES

TRUTH = micro_actuator.fix("M", "Ra")
LEVEL = {"x": 2e-7, "i": 5e-3}
ROBUST = ("huber", "student")


def record(seed, rho=0.0, rows=1500):
    rng = np.random.default_rng([seed, 3])
    clean = linear_record(TRUTH, multisine(rng, rows, 2.5e-4, 5, 800, 3.0), 2.5e-4)

    def noise():
        return lfilter([1.0], [1.0, -rho], rng.normal(size=rows + 300) * np.sqrt(1 - rho**2))[300:]

    return replace(clean, outputs={n: y + LEVEL[n] * noise() for n, y in clean.outputs.items()})


def spoiled(data, share=0.05, size=50.0, seed=0):
    """``data`` with a share of its samples off by many standard deviations of the noise."""
    rng = np.random.default_rng([seed, 4])
    outputs = {}
    for name, y in data.outputs.items():
        hit = rng.random(len(y)) < share
        outputs[name] = np.where(hit, y + size * LEVEL[name] * rng.choice([-1, 1], len(y)), y)
    return replace(data, outputs=outputs)


def away(found, unit=None):
    """Errors of the constants in standard deviations, their own or those of another fit."""
    return {
        q.name: (found.parameters[q.name].value - q.value) / (unit or found).parameters[q.name].std
        for q in TRUTH.free_parameters
    }


@pytest.mark.parametrize("text", ["huber", "huber:0.7", "student", "student:1"])
def test_half_the_slope_and_the_curvature_are_those_of_the_cost(text):
    loss = replace(parse_loss(text), scale=np.array([1.7]))
    r = np.linspace(-9, 9, 61)[:, None] + 0.013
    e = 1e-4

    def cost(x):
        return loss.terms(x)[0]

    _, psi, weight, curvature = loss.terms(r)
    np.testing.assert_allclose(psi, (cost(r + e) - cost(r - e)) / (4 * e), atol=1e-7)
    np.testing.assert_allclose(curvature, (cost(r + e) - 2 * cost(r) + cost(r - e)) / (2 * e**2), atol=1e-5)
    np.testing.assert_allclose(weight * r, psi)
    assert (weight >= curvature).all(), "the Hessian of the search is never too small"


@pytest.mark.parametrize("rho", [0.0, 0.9])
@pytest.mark.parametrize("text", ["huber", "student"])
def test_the_gradient_is_that_of_the_robust_cost(text, rho):
    data = spoiled(record(1, rho, 300))
    gap = {n: np.where((np.arange(300) > 100) & (np.arange(300) < 120), np.nan, y) for n, y in data.outputs.items()}
    rng = np.random.default_rng(9)
    silent = {n: s * lfilter([1.0], [1.0, -rho], rng.normal(size=900))[300:] for n, s in LEVEL.items()}
    quiet = Experiment("quiet", 2.5e-4 * np.arange(600), {"u": np.zeros(600)}, silent)
    problem = prepare_problem(
        TRUTH.start(K=5800),
        replace(data, outputs=gap),
        LEVEL,
        FitOptions(),
        quiet=quiet if rho else (),
    )
    assert problem.noise.coloured == bool(rho)
    loss = replace(parse_loss(text), scale=np.array([1.2, 1.0]))
    problem = replace(problem, loss=loss)
    shooting = problem.shooting()
    assert isinstance(shooting, WhitenedShooting) and shooting.loss is not None
    n = problem.variables.size
    z = 0.01 * np.random.default_rng(2).normal(size=n)
    here = shooting.evaluate(z)
    white = np.concatenate([r for r, _ in shooting.whiten(shooting.compute_weighted_errors(z))])
    assert here.cost == pytest.approx(np.nansum(loss.terms(white)[0]), rel=1e-12)
    steps = 1e-6 * np.eye(n)
    slopes = [(shooting.evaluate(z + e).cost - shooting.evaluate(z - e).cost) / 2e-6 for e in steps]
    np.testing.assert_allclose(here.gradient, slopes, rtol=2e-4, atol=1e-5 * np.abs(here.gradient).max())
    assert np.linalg.eigvalsh(here.hessian).min() > 0


@pytest.mark.parametrize(("text", "scipys", "threshold"), [("huber", "huber", 1.345), ("student:1", "cauchy", 1.0)])
def test_the_optimum_is_that_of_scipy(text, scipys, threshold):
    values = np.where(TIMES == 3, 60.0, VALUES)  # one reading gone wrong
    data = Experiment("published", np.append(0.0, TIMES), {}, {"y": np.append(np.nan, values)})
    found = fit(SATURATION, data, noise={"y": 2.0}, options=replace(REST, loss=text))
    scale = 2.0 * found.robust.scale["y"]

    def residual(p):
        return values - p[0] * (1 - np.exp(-p[1] * TIMES))

    theirs = least_squares(
        residual, [19.0, 0.5], loss=scipys, f_scale=threshold * scale, xtol=1e-13, ftol=1e-13, gtol=1e-13
    )
    assert [found.parameters[n].value for n in "ab"] == pytest.approx(theirs.x, rel=2e-5)
    plain = fit(SATURATION, data, noise={"y": 2.0}, options=REST)
    assert abs(plain.parameters["a"].value - 19.14) > 2 * abs(found.parameters["a"].value - 19.14)


@pytest.mark.rest
@pytest.mark.parametrize("text", ROBUST)
def test_outliers_that_ruin_least_squares_leave_a_robust_fit_alone(text):
    worst_plain, worst, width = [], [], []
    for seed in range(3):
        data = spoiled(record(seed), seed=seed)
        plain, found = fit(TRUTH, data, noise=LEVEL), fit(TRUTH, data, noise=LEVEL, options=FitOptions(loss=text))
        clean = fit(TRUTH, record(seed), noise=LEVEL)
        worst.append(max(map(abs, away(found).values())))
        worst_plain.append(max(map(abs, away(plain, clean).values())))
        width.append([found.parameters[n].std / clean.parameters[n].std for n in clean.uncertainty.free])
        assert all(0.03 < share < 0.08 for share in found.robust.outliers.values())
        assert max(away(plain, clean).values(), key=abs) != 0
    assert max(worst) < 3.5 and min(worst_plain) > 5, (worst, worst_plain)
    assert 1.0 < np.mean(width) < 1.2
    assert find(found.findings, EstimationCode.ROBUST_LOSS_OUTLIERS).values["shares"]
    assert find(found.solver.details, EstimationCode.MISFIT_RATIO).values["without_outliers"]
    assert EstimationCode.MISFIT_ABOVE_NOISE not in codes(found.findings)
    assert EstimationCode.MISFIT_ABOVE_NOISE in codes(plain.findings)


@pytest.mark.slow
def test_without_outliers_it_costs_a_few_percent():
    """The variance over many records, and the stated one, against theory."""
    theory = {"huber": 0.950, "student": 0.926}
    errors, stated = [], []
    for seed in range(12):
        data = record(seed + 100, rows=400)
        fits = [fit(TRUTH, data, noise=LEVEL, options=FitOptions(loss=loss)) for loss in ("squares", *theory)]
        errors.append([list(away(f, fits[0]).values()) for f in fits])
        stated.append([[fits[0].parameters[n].std / f.parameters[n].std for n in f.uncertainty.free] for f in fits])
    spread = np.mean(np.square(np.array(errors)), axis=(0, 2))
    for k, efficiency in enumerate(theory.values(), 1):
        assert np.mean(np.array(stated)[:, k]) ** 2 == pytest.approx(efficiency, rel=0.02)
        assert spread[0] / spread[k] == pytest.approx(efficiency, abs=0.12)


@pytest.mark.rest
@pytest.mark.parametrize("text", ROBUST)
def test_intervals_hold_with_outliers(text):
    z = [
        list(away(fit(TRUTH, spoiled(record(seed, rows=600), seed=seed), options=FitOptions(loss=text))).values())
        for seed in range(10)
    ]
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_outliers_do_not_pass_for_noise():
    data = spoiled(record(1))
    blind, seeing = (estimate_noise(TRUTH, [data], {}, robust=robust).std for robust in (False, True))
    truth = np.array([LEVEL["x"], LEVEL["i"]])
    assert (blind > 5 * truth).all() and (seeing < 2 * truth).all() and (seeing > 0.9 * truth).all()
    rng = np.random.default_rng(3)
    assert estimate_noise_from_differences(rng.normal(size=4000), robust=True) == pytest.approx(1.0, rel=0.1)
    coarse = np.round(3 * rng.normal(size=2000) * (rng.random(2000) < 0.3))
    assert estimate_noise_from_differences(coarse, robust=True) > 0


def test_curvature_profile_and_bootstrap_agree():
    found = fit(TRUTH, spoiled(record(2)), noise=LEVEL, options=FitOptions(loss="huber"))
    again = bootstrap(found, np.random.default_rng(2), replicates=600)
    for name in ("K", "La"):
        stated = found.parameters[name]
        width = stated.interval[1] - stated.interval[0]
        assert profile(found, name).interval == pytest.approx(stated.interval, abs=0.06 * width)
        assert again.std[name] == pytest.approx(stated.std, rel=0.15)


def test_a_coloured_residual_widens_the_interval_of_a_robust_fit_too():
    found = fit(TRUTH, spoiled(record(3, 0.9)), options=FitOptions(loss="huber"))
    assert found.uncertainty.kind == "sandwich" and max(found.uncertainty.inflation.values()) > 1.5
    assert max(map(abs, away(found).values())) < 4


def test_the_tests_of_the_residual_see_past_the_outliers_but_name_them():
    tests = residual_tests(fit(TRUTH, spoiled(record(4)), noise=LEVEL, options=FitOptions(loss="huber")))
    assert {t.kind for t in tests.alarms} == {"normality"}
    wrong = residual_tests(fit(TRUTH.fix(Ra=8.5), spoiled(record(4)), noise=LEVEL, options=FitOptions(loss="huber")))
    assert wrong.of("i", "input_independence").alarm


def test_a_model_that_lacks_something_has_no_outliers_but_a_misfit():
    found = fit(TRUTH.fix(Ra=9.5), record(5), noise=LEVEL, options=FitOptions(loss="huber"))
    assert found.robust.scale["i"] > 3 and found.solver.details[0].values["ratio"] > 3
    assert EstimationCode.MISFIT_ABOVE_NOISE in codes(found.findings)


def test_it_is_saved_and_repeated(tmp_path):
    found = fit(TRUTH, spoiled(record(1)), options=FitOptions(loss="student:5"))
    again = load_fit(found.save(tmp_path / "fit.json"), TRUTH)
    assert (again.robust.name, again.robust.scale, again.robust.outliers) == (
        found.robust.name,
        found.robust.scale,
        found.robust.outliers,
    )
    assert again.robust.name == "student, 5 degrees of freedom"
    assert profile(again, "K").interval == profile(found, "K").interval


def test_outliers_at_its_beginning_do_not_spoil_a_validation():
    model, data = fit(TRUTH, record(1), noise=LEVEL).model, record(2)
    x = data.outputs["x"].copy()
    x[[0, 3, 11]] += 1000 * LEVEL["x"]
    bad = data.with_outputs({**data.outputs, "x": x})

    def late(options):
        trace = validate(model, bad, noise=LEVEL, options=options).traces[0]
        return np.sqrt(np.mean(trace.residual("x")[20:200] ** 2)) / LEVEL["x"]

    assert late(FitOptions(loss="huber")) < 1.5 < 3 < late(FitOptions())


def test_the_misfit_of_a_validation_leaves_its_outliers_out():
    model, bad = fit(TRUTH, record(1), noise=LEVEL).model, record(2)
    x = bad.outputs["x"].copy()
    x[300::150] += 200 * LEVEL["x"]
    bad = bad.with_outputs({**bad.outputs, "x": x})
    judged = {
        loss: validate(model, bad, noise=LEVEL, options=FitOptions(loss=loss)).misfit["x"]
        for loss in ("huber", "squares")
    }
    assert judged["huber"].noise_ratio == pytest.approx(1.0, abs=0.1)
    # The root mean square of noise and of one reading in 150 that is 200 times as far off.
    share = len(x[300::150]) / len(x)
    assert judged["squares"].noise_ratio == pytest.approx(np.sqrt(1 + share * 200**2), rel=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hubber", "unknown loss 'hubber'; did you mean 'huber'"),
        ("huber:", "loss 'huber:': write huber:K with the threshold K in noise standard deviations"),
        ("student:-1", "K above zero, or squares"),
        ("squares:2", "loss 'squares:2': write huber:K"),
    ],
)
def test_a_loss_that_does_not_exist_is_refused_in_words(text, message):
    with pytest.raises(ModelError, match=message):
        FitOptions(loss=text)
