"""Black-box models against other programs: statsmodels, plain least squares, loops written out here."""

import warnings

import control
import numpy as np
import pytest
import statsmodels.api as sm
from scipy.optimize import least_squares
from scipy.signal import lfilter
from statsmodels.tsa.ar_model import AutoReg
from statsmodels.tsa.statespace.varmax import VARMAX

import greybox as gb
from greybox.comparison.blackbox.polynomial import BlackBoxFinding, estimate_initial_state

A, B, C = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5], [1.0, 0.6]
TRUE = {"a1": -1.5, "a2": 0.7, "b1": 1.0, "b2": 0.5}


def record(y, *, name="record", step=0.1, **inputs):
    return gb.Experiment(name, step * np.arange(len(y)), inputs, {"y": y})


def data(rows=300, noise=0.1, seed=0, c=C):
    """An input, and ``A y = B u + C e``; the input rests for three rows, so that all begins at zero."""
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal(rows), noise * rng.standard_normal(rows)
    u[:3] = 0.0
    return u, lfilter(B, A, u) + lfilter(c, A, e)


def with_output_noise(rows, seed=0, noise=0.3):
    u, y = data(rows, noise=0, seed=seed)
    return u, y + noise * np.random.default_rng(seed + 1000).standard_normal(rows)


def lagged(x, by):
    return np.concatenate([np.zeros(by), x[: len(x) - by]])


def minimised(residual, start):
    """The minimum of a sum of squares by another program."""
    return least_squares(residual, start, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15).x


# ---- ARX ----


def test_arx_is_that_of_statsmodels():
    u, y = data(c=[1.0])
    ours = gb.blackbox.arx(record(y, u=u), na=2, nb=2)
    theirs = AutoReg(y, 2, trend="n", exog=np.column_stack([lagged(u, 1), lagged(u, 2)])).fit()
    assert list(ours.coefficients) == ["a1", "a2", "b1", "b2"]
    # they write y(k) = phi1 y(k-1) + ...
    assert list(ours.coefficients.values()) == pytest.approx([-1, -1, 1, 1] * theirs.params, rel=1e-9)
    rows = np.column_stack([-lagged(y, 1), -lagged(y, 2), lagged(u, 1), lagged(u, 2)])[2:]
    assert list(ours.std.values()) == pytest.approx(sm.OLS(y[2:], rows).fit().bse, rel=1e-9)
    assert ours.samples == len(y) - 2
    assert ours.loss == pytest.approx(np.mean(theirs.resid**2), rel=1e-9)


@pytest.mark.parametrize(("history", "first"), [("zero", 0), ("measured", 3)])
def test_the_history_names_the_rows(history, first):
    u, v, y = np.random.default_rng(1).standard_normal((3, 120))
    ours = gb.blackbox.arx(record(y, u=u, v=v), na=1, nb=(2, 1), nk=(0, 3), history=history, offset=True)
    rows = np.column_stack([-lagged(y, 1), u, lagged(u, 1), lagged(v, 3), np.ones(120)])
    assert list(ours.coefficients) == ["a1", "b1[u]", "b2[u]", "b1[v]", "constant"]
    plain = np.linalg.lstsq(rows[first:], y[first:], rcond=None)[0]
    assert list(ours.coefficients.values()) == pytest.approx(plain, rel=1e-9)
    assert ours.feedthrough == pytest.approx({"u": plain[1], "v": 0.0})
    assert ours.history == history


@pytest.mark.parametrize("focus", ["prediction", "simulation"])
def test_exact_records_with_gaps_give_exact_coefficients(focus):
    records = []
    for seed in (0, 1):
        u, y = data(rows=90, noise=0, seed=seed)
        y[[40, 41, 70]] = np.nan
        records.append(record(y, name=str(seed), u=u))
    found = gb.blackbox.arx(records, na=2, nb=2, focus=focus)
    assert found.coefficients == pytest.approx(TRUE, abs=1e-9)
    assert found.samples == 2 * (88 - 4 - 3)  # a gap takes the equations along that it is part of


def test_simulation_focus_sees_through_noise_on_the_output():
    u, y = with_output_noise(3000)
    off = {
        focus: abs(gb.blackbox.arx(record(y, u=u), na=2, nb=2, focus=focus, passes=3).coefficients["a1"] - TRUE["a1"])
        for focus in ("prediction", "simulation")
    }
    assert off["simulation"] < 0.005 < 0.02 < off["prediction"]


