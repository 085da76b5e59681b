"""Equations as text: what stands there is what is meant, and reads as a person writes it."""

from __future__ import annotations

import math
import re
from textwrap import dedent
from unittest import mock

import casadi as ca
import pytest
from hypothesis import given
from hypothesis import strategies as st

from greybox import Balance, DryFriction, Effect, Input, Model, Output, Parameter, State
from greybox.expressions import text
from greybox.expressions.text import expression_text
from greybox.model.equations import equations_text

x, y, v, k, a, b = (ca.SX.sym(name) for name in ("x", "y", "v", "k", "a", "b"))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (x, "x"),
        (0, "0"),
        (2.5, "2.5"),
        (-1e-9 * x, "-1e-9 x"),
        (1.23456789e7 * x, "1.23457e7 x"),
        (x * ca.inf, "inf x"),
        (-k * x, "-k x"),
        (2 * x, "2 x"),
        (x / 2, "x/2"),
        (1 / x, "1/x"),
        (2 / x, "2/x"),
        (-x / (a * b), "-x/(a b)"),
        (x / y * a, "x a/y"),
        (x / (y / a), "x a/y"),
        (x * x, "x^2"),
        (x**3, "x^3"),
        (x**7, "x^7"),
        (x**-2, "1/x^2"),
        (x**-3, "1/x^3"),
        (x**1.5, "x^1.5"),
        (x**-0.5, "1/x^0.5"),
        ((x * y) ** 2, "(x y)^2"),
        ((x + y) ** 3, "(x + y)^3"),
        ((2 * x) ** 1.5, "(2 x)^1.5"),
        (x**a, "x^a"),
        (x ** (a + 1), "x^(a + 1)"),
        ((x + y) ** a, "(x + y)^a"),
        ((x**a) ** b, "(x^a)^b"),
        (x ** (a**b), "x^(a^b)"),
        ((x * a) ** b, "(x a)^b"),
        (2**x, "2^x"),
        (y * x**a, "y (x^a)"),
        (a + b - x, "a + b - x"),
        (a - (b + x), "a - (b + x)"),
        (a - (b - x), "a - (b - x)"),
        (-(a - b), "-(a - b)"),
        (a + (b - x), "a + b - x"),
        (-a - b, "-(a + b)"),
        (b - a - x, "b - a - x"),
        (a + 1, "a + 1"),
        (k * (1 - a * x**2) * y, "k (1 - a x^2) y"),
        ((a + b) / (x - y), "(a + b)/(x - y)"),
        (ca.sqrt(2 * a * x), "sqrt(2 a x)"),
        (ca.fabs(v), "|v|"),
        (ca.fabs(x * ca.fabs(v)), "abs(x |v|)"),
        (-k * ca.sign(v), "-k sign(v)"),
        (ca.tanh(v / a), "tanh(v/a)"),
        (ca.exp(-x / a), "exp(-x/a)"),
        (ca.log10(x), "log10(x)"),
        (ca.atan2(x, y) + ca.hypot(x, y), "atan2(x, y) + hypot(x, y)"),
        (ca.fmin(x, ca.fmax(y, 0)), "min(x, max(y, 0))"),
        (ca.if_else(x > 0, x, y), "if(x > 0, x, y)"),
        (ca.if_else(x <= a, x, 0), "if(x <= a, x, 0)"),
        (k * ca.if_else(x > 1e-9, -x, a + b), "k if(x > 1e-9, -x, a + b)"),
        (k * (x > y), "k (y < x)"),
        ((x < y) == a, "(x < y) == a"),
        (ca.logic_and(ca.logic_or(x < y, x < a + b), v), "((x < y) or (x < a + b)) and v"),
        (ca.if_else(ca.logic_or(x < y, a), x, y), "if((x < y) or a, x, y)"),
        (ca.if_else(ca.logic_and(x > 0, ca.logic_not(y > 0)), 1, 0), "if((x > 0) and (not (y > 0)), 1, 0)"),
        (ca.SX.sym("creep.tau") * x, "creep.tau x"),
    ],
)
def test_expression(value: ca.SX, expected: str) -> None:
    assert expression_text(value) == expected


