"""Constants that others give, that each experiment has for itself, or that follow a condition: against closed forms and each other."""

from dataclasses import replace

import numpy as np
import pytest

from greybox import Balance, Experiment, Model, Parameter, fit, load_fit
from greybox.base.errors import ModelError
from tests.support.linear_regression import LINE, NOISE, REST, regression
from tests.support.pushed_mass import LEVEL, MASS, STARTS, irregular, record, with_gaps

PRESSED = replace(MASS, parameters=(*MASS.parameters, Parameter("P", "Pa", 1e5, (1e4, 1e6), fixed=True)))
TIED = MASS.tie(B="0.2*sqrt(K*M)")


def two(**second):
    return with_gaps(record(0)), irregular(record(1, x0=STARTS[1], name="day 2", **second))


def test_a_tie_is_the_formula_in_the_place_of_the_constant():
    written = Model(
        "mass",
        MASS.states,
        MASS.inputs,
        MASS.outputs,
        [q for q in MASS.parameters if q.name != "B"],
        lambda x, u, p: [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "N", p.M, "v", drive=u.u, damping=-0.2 * (p.K * p.M) ** 0.5 * x.v, spring=-p.K * x.x),
        ],
    )
    result, expected = fit(TIED, two(), noise=LEVEL), fit(written, two(), noise=LEVEL)
    assert result.uncertainty.free == ("K",) and result.solver.cost == pytest.approx(expected.solver.cost, rel=1e-10)
    k, b = result.parameters["K"], result.constraints.tied["B"]
    assert k.value == pytest.approx(expected.parameters["K"].value, rel=1e-9)
    assert k.std == pytest.approx(expected.parameters["K"].std, rel=1e-7)
    assert b.value == pytest.approx(0.2 * np.sqrt(k.value), rel=1e-12)
    assert b.std / b.value == pytest.approx(0.5 * k.std / k.value, rel=1e-6), "the delta method"
    assert result.constraints.ties == {"B": "0.2*sqrt(K*M)"} and "B" in str(result)


def test_a_tie_may_be_a_function_and_can_be_let_go(tmp_path):
    again = MASS.tie(B=lambda p: 0.2 * (p.K * p.M) ** 0.5)
    assert again.tied_values == pytest.approx(TIED.tied_values)
    assert TIED.start(K=1.0).tied_values["B"] == pytest.approx(0.2)
    loose = TIED.start(K=1.0).untie("B")
    assert loose.values["B"] == pytest.approx(0.2) and not loose.ties
    result = fit(TIED, two(), noise=LEVEL)
    assert load_fit(result.save(tmp_path / "fit.json"), MASS).constraints.tied == result.constraints.tied


def test_own_constants_beside_shared_ones_are_those_of_the_regression():
    """y = a u + b u^2 + c with an offset c of each record's own: least squares with an indicator of each record."""
    parts = [regression(seed=s) for s in (1, 2, 3)]
    data = [replace(e, name=f"day {k}") for k, (e, _, _) in enumerate(parts)]
    design = np.zeros((120, 5))
    for k, (_, x, _) in enumerate(parts):
        design[40 * k : 40 * k + 40, :2], design[40 * k : 40 * k + 40, 2 + k] = x[:, :2], 1.0
    y = np.concatenate([y for _, _, y in parts]) + np.repeat([0.0, 1.0, -0.5], 40)
    shifted = [replace(e, outputs={"y": y[40 * k : 40 * k + 40]}) for k, e in enumerate(data)]
    result = fit(LINE, shifted, per_experiment="c", noise={"y": 1.2 * NOISE}, options=REST)
    values, *_ = np.linalg.lstsq(design, y, rcond=None)
    spread = 1.2 * NOISE * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    ours = [
        result.parameters["a"],
        result.parameters["b"],
        *(result.constraints.per_experiment["c"][e.name] for e in shifted),
    ]
    assert [e.value for e in ours] == pytest.approx(values, rel=1e-8)
    assert [e.std for e in ours] == pytest.approx(spread, rel=1e-6)
    assert result.parameters["c"].value == pytest.approx(values[2:].mean(), rel=1e-8)
    mean = np.array([0, 0, 1, 1, 1]) / 3
    variance = mean @ np.linalg.inv(design.T @ design) @ mean
    assert result.parameters["c"].std == pytest.approx(1.2 * NOISE * np.sqrt(variance), rel=1e-6)