# ---- ARMAX, output error, Box-Jenkins: the minimum that other programs find ----


def test_armax_is_that_of_statsmodels():
    u, y = data()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a remark on VARMA models of several outputs
        theirs = VARMAX(
            y[:, None],
            exog=np.column_stack([lagged(u, 1), lagged(u, 2)]),
            order=(2, 1),
            trend="n",
            error_cov_type="diagonal",
        )
    names = ["L1.y.y", "L2.y.y", "L1.e(y).y", "beta.x1.y", "beta.x2.y", "sigma2.y"]
    assert theirs.param_names == names

    def residual(p):
        theirs.update(np.append(p, 1.0))
        first = theirs.ssm["selection"]  # nothing but the first error stands in the first state
        theirs.ssm.initialize_known(np.zeros(3), first @ first.T)
        return theirs.ssm.filter().forecasts_error[0]

    phi1, phi2, c1, b1, b2 = minimised(residual, [1.4, -0.6, 0.5, 0.9, 0.4])
    ours = gb.blackbox.armax(record(y, u=u), na=2, nb=2, nc=1, history="zero")
    expected = {"a1": -phi1, "a2": -phi2, "b1": b1, "b2": b2, "c1": c1}
    assert ours.coefficients == pytest.approx(expected, rel=1e-6)
    assert ours.loss == pytest.approx(np.mean(residual([phi1, phi2, c1, b1, b2]) ** 2), rel=1e-9)


@pytest.mark.parametrize("kind", ["output error", "box-jenkins"])
def test_the_noise_that_bypasses_the_plant_is_that_of_a_plain_minimum(kind):
    u, y = with_output_noise(250, seed=3)
    r = record(y, u=u)
    ours = {
        "output error": lambda: gb.blackbox.output_error(r, nb=2, nf=2, history="zero"),
        "box-jenkins": lambda: gb.blackbox.box_jenkins(r, nb=2, nf=2, nc=1, nd=1, history="zero"),
    }[kind]()

    def residual(p):
        w = y - lfilter([0, p[0], p[1]], [1, p[2], p[3]], u)
        return w if len(p) == 4 else lfilter([1, p[5]], [1, p[4]], w)

    start = [0.9, 0.4, -1.4, 0.6, *([0.1, 0.1] if kind == "box-jenkins" else [])]
    best = minimised(residual, start)
    if kind == "box-jenkins":  # on white noise C and D nearly cancel, and only the sum of squares tells
        assert ours.loss <= np.mean(residual(best) ** 2) * (1 + 1e-9)
        return
    assert list(ours.coefficients.values()) == pytest.approx(best, rel=1e-6)
    jacobian = least_squares(residual, best, jac="3-point").jac
    variance = np.sum(residual(best) ** 2) / (len(y) - 4)
    assert list(ours.std.values()) == pytest.approx(
        np.sqrt(variance * np.diag(np.linalg.inv(jacobian.T @ jacobian))), rel=1e-3
    )


def test_the_unknown_past_is_estimated_with_the_rest():
    u, y = data(rows=200, noise=0)
    seen = np.where(np.isin(np.arange(200), [80, 81]), np.nan, y)
    late = record(seen[60:], u=u[60:])
    for model in (gb.blackbox.output_error(late, nb=2, nf=2), gb.blackbox.armax(late, na=2, nb=2, nc=0)):
        assert list(model.coefficients.values()) == pytest.approx(
            [1.0, 0.5, -1.5, 0.7] if model.kind == "output error" else [-1.5, 0.7, 1.0, 0.5], abs=1e-8
        )
        run = model.simulate(late)["y"]
        assert run == pytest.approx(y[60:], abs=1e-7)  # the gap too, and the state before the first row


@pytest.mark.crossed(3)
@pytest.mark.parametrize("kind", ["arx", "armax", "output error"])
def test_estimates_scatter_as_they_say(kind):
    normalised = []
    for seed in range(15):
        if kind == "output error":
            u, y = with_output_noise(250, seed)
            found = gb.blackbox.output_error(record(y, u=u), nb=2, nf=2, history="zero")
        else:
            u, y = data(250, 0.3, seed, C if kind == "armax" else [1.0])
            r = record(y, u=u)
            found = gb.blackbox.armax(r, na=2, nb=2, nc=1) if kind == "armax" else gb.blackbox.arx(r, na=2, nb=2)
        true = {"b1": 1.0, "b2": 0.5, "f1": -1.5, "f2": 0.7, "a1": -1.5, "a2": 0.7, "c1": 0.6}
        normalised += [(v - true[n]) / found.std[n] for n, v in found.coefficients.items()]
    assert abs(np.mean(normalised)) < 0.3
    assert 0.8 < np.std(normalised) < 1.2