def python(written: str) -> str:
    """The printed text as Python: powers, absolute values and the products that stand side by side."""
    written = re.sub(r"\|([^|]*)\|", r"abs(\1)", written).replace("^", "**").replace("if(", "choose(")
    return re.sub(r"(?<=[\w)])(?<!not) (?=[\w(])", "*", written)


SYMBOLS = {"x": 0.75, "y": 1.5, "v": -2.0, "k": 3.0}
FUNCTIONS = {"sqrt": math.sqrt, "tanh": math.tanh, "exp": math.exp, "choose": lambda c, p, q: p if c else q}
LEAVES = st.sampled_from([x, y, v, k, ca.SX(2.0), ca.SX(-1.0), ca.SX(0.5), ca.SX(3.0)])
ONE_OPERAND = st.sampled_from(
    [
        lambda e: -e,
        ca.fabs,
        ca.tanh,
        lambda e: ca.sqrt(ca.fabs(e)),
        lambda e: ca.exp(ca.tanh(e)),
        lambda e: e**2,
        lambda e: e**3,
        lambda e: e**-1,
        lambda e: ca.fabs(e) ** 1.5,
        lambda e: ca.fabs(e) ** -0.5,
        lambda e: ca.if_else(x < k, e, 1),
        lambda e: ca.if_else(x > k, 2, e),
        lambda e: (1 + ca.fabs(e)) ** y,
    ]
)
TWO_OPERANDS = st.sampled_from(
    [
        lambda e, f: e + f,
        lambda e, f: e - f,
        lambda e, f: e * f,
        lambda e, f: e / f,
        ca.fmin,
        ca.fmax,
        lambda e, f: ca.if_else(v > 0, e, f),
    ]
)


def grown(inner: st.SearchStrategy) -> st.SearchStrategy:
    one = st.builds(lambda function, e: function(e), ONE_OPERAND, inner)
    return one | st.builds(lambda function, e, f: function(e, f), TWO_OPERANDS, inner, inner)


@given(value=st.recursive(LEAVES, grown, max_leaves=12))
def test_the_text_evaluates_to_the_expression(value: ca.SX) -> None:
    function = ca.Function("f", [x, y, v, k], [value])
    expected = float(function(*SYMBOLS.values()))
    if not math.isfinite(expected) or abs(expected) > 1e6:
        return
    with mock.patch.object(text, "number_text", repr):  # all digits, and not the six that a person reads
        written = expression_text(value)
    names = SYMBOLS | FUNCTIONS | {"abs": abs, "min": min, "max": max}
    try:
        found = eval(python(written), {"__builtins__": {}}, names)
    except ZeroDivisionError:  # inside the branch that is not taken
        return
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6), written


def actuator() -> Model:
    """The micro-motion actuator of the literature in its three balances."""

    def balances(x, u, p):
        return [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "N", p.M, "v", coil=p.Kf * x.i, damping=-p.B * x.v, spring=-p.K * x.x),
            Balance("voltage", "V", p.La, "i", supply=u.u, resistance=-p.Ra * x.i, back_emf=-p.Kv * x.v),
        ]

    return Model(
        "actuator",
        states=[State("x", "m", role="displacement"), State("v", "m/s", role="velocity"), State("i", "A")],
        inputs=[Input("u", "V")],
        outputs=[Output("x", "m"), Output("i", "A")],
        parameters=[
            Parameter("M", "kg", 0.010, (1e-4, 1.0), source="weighed", fixed=True),
            Parameter("B", "N*s/m", 0.2691, (0.0, math.inf)),
            Parameter("K", "N/m", 5895.5, (10.0, 1e6)),
            Parameter("Kf", "N/A", 1.3932),
            Parameter("Kv", "V*s/m", 1.3932),
            Parameter("Ra", "ohm", 8.0),
            Parameter("La", "H", 0.5e-3, source="data sheet"),
        ],
        balances=balances,
        description="coil and flexure",
    )


def lines(block: str) -> str:
    return dedent(block).strip("\n")


