"""Balances that store nothing: their states are solved for, exactly where the relations are linear, by Newton's method elsewhere."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Effect, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError, UnitError
from greybox.base.numerics import RELATION_MET
from greybox.estimation.findings import EstimationCode
from greybox.extensions.export.python_model import to_python
from greybox.model.effects.catalogue import effect, find_placements
from greybox.model.effects.scales import measure_scales
from greybox.model.equations import equations_text
from greybox.shell.project import find_model


def _divider(x, u, p):
    return [
        Balance("store", "A", p.C, "q", charge=(x.n - x.q) / p.R2),
        Balance("node", "A", 0, "n", inflow=(u.u - x.n) / p.R1, outflow=-(x.n - x.q) / p.R2),
    ]


DIVIDER = Model(
    "divider",
    states=[State("n", "V"), State("q", "V")],
    inputs=[Input("u", "V")],
    outputs=[Output("n", "V"), Output("q", "V")],
    parameters=[
        Parameter("R1", "ohm", 2.0, (0.1, 100.0)),
        Parameter("R2", "ohm", 3.0, (0.1, 100.0)),
        Parameter("C", "F", 0.5, (0.01, 10.0), fixed=True),
    ],
    balances=_divider,
)


def _nozzle(x, u, p):
    supply = p.a * (u.ps - x.z) ** 0.5
    return [
        Balance("node", "m^3/s", 0, "z", valve=supply, line=-p.g * (x.z - x.p)),
        Balance("vessel", "m^3/s", p.V, "p", line=p.g * (x.z - x.p), outflow=-p.o * x.p),
    ]


NOZZLE = Model(
    "nozzle",
    states=[State("z", "Pa", 1e5, bounds=(0.0, 9e5), role="pressure"), State("p", "Pa")],
    inputs=[Input("ps", "Pa")],
    outputs=[Output("p", "Pa")],
    parameters=[
        Parameter("a", "m^3/s/Pa^0.5", 1e-6),
        Parameter("g", "m^3/s/Pa", 2e-9),
        Parameter("V", "m^3/Pa", 1e-9),
        Parameter("o", "m^3/s/Pa", 5e-10),
    ],
    balances=_nozzle,
)


def rate(model, x, u):
    return np.array(model.system.rhs_function(x, u, list(model.values.values()))).ravel()


def test_a_linear_relation_is_solved_exactly() -> None:
    assert DIVIDER.system.state_names == ("q",) and DIVIDER.system.linear
    assert rate(DIVIDER, [1.0], [6.0]) == pytest.approx([(6.0 - 1.0) / (2.0 + 3.0) / 0.5])
    y = np.array(DIVIDER.system.output_function([1.0], [6.0], list(DIVIDER.values.values()))).ravel()
    assert y == pytest.approx([1.0 + 3.0 * 5.0 / 5.0, 1.0])


@pytest.mark.parametrize(("pressure", "supply"), [(2e5, 7e5), (6.9e5, 7e5), (0.0, 8e5)])
def test_a_nonlinear_relation_is_solved_as_its_closed_form(pressure: float, supply: float) -> None:
    """``a sqrt(ps - z) = g (z - p)`` is quadratic in the root ``r`` of ``ps - z``: ``g r^2 + a r - g (ps - p) = 0``."""
    a, g = 1e-6, 2e-9
    root = (-a + (a**2 + 4 * g**2 * (supply - pressure)) ** 0.5) / (2 * g)
    flow = a * root
    assert rate(NOZZLE, [pressure], [supply]) == pytest.approx([(flow - 5e-10 * pressure) / 1e-9], rel=1e-9)
    sums, largest = NOZZLE.system.relations([pressure], [supply], list(NOZZLE.values.values()))
    assert abs(float(sums)) < RELATION_MET * float(largest)


def test_an_effect_acts_at_a_relation() -> None:
    """A leak at the node of the nozzle, proportional to its pressure, is part of what is solved."""
    places = {p.name: p for p in find_placements(NOZZLE, (effect("linear_leak"),))}
    assert places["linear_leak"].site == "node"
    leaking = (NOZZLE + effect("linear_leak")).start(kl=4e-10)
    a, g, k, pressure, supply = 1e-6, 2e-9, 4e-10, 2e5, 7e5
    # g (z - p) + k z = a r with z = ps - r^2
    root = (-a + (a**2 + 4 * (g + k) * ((g + k) * supply - g * pressure)) ** 0.5) / (2 * (g + k))
    z = supply - root**2
    assert rate(leaking, [pressure], [supply]) == pytest.approx([(g * (z - pressure) - 5e-10 * pressure) / 1e-9])
    scales = measure_scales(NOZZLE, np.array([[pressure]]), np.array([[supply]]), 0.1)
    assert scales.at("node").store == pytest.approx(supply - ((-a + (a**2 + 4 * g**2 * 5e5) ** 0.5) / (2 * g)) ** 2)


def test_the_equations_show_the_relation_as_it_was_written() -> None:
    text = equations_text(DIVIDER)
    assert "0 = (u - n)/R1 - (n - q)/R2" in " ".join(text.split())
    assert "n [V] = n" in text


def test_units_of_a_relation_are_checked() -> None:
    def balances(x, u, p):
        return [*_divider(x, u, p)[:1], Balance("node", "A", 0, "n", inflow=u.u / p.R1, outflow=-x.n)]

    with pytest.raises(UnitError, match=r"balance 'node' \[A\]: term 'outflow' has unit V, expected A"):
        Model("wrong", DIVIDER.states, DIVIDER.inputs, DIVIDER.outputs, DIVIDER.parameters, balances)


def test_a_relation_that_does_not_contain_its_state_is_refused() -> None:
    def balances(x, u, p):
        return [*_divider(x, u, p)[:1], Balance("node", "A", 0, "n", inflow=u.u / p.R1, outflow=-x.q / p.R2)]

    with pytest.raises(ModelError, match="balance 'node' stores nothing, and its terms do not determine n"):
        Model("wrong", DIVIDER.states, DIVIDER.inputs, DIVIDER.outputs, DIVIDER.parameters, balances)
    with pytest.raises(ModelError, match=r"no state 'n'|'n' has process noise"):
        DIVIDER.with_process_noise(n=0.1)


def test_a_model_with_a_relation_is_fitted_saved_and_searched(tmp_path) -> None:
    time, rng = 0.05 * np.arange(300), np.random.default_rng(1)
    u = np.repeat(rng.normal(size=30), 10)
    run = gb.simulate(DIVIDER, {"time": time, "u": u})
    noisy = {name: y + 1e-4 * rng.normal(size=300) for name, y in run.outputs.items()}
    record = gb.Experiment("run", time, {"u": u}, noisy)
    noise = {"n": 1e-4, "q": 1e-4}
    fit = gb.fit(DIVIDER.start(R1=1.0, R2=5.0), record, noise=noise)
    assert fit.parameters["R1"].value == pytest.approx(2.0, rel=1e-3)
    assert fit.parameters["R2"].value == pytest.approx(3.0, rel=1e-3)
    again = find_model(str(to_python(fit, tmp_path / "divider.py")))
    assert rate(again, [1.0], [6.0]) == pytest.approx(rate(fit.model, [1.0], [6.0]))
    lagging = Effect("q", "input", [Parameter("c", "1", 0.0)], on_input=lambda v, x, u, p: v * (1 - p.c))
    assert rate((DIVIDER + lagging).start(c=0.5), [1.0], [6.0]) == pytest.approx([(3.0 - 1.0) / 5.0 / 0.5])


@pytest.mark.parametrize(("size", "is_met"), [(1e5, True), (1e-30, False)])
def test_a_fit_tells_where_a_relation_was_not_solved(size: float, is_met: bool) -> None:
    """A flow with the third power of the pressure: from a start value that is hopelessly small ten steps lead nowhere near."""
    model = Model(
        "cubic",
        states=[State("z", "Pa", size, bounds=(0.0, 1e9)), State("p", "Pa", 1e4)],
        inputs=[Input("q", "m^3/s")],
        outputs=[Output("p", "Pa")],
        parameters=[
            Parameter("k", "m^3/s/Pa^3", 1e-18, fixed=True),
            Parameter("V", "m^3/Pa", 1e-7, (1e-9, 1e-5)),
            Parameter("o", "m^3/s/Pa", 1e-9, fixed=True),
        ],
        balances=lambda x, u, p: [
            Balance("node", "m^3/s", 0, "z", pump=u.q, line=-p.k * x.z**3),
            Balance("vessel", "m^3/s", p.V, "p", line=p.o * x.z, outflow=-p.o * x.p),
        ],
    )
    time, q = np.arange(100.0), 1e-3 * (1 + 0.5 * np.repeat(np.random.default_rng(2).uniform(size=10), 10))
    run = gb.simulate(model, {"time": time, "q": q})
    if is_met:  # the closed form
        z = (q / 1e-18) ** (1 / 3)
        assert run.outputs["p"][1] == pytest.approx(z[0] + (1e4 - z[0]) * np.exp(-0.01), rel=1e-6)
    noisy = run.outputs["p"] + 10 * np.random.default_rng(3).normal(size=100)
    fit = gb.fit(model.start(V=2e-7), gb.Experiment("r", time, {"q": q}, {"p": noisy}), noise={"p": 10.0})
    unmet = [f for f in fit.findings if f.code is EstimationCode.RELATION_NOT_MET]
    assert bool(unmet) is not is_met
    if is_met:
        assert fit.parameters["V"].value == pytest.approx(1e-7, rel=0.05)