def test_noise_and_curve_polynomials_stay_stable():
    u, y = data(60, seed=9)
    overdone = gb.blackbox.armax(
        record(y - lagged(y, 1), u=u), na=1, nb=1, nc=3
    )  # differences: a root of C wants to the circle
    assert np.abs(np.roots(overdone.c)).max() < 1


# ---- Runs and predictions ----


def test_predictions_are_those_of_a_loop():
    u, y = data(60)
    model = gb.blackbox.armax(record(y, u=u), na=2, nb=2, nc=1, history="zero")
    (a1, a2), (b1, b2), c1 = model.a[1:], model.b[0][1:], model.c[1]
    e, one, two = np.zeros(60), np.zeros(60), np.zeros(60)

    def at(x, k):
        return x[k] if k >= 0 else 0.0

    for k in range(60):
        known = b1 * at(u, k - 1) + b2 * at(u, k - 2)
        one[k] = -a1 * at(y, k - 1) - a2 * at(y, k - 2) + known + c1 * at(e, k - 1)
        two[k] = -a1 * at(one, k - 1) - a2 * at(y, k - 2) + known
        e[k] = y[k] - one[k]
    r = record(y, u=u)
    assert model.predict(r, initial="zero")["y"] == pytest.approx(one, abs=1e-12)
    assert model.predict(r, 2, initial="zero")["y"] == pytest.approx(two, abs=1e-12)
    assert model.errors(r, initial="zero") == pytest.approx(e, abs=1e-12)
    assert model.simulate(r, initial="zero")["y"] == pytest.approx(lfilter([0, b1, b2], [1, a1, a2], u), abs=1e-12)
    assert model.loss == pytest.approx(np.mean(e**2))


def test_a_model_is_the_transfer_function_of_control():
    u, y = data(80)
    model = gb.blackbox.arx(record(y, u=u), na=2, nb=2, nk=2)
    system = model.to_control()
    assert system.dt == 0.1
    for frequency in (0.3, 2.0):
        response = system(np.exp(2j * np.pi * frequency * 0.1))
        assert model.response(np.array([frequency]))[0] == pytest.approx(response, rel=1e-9)
    assert np.sort_complex(model.poles) == pytest.approx(np.sort_complex(system.poles()[np.abs(system.poles()) > 1e-9]))
    assert model.zeros() == pytest.approx(system.zeros()) and model.gain() == pytest.approx(system.dcgain())


# ---- Digits ----


@pytest.mark.parametrize("pole", [0.5, 0.98, 0.9999])
def test_the_digits_asked_for_keep_stability_and_response(pole):
    model = gb.blackbox.PolynomialModel(
        "arx", "y", ("u",), 0.01, (1,), ([0, 1.0],), a=np.poly([pole, 0.987654321]), samples=2000
    )
    enough = gb.blackbox.count_digits_needed(model)
    frequency = np.geomspace(0.05, 50, 40)
    for digits in range(enough, 13):
        short = gb.blackbox.round_coefficients(model, digits)
        assert short.stable
        assert np.abs(short.response(frequency) / model.response(frequency) - 1).max() < 0.012
    fewer = gb.blackbox.round_coefficients(model, enough - 1)
    assert not fewer.stable or np.abs(fewer.response(frequency) / model.response(frequency) - 1).max() > 0.005


def test_the_printed_digits_of_an_integrator_keep_it_stable():
    # the pneumatic chapter prints four digits of such a model and makes it unstable
    model = gb.blackbox.PolynomialModel(
        "arx",
        "y",
        ("u",),
        0.01,
        (0,),
        ([0.00778812345, -0.00767123456],),
        a=np.poly([1 - 3e-9, 0.98761234567]),
        samples=10001,
    )
    assert model.stable and not gb.blackbox.round_coefficients(model, 4).stable
    rows = dict(line.split()[:2] for line in str(model).splitlines() if line.strip()[:2] in ("a1", "a2", "b1", "b2"))
    a1, a2 = (float(rows[name]) for name in ("a1", "a2"))
    assert np.abs(np.roots([1, a1, a2])).max() < 1
    assert gb.blackbox.count_digits_needed(model) > 8


