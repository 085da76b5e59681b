"""The terms that a balance may lack: their units close, each is written once, constants keep out of the way of variables."""

from dataclasses import replace

import numpy as np
import pytest
import sympy

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.units import parse_unit
from greybox.discovery.laws.terms import ConstantNames, claimed_name, describe_laws, list_terms, write_effect

T = np.linspace(0, 1, 50)
VALUES = {"x": 1e-3 * np.sin(9 * T), "v": 9e-3 * np.cos(9 * T), "F": 2 + np.sin(5 * T)}


def rig() -> Model:
    def balances(x, u, p):
        return [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x),
        ]

    return Model(
        "rig",
        states=[State("x", "m"), State("v", "m/s")],
        inputs=[Input("F", "N")],
        outputs=[Output("x", "m")],
        parameters=[Parameter("M", "kg", 1.0, (0.1, 10)), Parameter("K", "N/m", 50.0, (1, 1e4))],
        balances=balances,
    )


@pytest.fixture(scope="module")
def terms():
    return list_terms(rig(), [("force", "N")], VALUES)


def test_units_close_for_every_term(terms):
    model = rig()
    for term in terms[::7]:
        effect = term.to_effect("law", 1.0, 1e-3, 0.1, term.shape_bounds(VALUES), 1.0)
        assert (model + effect).system  # the model's own check of units is the oracle
    cubic = next(t for t in terms if t.formula == "k*x**3")
    assert parse_unit(cubic.amplitude_unit) == parse_unit("N/m^3")


def test_products_and_functions_are_there_and_the_simplest_come_first(terms):
    formulas = {t.formula for t in terms if not t.has_memory}
    assert {"k", "k*x**3", "k*x*v", "k*abs(v)*v", "k*sign(v)", "k*max(0, x - c)", "k*tanh(v/c)"} <= formulas
    assert [t.complexity for t in terms] == sorted(t.complexity for t in terms)
    assert any(t.has_memory for t in terms)


@pytest.mark.rest
def test_no_two_terms_are_equal_up_to_algebra(terms):
    static = [t for t in terms if not t.has_memory and t.complexity <= 5]
    names = {n: sympy.Symbol(n, real=True) for n in (*VALUES, "k", "c")}
    written = [sympy.simplify(sympy.sympify(t.formula, locals=names)) for t in static]
    assert len(set(written)) == len(written)


def test_a_sine_needs_an_angle_or_a_number(terms):
    assert not [t for t in terms if "sin(x)" in t.formula]
    assert [t for t in terms if t.formula == "k*sin(x/c)"]


def test_constants_do_not_hide_variables():
    assert ConstantNames.beside(["c", "a"]) == ConstantNames("k", "c_law", "T")


def test_a_negative_constant_is_written_as_a_number():
    """The equation must be one that SymPy reads."""
    (bias,) = [t for t in list_terms(rig(), [("force", "N")], VALUES) if not t.factors]
    model = rig() + bias.to_effect("law", -2.5, 1.0, 0.0, (-np.inf, np.inf), 1.0)
    text = write_effect(model, model.effects[0])
    assert float(sympy.sympify(text)) == -2.5


@pytest.mark.parametrize(
    ("formula", "kind"),
    [
        ("k", "bias"),
        ("k*x", "linear"),
        ("k*x*v", "mass_action"),
        ("k*v**2", "crowding"),
        ("k*x**2", None),
        ("k*x**3", "hardening"),
        ("k*abs(v)*v", "quadratic_drag"),
        ("k*sign(v)", "dry_friction"),
        ("k*tanh(v/c)", "dry_friction"),
        ("k*max(0, x - c)", "stop"),
        ("k*(x/(c + abs(x)))", "saturation"),
        ("k*(x**2/(c**2 + x**2))", "switch"),
        ("k*sin(x/c)", "periodic"),
        ("k*F*(x/(c + abs(x)))", "saturation"),
    ],
)
def test_a_law_is_known_by_what_it_behaves_as(terms, formula, kind):
    term = next(t for t in terms if t.formula == formula and not t.has_memory)
    model = rig() + term.to_effect("law", 2.0, 1e-3, 0.0, term.shape_bounds(VALUES), 1.0)
    (law,) = describe_laws(model, {"x": (-1e-3, 1e-3), "v": (-9e-3, 9e-3), "F": (1.0, 3.0)})
    assert (law.formula, law.site, law.unit, set(law.seen)) == (formula, "force", "N", set(term.variables))
    assert (law.likeness.kind if law.likeness else None) == kind
    if kind in ("stop", "saturation", "switch"):
        assert (law.likeness.variable, law.likeness.place_unit) == ("x", "m") and law.likeness.place > 0


def test_a_law_with_memory_says_so(terms):
    term = next(t for t in terms if t.formula == "k*x" and t.has_memory)
    effect = term.to_effect("law", 2.0, 1.0, 0.1, (-np.inf, np.inf), 1.0)
    (law,) = describe_laws(rig() + effect, {"x": (-1e-3, 1e-3)})
    assert law.equation == "lag(2*x, 0.1)" and law.memory == "m" and law.likeness.kind == "memory"
    assert law.claimed == claimed_name(effect) == "lag(k*x)"


def test_a_law_is_claimed_by_its_formula_and_an_effect_by_its_name(terms):
    effect = next(t for t in terms if t.formula == "k*x" and not t.has_memory).to_effect(
        "law_2", 2.0, 1.0, 0.0, (-np.inf, np.inf), 1.0
    )
    assert claimed_name(effect) == "k*x"
    # A second branch is another effect than the law that it corrects.
    assert claimed_name(replace(effect, name="law_2_second_branch")) == "k*x_second_branch"
    assert claimed_name(replace(effect, name="drag")) == "drag"
