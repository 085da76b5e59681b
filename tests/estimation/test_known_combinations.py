"""What is determined of constants that are not: against the fit of a model that has the combination as its constant."""

from __future__ import annotations

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State
from greybox.estimation.findings import EstimationCode

TIME = 0.05 * np.arange(150)
DRIVE = np.sign(np.sin(1.3 * TIME))


def lag(names, rate, gain):
    """dx/dt = -rate x + gain u in plain numbers, both made of positive constants of these names."""
    return Model(
        "lag",
        [State("x", "1")],
        [Input("u", "1")],
        [Output("x", "1")],
        [Parameter(n, "1", start, (1e-3, 20)) for n, start in names.items()],
        lambda x, u, p: [Balance("b", "1", 1.0, "x", decay=-rate(p) * x.x, drive=gain(p) * u.u)],
    )


def known(fit):
    found = [f.values["determined"] for f in fit.findings if f.code == EstimationCode.DIRECTION_UNDETERMINED]
    return {v["text"]: (v["value"], v["std"], *v["interval"]) for each in found for v in each}


@pytest.mark.parametrize(
    ("names", "rate", "gain", "text", "kept"),
    [
        ({"a": 2.0, "b": 0.7, "c": 1.0}, lambda p: p.a - p.b, lambda p: p.c, "a - b", "r"),
        ({"a": 1.0, "b": 0.6, "c": 1.0}, lambda p: p.a + p.b, lambda p: p.c, "a + b", "r"),
        ({"a": 0.9, "b": 1.5, "c": 1.2}, lambda p: p.a, lambda p: p.b * p.c, "b c", "g"),
    ],
)
def test_the_combination_has_the_value_and_the_interval_of_a_constant_in_its_place(names, rate, gain, text, kept):
    run = gb.simulate(lag({"r": 1.3, "g": 1.4}, lambda p: p.r, lambda p: p.g), {"time": TIME, "u": DRIVE})
    noisy = run.outputs["x"] + 0.01 * np.random.default_rng(4).normal(size=len(TIME))
    record = Experiment("r", TIME, {"u": DRIVE}, {"x": noisy})
    given = {"noise": {"x": 0.01}, "options": FitOptions(at_rest=True)}
    whole = gb.fit(lag(names, rate, gain), record, **given)
    plain = gb.fit(lag({"r": 1.0, "g": 1.0}, lambda p: p.r, lambda p: p.g), record, **given)
    (found,) = known(whole).items()
    constant = plain.parameters[kept]
    assert found[0] == text
    assert found[1][0] == pytest.approx(constant.value, rel=1e-6)
    # One unknown more takes one of 148 degrees of freedom from the variance of the residual.
    assert found[1][1] == pytest.approx(constant.std * np.sqrt(148 / 147), rel=1e-5)
    # The interval of a positive constant is by a factor, that of a combination by a difference.
    assert found[1][2:] == pytest.approx(constant.interval, rel=1e-4)


def static(function, names, units, starts):
    """``y = function(p) u`` in volts."""
    return Model(
        "static",
        [State("x", "V")],
        [Input("u", "1")],
        [Output("y", "V", lambda x, u, p: function(p) * u.u)],
        [*(Parameter(n, unit, s, (1e-3, 20)) for n, unit, s in zip(names, units, starts, strict=True)), TAU],
        lambda x, u, p: [Balance("rest", "V", p.tau, "x", decay=-x.x)],
    )


TAU = Parameter("tau", "s", 1.0, fixed=True)


@pytest.mark.parametrize(
    ("function", "names", "units", "starts", "text", "unit"),
    [
        # Of equal constants a product and a sum have the same slope here, and a run tells which of them stays.
        (lambda p: p.a * p.b, "ab", ("V/A", "A"), (1.0, 1.0), "a b", "V"),
        (lambda p: p.a + p.b, "ab", ("V", "V"), (0.5, 0.5), "a + b", "V"),
        (lambda p: p.a * p.b / p.c, "abc", ("V", "1", "1"), (2.0, 3.0, 0.5), "a b/c", "V"),
        (lambda p: p.a + p.b - p.c, "abc", ("V", "V", "V"), (2.0, 3.0, 0.5), "a + b - c", "V"),
        (lambda p: p.a * p.b**2, "ab", ("V/m^2", "m"), (1.0, 0.7), "a b^2", "V"),
    ],
)
def test_products_and_sums_are_told_apart_and_have_their_units(function, names, units, starts, text, unit):
    u = np.linspace(0, 3, 60)
    y = 1.27 * u + 0.01 * np.random.default_rng(2).normal(size=60)
    record = Experiment("r", 0.1 * np.arange(60), {"u": u}, {"y": y})
    found = gb.fit(static(function, names, units, starts), record, noise={"y": 0.01}, options=FitOptions(at_rest=True))
    (values,) = known(found).items()
    # The slope of a line through the origin.
    assert values[0] == text and values[1][0] == pytest.approx(u @ y / (u @ u), rel=1e-6)
    residual = y - u * (u @ y) / (u @ u)
    variance = max(residual @ residual / (60 - len(names)), 1e-4)
    assert values[1][1] == pytest.approx(np.sqrt(variance / (u @ u)), rel=0.02)
    (finding,) = [f for f in found.findings if f.code == EstimationCode.DIRECTION_UNDETERMINED]
    assert [f["unit"] for f in finding.values["determined"]] == [unit]


def test_directions_that_share_constants_are_one_finding():
    names = [f"p{k}" for k in range(12)]
    starts = [1.0 + 0.1 * k for k in range(12)]
    model = static(
        lambda p: sum(getattr(p, n) for n in names[:9]) + p.p9 * p.p10 * p.p11 * 0,
        names,
        ("V",) * 9 + ("1", "1", "V"),
        starts,
    )
    u = np.linspace(0, 3, 60)
    record = Experiment(
        "r", 0.1 * np.arange(60), {"u": u}, {"y": 13.0 * u + 0.01 * np.random.default_rng(2).normal(size=60)}
    )
    found = gb.fit(model, record, noise={"y": 0.01}, options=FitOptions(at_rest=True))
    texts = [str(f) for f in found.findings if f.code == EstimationCode.DIRECTION_UNDETERMINED]
    assert "9 of 12 constants share 8 free directions" in texts[0] and len(texts[0]) < 200
    assert len(found.starts) == 0