# ---- What cannot be ----


def step_record(rows=50):
    u = np.ones(rows)
    return record(lfilter([0, 0.1], [1, -0.9], u), u=u)


def tones(rows=2000):
    t = 0.1 * np.arange(rows)
    u = sum(np.sin(2 * np.pi * f * t) for f in (0.11, 0.37, 0.83))
    return record(lfilter(B, A, u), u=u)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda r: gb.blackbox.arx(r, na=30, nb=30),
            r"60 rows, leave 30 equations for 60 coefficients of 'y'; at least 61",
        ),
        (lambda r: gb.blackbox.armax(r, na=20, nb=20, nc=25), r"for 65 coefficients of 'y'; at least 66"),
        (
            lambda r: gb.blackbox.arx(r, na=1, nb=1, nk=60),
            r"nk = 60 samples of delay, but the longest record \('record'\) has 60",
        ),
        (lambda r: gb.blackbox.output_error(r, nb=1, nf=1, nk=500), r"nk = 500 samples"),
        (lambda r: gb.blackbox.arx(r, na=1, nb=0), r"nb = 0; give whole numbers from 1"),
        (lambda r: gb.blackbox.arx(r, na=-1, nb=1), r"na = -1; give a whole number from 0"),
        (lambda r: gb.blackbox.armax(r, na=1, nb=1, nc=1.5), r"nc = 1.5; give a whole number"),
        (lambda r: gb.blackbox.arx(r, na=1, nb=(1, 2)), r"nb has 2 numbers for 1 inputs"),
        (lambda r: gb.blackbox.arx(r, na=1, nb=1, output="z"), r"no experiment has an output 'z'"),
        (lambda r: gb.blackbox.arx(r, na=1, nb=1, inputs="v"), r"no input 'v'"),
        (lambda r: gb.blackbox.arx(r, na=1, nb=1, history="mesured"), r"unknown history 'mesured'.*measured"),
        (lambda r: gb.blackbox.arx(r, na=1, nb=1, focus="simulate"), r"unknown focus 'simulate'.*simulation"),
        (lambda r: gb.blackbox.output_error(r, nb=1, nf=1, history="measured"), r"unknown history 'measured'"),
        (lambda r: gb.blackbox.hammerstein(r, nb=1, nf=1, shape="spline"), r"unknown shape 'spline'"),
        (lambda r: gb.blackbox.scan_structures(r, "arma"), r"unknown kind 'arma'.*armax"),
        (lambda r: gb.blackbox.scan_structures(r, criterion="aicc"), r"unknown criterion 'aicc'.*aic"),
        (
            lambda r: gb.blackbox.arx(r, na=1, nb=1).simulate(gb.blackbox.resample(r, 0.2)),
            r"every 0.2 s, but arx\(1, 1, 1\)",
        ),
        (lambda r: gb.blackbox.arx([r, gb.blackbox.resample(r, 0.2)], na=1, nb=1), r"different sampling times"),
        (lambda r: gb.blackbox.resample(r, -1.0), r"a step of -1.0 s; give a positive number"),
        (lambda r: gb.blackbox.arx([], na=1, nb=1), r"no experiment; give at least one record"),
    ],
)
def test_bad_input_is_one_clear_error(call, message):
    u, y = data(60)
    with pytest.raises(gb.errors.DataError, match=message):
        call(record(y, u=u))


def test_irregular_time_names_the_way_out():
    u, y = data(60)
    r = gb.Experiment("uneven", np.cumsum(np.where(np.arange(60) % 7, 0.1, 0.15)), {"u": u}, {"y": y})
    with pytest.raises(
        gb.errors.DataError, match=r"'uneven': time is irregular .*greybox\.blackbox\.resample\(experiment, 0\.1\)"
    ):
        gb.blackbox.arx(r, na=1, nb=1)
    assert gb.blackbox.arx(gb.blackbox.resample(r, 0.1), na=2, nb=2).samples > 50


def test_a_steps_columns_are_named_as_collinear():
    with pytest.raises(gb.errors.DataError, match=r"columns u\(k-1\), u\(k-2\) are collinear.*history='zero'"):
        gb.blackbox.arx(step_record(), na=1, nb=2)
    found = gb.blackbox.arx(step_record(), na=1, nb=2, history="zero")
    assert found.coefficients == pytest.approx({"a1": -0.9, "b1": 0.1, "b2": 0.0}, abs=1e-12)
    assert found.findings[0].code == BlackBoxFinding.WEAK_EXCITATION
    assert (found.findings[0].subject, found.findings[0].values["order"]) == ("u", 1)