def test_show() -> None:
    expected = lines("""
        actuator: coil and flexure
          position  [m/s]  dx/dt = v
                                   velocity
          force     [N]    M dv/dt = Kf i - B v     - K x
                                     coil   damping   spring
          voltage   [V]    La di/dt = u      - Ra i       - Kv v
                                      supply   resistance   back_emf
          inputs           u [V]
          outputs          x [m] = x,  i [A] = i
          parameters
            M   0.01    kg     fixed  [0.0001, 1]  weighed
            B   0.2691  N*s/m  free   [0, inf]
            K   5895.5  N/m    free   [10, 1e6]
            Kf  1.3932  N/A    free
            Kv  1.3932  V*s/m  free
            Ra  8       ohm    free
            La  0.0005  H      free                data sheet
    """)
    assert str(actuator()) == expected
    assert str(actuator()) == expected


def test_effects_are_written_out() -> None:
    stiction = Effect(
        "stiction",
        "force",
        [Parameter("Fc", "{force}", 1.0), Parameter("Fs", "{force}", 1.5)],
        dry=lambda x, u, p: DryFriction(p.Fc, p.Fs),
    )
    fading = Effect(
        "fading",
        "force",
        [Parameter("a", "1/{displacement}**2", 1.0)],
        on_parameter=lambda x, u, p: {"Kf": p.Kf * (1 - p.a * x.x**2)},
    )
    lag = Effect(
        "lag",
        "sensor",
        [Parameter("tau", "s", 0.1)],
        states=[State("z", "{sensor}")],
        balances=lambda x, u, p: [Balance("filter", "{sensor}", p.tau, "z", measured=x.x - x.z)],
        on_output=lambda value, x, u, p: x.z,
    )
    offset = Effect("offset", "input", [Parameter("u0", "{input}", 0.1)], on_input=lambda value, x, u, p: value + p.u0)
    model = actuator() + stiction + fading + lag + offset
    expected = lines("""
          position    [m/s]  dx/dt = v
                                     velocity
          force       [N]    M dv/dt = Kf (1 - a x^2) i - B v     - K x    - Fc sign(v)
                                       coil               damping   spring   stiction
          voltage     [V]    La di/dt = (u + u0) - Ra i       - Kv v
                                        supply     resistance   back_emf
          lag.filter  [m]    tau dz/dt = x - z
                                         measured
          standstill  [N]    stiction holds up to Fs
          inputs             u [V]
          outputs            x [m] = z,  i [A] = i
    """)
    assert dedent(equations_text(model)) == expected
    assert str(model).startswith("actuator + stiction + fading + lag + offset: coil and flexure\n  position ")
    assert "\n    a    1       1/m^2  free\n" in str(model)


def tank(terms: int) -> Model:
    def balances(x, u, p):
        flows = {f"inflow_number_{n}": p.long_constant * u.u * (1 + n) for n in range(terms)}
        return [Balance("volume", "m^3/s", p.A / p.eta, "h", leak=-p.long_constant * x.h / p.h0, **flows)]

    return Model(
        "tank",
        states=[State("h", "m")],
        inputs=[Input("u", "")],
        outputs=[Output("h", "m"), Output("half", "m", lambda x, u, p: x.h / 2)],
        parameters=[
            Parameter("A", "m^2", 1.0),
            Parameter("eta", "", 1.0),
            Parameter("h0", "m", 1.0),
            Parameter("long_constant", "m^3/s", 1.0),
        ],
        balances=balances,
    )


def test_a_long_balance_has_one_term_a_line() -> None:
    assert dedent(equations_text(tank(4))) == lines("""
        volume   [m^3/s]  (A/eta) dh/dt = -long_constant h/h0  leak
                                          + long_constant u    inflow_number_0
                                          + 2 long_constant u  inflow_number_1
                                          + 3 long_constant u  inflow_number_2
                                          + 4 long_constant u  inflow_number_3
        inputs            u [-]
        outputs           h [m] = h,  half [m] = h/2
    """)


def test_no_short_balance_is_wider_than_the_page() -> None:
    for terms in range(5):
        assert max(map(len, equations_text(tank(terms)).splitlines())) <= 110
    assert "= -long_constant h/h0 + long_constant u" in equations_text(tank(1))
