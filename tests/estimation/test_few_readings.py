"""As many unknowns as readings, outputs of a handful of readings, constants decades away from their bounds."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.estimation.findings import EstimationCode
from greybox.estimation.linear.exported_model import to_plant
from tests.support.findings import find

STEP = 0.1


def lag(bounds=(1e-9, 1e9), start=1.0, **changes):
    return Model(
        "lag",
        [State("y", "V")],
        [Input("u", "V")],
        [Output("y", "V"), Output("z", "A", lambda x, u, p: p.g * x.y)],
        [
            Parameter("K", "1", start, bounds),
            Parameter("tau", "s", 1.0, (1e-9, 1e9)),
            Parameter("g", "A/V", 1.0, **changes),
        ],
        lambda x, u, p: [Balance("lag", "V", p.tau, "y", drive=p.K * u.u, decay=-x.y)],
    )


def run(rows, seed, readings=(), noise=0.1):
    """A lag of 1 s and gain 2 under steps, its step in closed form, and three times it at a few rows."""
    rng = np.random.default_rng(seed)
    u, y = np.repeat(rng.choice([-1.0, 1.0], rows), 10)[:rows], np.zeros(rows)
    kept = np.exp(-STEP)
    for k in range(rows - 1):
        y[k + 1] = kept * y[k] + (1 - kept) * 2 * u[k]
    outputs = {"y": y + noise * rng.normal(size=rows)}
    if len(readings):
        z = np.full(rows, np.nan)
        z[list(readings)] = 3 * y[list(readings)] + noise * rng.normal(size=len(readings))
        outputs["z"] = z
    return gb.Experiment.from_arrays(STEP * np.arange(rows), {"u": u}, outputs)


@pytest.mark.parametrize(("rows", "fixed"), [(3, {}), (2, {"tau": 1.0}), (2, {})])
def test_as_many_unknowns_as_readings_leave_no_interval(rows, fixed):
    found = gb.fit(lag(fixed=True).fix(**fixed), run(rows, 1))
    assert all(e.interval is None for e in found.parameters.values())
    finding = find(found.findings, EstimationCode.NO_FREEDOM)
    assert finding.values["readings"] == rows and finding.values["unknowns"] >= rows
    assert str(found).startswith("lag is not tested by its records") and "explains its records" not in str(found)
    # Whoever takes the model without the fit reads of it too.
    assert finding in to_plant(found).findings
    # With the noise told there is something to go by.
    told = gb.fit(lag(fixed=True).fix(**fixed), run(rows, 1), noise={"y": 0.1})
    assert not [f for f in told.findings if f.code == EstimationCode.NO_FREEDOM]


@pytest.mark.crossed(3)
@pytest.mark.parametrize("readings", [(35,), (20, 65), (20, 35, 50)])
def test_a_handful_of_readings_does_not_tell_its_own_noise(readings):
    """Weighed by their residual they would count ever more, until the other constants have no interval."""
    inside = []
    for seed in range(10):
        found = gb.fit(lag(), run(100, seed, readings))
        gain, other = found.parameters["g"], found.parameters["K"]
        inside.append(gain.interval[0] <= 3 <= gain.interval[1])
        assert 0.005 < other.std < 0.1 and found.noise.std["z"] > 0.01
    assert all(inside)


@pytest.mark.parametrize("bounds", [(0.0, 1.0), (0.0, 1e-5), (-1.0, 1.0), (0.0, 1e3)])
@pytest.mark.parametrize("start", [1e-7, 3e-6])
def test_a_small_constant_in_wide_bounds_is_not_at_its_bound(bounds, start):
    rng = np.random.default_rng(3)
    t = 1e-6 * np.arange(300)
    u = np.repeat(rng.choice([0.0, 1.0], 30), 10)
    model = Model(
        "rc",
        [State("q", "V")],
        [Input("u", "V")],
        [Output("q", "V")],
        [Parameter("C", "F", start, bounds), Parameter("R", "ohm", 150.0, (1.0, 1e4), fixed=True)],
        lambda x, u, p: [Balance("charge", "A", p.C, "q", drive=(u.u - x.q) / p.R)],
    )

    def simulate(c):
        q, kept = np.zeros(300), np.exp(-1e-6 / (150 * c))
        for k in range(299):
            q[k + 1] = kept * q[k] + (1 - kept) * u[k]
        return q

    measured = simulate(1e-7) + 1e-3 * rng.normal(size=300)
    found = gb.fit(
        model,
        gb.Experiment.from_arrays(t, {"u": u}, {"q": measured}),
        noise={"q": 1e-3},
        options=gb.FitOptions(at_rest=True),
    )
    exact = least_squares(lambda s: (simulate(s[0] * 1e-7) - measured) / 1e-3, [1.1])
    std = 1e-7 / np.linalg.norm(exact.jac)
    c = found.parameters["C"]
    assert not c.at_bound and c.value == pytest.approx(1e-7 * exact.x[0], abs=0.02 * std)
    assert c.std == pytest.approx(std, rel=0.1)


def test_a_constant_that_the_data_press_against_its_bound_is_at_it():
    record = run(100, 2)
    free, held = (gb.fit(lag(b, start=1.0, fixed=True), record).parameters["K"] for b in ((1e-9, 1e9), (1e-9, 1.5)))
    assert 1.8 < free.value < 2.2 and not free.at_bound
    assert held.at_bound and held.value == pytest.approx(1.5, rel=1e-6)


@pytest.mark.parametrize(("rows", "seed"), [(6, 1), (8, 2), (10, 3)])
def test_a_short_table_that_the_model_does_not_follow_is_named(rows, seed):
    """Of up to ten readings the noise is the residual's own, which is never above itself."""
    alone = run(rows, seed)
    # A lag under one step does not alternate from row to row.
    y = (-1.0) ** np.arange(rows)
    strange = gb.Experiment.from_arrays(alone.time, alone.inputs, {"y": y})
    found = gb.fit(lag(fixed=True), strange)
    assert find(found.findings, EstimationCode.MODEL_DOES_NOT_FOLLOW).values["best_fit"]["y"] < 50
    followed = gb.fit(lag(fixed=True), alone)
    assert EstimationCode.MODEL_DOES_NOT_FOLLOW not in [f.code for f in followed.findings]


def test_a_short_table_that_a_model_hardly_follows_is_not_explained():
    """The noise is then the residual itself, which nothing exceeds: what the model follows decides."""
    time = np.linspace(0.0, 4.0, 9)
    decay = Model(
        "decay",
        [State("x", "1", 1.0)],
        [],
        [Output("x", "1")],
        [Parameter("k", "1/s", 0.4, (0.0, 10.0))],
        lambda x, u, p: [Balance("decay", "1/s", 1, "x", loss=-p.k * x.x)],
    )
    wave, fall = np.sin(2 * time), np.exp(-0.5 * time)
    said = [str(gb.fit(decay, gb.Experiment("table", time, {}, {"x": x}))) for x in (wave, fall + 0.01 * wave)]
    assert said[0].startswith("decay does not explain its records")
    assert said[1].startswith("decay explains its records")