def test_a_scheduled_constant_meets_those_of_each_condition():
    """Two records at two pressures, a line through two points: the spring of each is its own."""
    one, other = two(stiffness=5.0)
    pressed = [replace(one, conditions={"P": 1e5}), replace(other, conditions={"P": 3e5})]
    scheduled = PRESSED.schedule("K", by="P", about=1e5)
    result, per_experiment = (
        fit(scheduled, pressed, noise=LEVEL),
        fit(MASS, [one, other], per_experiment=["K"], noise=LEVEL),
    )
    k, slope = result.parameters["K"].value, result.parameters["K_P"]
    assert k == pytest.approx(per_experiment.constraints.per_experiment["K"]["day 1"].value, rel=1e-6)
    assert k * (1 + 2 * slope.value) == pytest.approx(
        per_experiment.constraints.per_experiment["K"]["day 2"].value, rel=1e-6
    )
    assert abs(slope.value - 0.125) < 4 * slope.std < 0.01
    assert result.solver.cost == pytest.approx(per_experiment.solver.cost, rel=1e-9)


def test_a_constant_may_follow_a_measured_input():
    result = fit(MASS.schedule("B", by="u", about=2.0), two(), noise=LEVEL)
    assert abs(result.parameters["B_u"].value) < 4 * result.parameters["B_u"].std < 0.05


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: MASS.tie(B="K"), "has unit N/m, expected N\\*s/m"),
        (lambda: MASS.tie(Bb="B"), "no parameter 'Bb'; did you mean 'B'"),
        (lambda: MASS.tie(B="0.1*Kk"), "'Kk'.*did you mean 'K'"),
        (lambda: MASS.tie(M="K"), "M is fixed at 1 kg, so there is nothing to tie; first free\\('M'\\)"),
        (lambda: MASS.tie(B="0.4"), "no parameter in the formula; to give a number write fix\\(B=0.4\\)"),
        (lambda: MASS.tie(B="2*B"), "a parameter cannot be tied to itself"),
        (lambda: MASS.tie(B="200*sqrt(K*M)"), "gives 400 N\\*s/m, outside the bounds"),
        (lambda: TIED.tie(B="0.1*sqrt(K*M)"), "it is tied already, B = 0.2\\*sqrt\\(K\\*M\\); first untie"),
        (lambda: TIED.start(B=1.0), "set K or M instead"),
        (lambda: MASS.untie("B"), "'B' is not tied"),
        (
            lambda: fit(MASS, record(0), per_experiment=["K"]),
            "there is one experiment; a separate value for each experiment needs several",
        ),
        (lambda: fit(MASS, two(), per_experiment=["M"]), "'M' is fixed at 1 kg; first free\\('M'\\)"),
        (lambda: fit(MASS, two(), per_experiment=["K", "K"]), "'K' is named twice"),
        (lambda: fit(MASS, two(), per_experiment=["Kk"]), "'Kk'; did you mean 'K'"),
        (lambda: MASS.schedule("K", by="P", about=1.0), "'P'"),
        (lambda: PRESSED.schedule("K", by="P", about=0.0), "about 0 is not a valid reference"),
        (lambda: fit(TIED, [replace(record(0), conditions={"B": 1.0})]), "condition 'B' is tied"),
    ],
)
def test_what_cannot_be_is_refused_in_words(change, message):
    with pytest.raises(ModelError, match=message):
        change()


def test_the_pressure_is_known_and_not_fitted():
    given = [replace(record(0), conditions={"P": 1e5}), Experiment("bare", *_parts(record(1)))]
    with pytest.raises(ModelError, match="condition 'P' is free in the model but not given for experiment 2"):
        fit(PRESSED.free("P").schedule("K", by="P", about=1e5), given)


def _parts(data):
    return data.time, data.inputs, data.outputs