def test_three_tones_carry_six_coefficients():
    clean = tones()
    y = clean.outputs["y"] + 0.1 * np.random.default_rng(0).standard_normal(clean.rows)
    noisy = record(y, u=clean.inputs["u"])
    assert not gb.blackbox.arx(noisy, na=3, nb=3).findings
    (finding,) = gb.blackbox.arx(noisy, na=4, nb=4).findings
    assert finding.code == BlackBoxFinding.WEAK_EXCITATION
    assert dict(finding.values) == {"order": 6, "required": 8}
    with pytest.raises(
        gb.errors.DataError, match=r"arx\(1, 8, 1\): the columns u\(k-2\), .* are collinear.*each sine two"
    ):
        gb.blackbox.arx(clean, na=1, nb=8)  # lags beyond the sixth are combinations of those before


def test_an_unstable_result_says_so_and_why():
    u, _ = data(80, noise=0)
    exploding = lfilter([0, 1.0], [1, -1.02], u)
    found = gb.blackbox.arx(record(exploding, u=u), na=1, nb=1)
    assert not found.stable
    assert found.findings[-1].code == BlackBoxFinding.UNSTABLE
    assert found.findings[-1].values["pole"] == pytest.approx(1.02)
    assert not np.isfinite(found.simulate(record(np.ones(40000), u=np.ones(40000)), initial="zero")["y"]).all()


def test_a_fast_unstable_model_runs_from_the_few_rows_that_tell_its_past():
    """Its five responses to the past outgrow arithmetic within three rows: fewer rows than unknowns."""
    a = np.array([1, -4e3, 0.3, 0.2, 0.1, 0.1])
    model = gb.blackbox.PolynomialModel("arx", "y", ("u",), 1.0, (1,), ([0.0, 0.5],), a=a)
    rng = np.random.default_rng(0)
    u = rng.standard_normal(60)
    run = model.simulate(gb.Experiment("r", np.arange(60.0), {"u": u}, {"y": rng.standard_normal(60)}), rows=50)["y"]
    for k in range(5, 12):
        assert run[k] == pytest.approx(0.5 * u[k - 1] - a[1:] @ run[k - 5 : k][::-1], rel=1e-6)


def test_a_slow_state_is_told_by_as_many_rows_as_show_it():
    """What fifty rows show of two time constants of 180 and 250 rows together is twenty times as large over the whole record."""
    rows, noise = 1500, 0.02
    poles = [(0.9945, 0.962), (0.9959, 0.836)]
    free = np.column_stack([lagged(lfilter([1.0], np.poly(p), np.eye(1, rows)[0]), j) for p in poles for j in (0, 1)])
    orthogonal, back = np.linalg.qr(free)
    faint = np.linalg.solve(back, np.linalg.svd(orthogonal[:50])[2][-1]) * np.sqrt(rows)  # of unit size over the record
    for size in (3.0, 0.1):
        measured = free @ (size * faint) + noise * np.random.default_rng(4).standard_normal(rows)
        found = estimate_initial_state(free, measured, np.zeros(rows), "estimated", 50)
        # Half of what the record tells: twice the variance that the whole of it leaves, of four numbers.
        assert np.sum((free @ (found - size * faint)) ** 2) < 2 * 3 * 4 * noise**2


@pytest.mark.parametrize(
    ("above", "below", "late"), [([3.0], [1, 2.0, 50.0], 0), ([1.0, 5.0, 9.0], [1, 3.0, 2.0], 0), ([2.0], [1, 0.5], 3)]
)
def test_back_to_the_s_domain_is_the_inverse_of_the_hold(above, below, late):
    held = control.sample_system(control.tf(above, below), 0.05, "zoh")
    b = np.atleast_1d(held.num[0][0])
    b = np.concatenate([np.zeros(len(held.den[0][0]) - len(b) + late), b])
    nk = int(np.flatnonzero(b)[0])
    model = gb.blackbox.PolynomialModel("arx", "y", ("u",), 0.05, (nk,), (b,), a=held.den[0][0])
    found = gb.blackbox.to_continuous(model)
    assert np.trim_zeros(np.round(found.numerator, 9), "f") == pytest.approx(above, abs=1e-7)
    assert found.denominator == pytest.approx(below, rel=1e-8)
    assert found.delay == pytest.approx(0.05 * late)
