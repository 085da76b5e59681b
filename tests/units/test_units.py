"""Units: what texts mean (against pint), what people call them, data, and every way an equation can be wrong."""

from __future__ import annotations

import math
import subprocess
import sys

import casadi as ca
import numpy as np
import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from greybox import Balance, DryFriction, Effect, Input, Model, Output, Parameter, State
from greybox.errors import ModelError, UnitError
from greybox.expressions.units import unit_of
from greybox.units import ONE, Unit, convert, format_unit, parse_unit, unit_converter, unit_name
from greybox.units.symbols import KNOWN, LONG, RUN_TOGETHER

PINT = pint.UnitRegistry()
SI = {"kg": "kilogram", "m": "meter", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole", "cd": "candela"}


def same_as_pint(unit: Unit, text: str) -> bool:
    """Whether ``unit`` is what pint, with a registry of its own, makes of ``text``."""
    ours = PINT.Quantity(unit.factor, "")
    for symbol, exponent in unit.dimensions:
        ours = ours * PINT.Quantity(1.0, SI[symbol]) ** exponent
    theirs = PINT.Quantity(1.0, text).to_base_units()
    return ours.dimensionality == theirs.dimensionality and math.isclose(ours.magnitude, theirs.magnitude, rel_tol=1e-9)


@pytest.mark.parametrize("symbol", [*KNOWN, *LONG])
def test_built_in_symbols_agree_with_pint(symbol: str) -> None:
    assert same_as_pint(parse_unit(symbol), symbol.replace("kilogramme", "kilogram").replace("Ohm", "ohm"))


@pytest.mark.parametrize(
    "text",
    [
        "N*s/m",
        "m^3/(s*Pa)",
        "V**0.5/s",
        "N/m/s",
        "kg m / s**2",
        "l/min",
        "psi",
        "inch/minute",
        "1/s",
        "W/(m**2*K)",
        "N*m",
    ],
)
def test_texts_agree_with_pint(text: str) -> None:
    assert same_as_pint(parse_unit(text), text)


@pytest.mark.parametrize("text", ["", "1", "-", "m/m", "rad", "N*s/(N*s)", "count"])
def test_no_unit(text: str) -> None:
    assert parse_unit(text) == ONE


def test_spellings_of_one_unit() -> None:
    assert (
        parse_unit("µm")
        == parse_unit("um")
        == parse_unit("micrometer")
        == parse_unit("1e-6 m")
        == parse_unit("0.001 mm")
    )
    assert parse_unit("m/s²") == parse_unit("m/s^2") == parse_unit("m*s**-2") == parse_unit("m*s^(-2)")
    assert parse_unit("m^(2/3)") * parse_unit("m^(1/3)") == parse_unit("m")
    assert parse_unit("Ω") == parse_unit("V/A") != parse_unit("kohm")
    assert parse_unit("J/(kg*degC)") == parse_unit("J/(kg*K)")
    assert hash(parse_unit("V*s/m")) == hash(parse_unit("N/A"))
    assert parse_unit("m") != "m"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("foo/s", "unit 'foo/s': 'foo' is not a unit; known: m, g, s, "),
        ("kNN", "unit 'kNN': 'kNN' is not a unit; "),
        ("dB", "unit 'dB': 'dB' is not a unit"),
        ("degC", "unit 'degC' has a zero point of its own, which an equation cannot hold; state it in K"),
        *(
            (text, f"unit {text!r}: {text!r} is not one symbol; write {better}")
            for text, better in RUN_TOGETHER.items()
        ),
        *(
            (text, f"unit {text!r} cannot be read; write symbols with *, / and ^, as in N*s/m")
            for text in ("N//m", "N*", "(N", "N)", "m^", "m^x", "0 m", "$", "N-m", "--", "m^(1/2")
        ),
    ],
)
def test_what_is_no_unit(text: str, message: str) -> None:
    with pytest.raises(ModelError) as error:
        parse_unit(text)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("(N)/(m)**3", "N/m^3"),
        ("(N)/((m)/(s))", "N*s/m"),
        ("(N)/(m)**2", "N/m^2"),
        ("(V)/(A)", "ohm"),
        ("(V)*(s)/(A)", "H"),
        ("(kg)*(m)/(s)**2", "N"),
        ("(1)/(m)", "1/m"),
        ("(N)/(N)", "1"),
        ("kilogram*meter", "kg*m"),
        ("newton second / metre", "N*s/m"),
        ("m**3/(s*Pa)", "m^3/(s*Pa)"),
        ("V**0.5/s", "V^0.5/s"),
        ("m**(2/3)", "m^(2/3)"),
        ("9.80665 N/kg", "9.80665 N/kg"),
        *(
            (text, text)
            for text in ("", "-", "1", "%", "N", "kPa", "N*s/m", "V/A", "kg*m/s^2", "1/s", "l/min", "1000 N")
        ),
    ],
)
def test_tidy(text: str, expected: str) -> None:
    assert format_unit(text) == expected
    assert parse_unit(format_unit(text)) == parse_unit(text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("kg*m/s^2", "N"),
        ("N/A*A/m*m", "N"),
        ("kg/s", "N*s/m"),
        ("J", "N*m"),
        ("N*m/s", "W"),
        ("A*V/m^2/s*s", "W/m^2"),
        ("Pa/s", "Pa/s"),
        ("V^0.5/s", "V^0.5/s"),
        ("m^3/(s*Pa)", "m^3/(Pa*s)"),
        ("m/s", "m/s"),
        ("kg*m^2", "kg*m^2"),
        ("kN", "1000 N"),
        ("mm/s", "0.001 m/s"),
        ("1/s", "1/s"),
        ("%", "0.01"),
        ("1", "1"),
    ],
)
def test_names_of_computed_units(text: str, expected: str) -> None:
    assert unit_name(parse_unit(text)) == expected
    assert parse_unit(expected) == parse_unit(text)


def test_a_computed_unit_takes_the_name_the_model_uses() -> None:
    assert unit_name(parse_unit("N/A"), ["m", "", "V*s/m"]) == "V*s/m"
    assert unit_name(parse_unit("kN"), ["N", "kN"]) == "kN"


@given(
    powers=st.dictionaries(st.sampled_from(["kg", "m", "s", "A", "K", "N", "V", "Pa"]), st.integers(-3, 3), max_size=4)
)
def test_a_name_means_its_unit(powers: dict[str, int]) -> None:
    unit = ONE
    for symbol, exponent in powers.items():
        unit = unit * parse_unit(symbol) ** exponent
    assert parse_unit(unit_name(unit)) == unit


def test_conversion_of_data() -> None:
    np.testing.assert_allclose(convert([0.0, 25.0], "degC", "K"), [273.15, 298.15])
    np.testing.assert_allclose(convert([300.0], "K", "degC"), [26.85])
    np.testing.assert_allclose(convert(212.0, "degF", "°C"), 100.0)
    np.testing.assert_allclose(convert(np.array([[1.0, 2.0]]), "mm", "m"), [[0.001, 0.002]])
    np.testing.assert_allclose(unit_converter("l/min", "m^3/s")([60.0]), [1e-3])
    np.testing.assert_allclose(convert([50.0], "%", ""), [0.5])
    np.testing.assert_allclose(convert([1.0], "degC/s", "K/s"), [1.0])


@pytest.mark.parametrize(("source", "target"), [("N", "m"), ("degC", "m"), ("", "degC"), ("V", "")])
def test_unlike_units_are_not_converted(source: str, target: str) -> None:
    with pytest.raises(UnitError) as error:
        convert([1.0], source, target)
    assert str(error.value).startswith(
        f"{source or '1'} cannot be converted to {target or '1'}: they measure different"
    )


def test_an_ordinary_model_does_not_wait_for_pint() -> None:
    code = "import sys, models.micro_actuator; sys.exit('pint' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# ---- the unit of an expression -------------------------------------------------------------------------------------

UNITS = {"x": "m", "y": "m", "v": "m/s", "F": "N", "r": "", "k": "N/m", "mm": "mm", "t": "s", "angle": "deg"}
x, y, v, F, r, k, mm, t, angle = (ca.SX.sym(symbol) for symbol in UNITS)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (x + y, "m"),
        (x - 2 * y, "m"),
        (-x * k, "N"),
        (x + v * t, "m"),
        (ca.fmin(x, y), "m"),
        (ca.fmax(x, 0), "m"),
        (ca.fmin(x, ca.inf), "m"),
        (x * x, "m^2"),
        (2 * x, "m"),
        (1 / x, "1/m"),
        (x**3, "m^3"),
        (x**-2, "1/m^2"),
        (ca.sqrt(x), "m^0.5"),
        (x**1.5, "m^1.5"),
        (x / v, "s"),
        (r**r, ""),
        (2**r, ""),
        (ca.exp(-x / y), ""),
        (F * ca.tanh(v * t / y), "N"),
        (ca.log10(r), ""),
        (ca.sin(r) + ca.erf(r) + ca.log1p(r) + ca.expm1(r) + ca.floor(r), ""),
        (ca.atan2(x, y), ""),
        (ca.hypot(x, y), "m"),
        (F * ca.sign(v), "N"),
        (ca.fabs(v), "m/s"),
        (ca.copysign(x, v), "m"),
        (ca.fmod(x, y), "m"),
        (ca.if_else(v > 0, x, y), "m"),
        (ca.if_else(v > 0, x, 0), "m"),
        (ca.if_else(ca.logic_and(v > 0, x < y), 1, -1), ""),
        (k * x * (x > y), "N"),
        (x * 0, ""),
        (3.0, ""),
        (mm / x, "0.001"),
    ],
)
def test_unit_of_an_expression(value: ca.SX, expected: str) -> None:
    assert unit_of(value, UNITS) == parse_unit(expected)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (x + v, "adds m and m/s in 'x + v'"),
        (k * (x - r), "subtracts m and a number in 'x - r'"),
        (x + 1e-9, "adds m and a number in 'x + 1e-9'"),
        (x + mm, "adds m and mm in 'x + mm'"),
        (ca.fmin(x, v), "takes the smaller of m and m/s in 'min(x, v)'"),
        (ca.fmax(x, 1), "takes the larger of m and a number in 'max(x, 1)'"),
        (ca.hypot(x, v), "takes the length of m and m/s in 'hypot(x, v)'"),
        (ca.atan2(x, v), "takes the angle of m and m/s in 'atan2(x, v)'"),
        (ca.fmod(x, v), "takes the remainder of m and m/s in 'fmod(x, v)'"),
        (ca.if_else(x > v, x, 0), "compares m/s and m in 'v < x'"),
        (ca.if_else(x > 0, x, v), "adds m and m/s in 'if(x > 0, x, v)'"),
        (ca.if_else(x, r, 0), "if needs a number without unit, has m in 'if(x, r, 0)'"),
        (ca.exp(x), "exp needs a number without unit, has m in 'exp(x)'"),
        (F * ca.tanh(v), "tanh needs a number without unit, has m/s in 'tanh(v)'"),
        (ca.floor(x), "floor needs a number without unit, has m in 'floor(x)'"),
        (ca.sin(angle), "sin needs a number without unit, has deg in 'sin(angle)'"),
        (x**r, "raises m to a power that is not a number in 'x^r'"),
        (r**x, "a power needs a number without unit, has m in 'r^x'"),
        (x + ca.SX.sym("w"), "uses 'w', which is no state, input or parameter of the model"),
    ],
)
def test_expression_without_a_unit(value: ca.SX, message: str) -> None:
    with pytest.raises(UnitError) as error:
        unit_of(value, UNITS)
    assert message in str(error.value)


def test_a_vector_is_no_term() -> None:
    with pytest.raises(ModelError, match="has 2 rows and 1 columns; a term of an equation is one number"):
        unit_of(ca.vertcat(x, y), UNITS)


def test_deep_expressions_need_no_recursion() -> None:
    deep = x
    for _ in range(5000):
        deep = ca.fmax(deep, y) + x
    assert unit_of(deep, UNITS) == parse_unit("m")


# ---- the units of a model ------------------------------------------------------------------------------------------


def rig(
    storage: object = None, stiffness: str = "N/m", output: object = None, start: object = 0.0, **terms: object
) -> Model:
    """A mass on a spring, right unless told otherwise; ``terms`` are functions of (x, u, p) in the force balance."""

    def balances(x, u, p):
        force = {"drive": u.F, "spring": -p.K * x.x} | {name: term(x, u, p) for name, term in terms.items()}
        mass = storage(p) if storage else p.M
        return [Balance("position", "m/s", 1, "x", velocity=x.v), Balance("force", "N", mass, "v", **force)]

    return Model(
        "rig",
        states=[State("x", "m", start, role="displacement"), State("v", "m/s", role="velocity")],
        inputs=[Input("F", "N")],
        outputs=[Output("y", "m", output or (lambda x, u, p: x.x))],
        parameters=[Parameter("M", "kg", 1.0), Parameter("K", stiffness, 1.0, role="stiffness")],
        balances=balances,
    )


FORCE = "model 'rig': balance 'force' [N]:"
END = ". Correct the equation, or the unit of a parameter in it"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"stiffness": "N*m"}, f"{FORCE} term 'spring' has unit N*m^2, expected N"),
        ({"stiffness": "N/mm"}, f"{FORCE} term 'spring' has unit 1000 N, expected N"),
        ({"damping": lambda x, u, p: x.v}, f"{FORCE} term 'damping' has unit m/s, expected N"),
        ({"damping": lambda x, u, p: 2.0}, f"{FORCE} term 'damping' has no unit, expected N"),
        ({"odd": lambda x, u, p: p.K * (x.x + x.v)}, f"{FORCE} term 'odd': adds m and m/s in 'x + v'"),
        ({"storage": lambda p: p.K}, f"{FORCE} storage times dv/dt has unit N/s^2, expected N"),
        ({"storage": lambda p: p.M + 1}, f"{FORCE} storage times dv/dt: adds kg and a number in 'M + 1'"),
        ({"output": lambda x, u, p: x.v}, "model 'rig': output 'y' has unit m/s, expected m"),
        ({"start": lambda p: p.M}, "model 'rig': start of state 'x' has unit kg, expected m"),
        (
            {"stiffness": "[N]"},
            "model 'rig': parameter 'K': unit '[N]' cannot be read; "
            "write symbols with *, / and ^, as in N*s/m or m^3/(s*Pa)",
        ),
        (
            {"a": lambda x, u, p: x.x, "b": lambda x, u, p: x.v},
            f"{FORCE} term 'a' has unit m, expected N; balance 'force' [N]: term 'b' has unit m/s, expected N",
        ),
    ],
)
def test_mistakes_in_a_model(wrong: dict, message: str) -> None:
    with pytest.raises(UnitError) as error:
        rig(**wrong)
    assert str(error.value) == message + END


def test_right_models_pass() -> None:
    model = rig(zero=lambda x, u, p: 0, start=lambda p: 0.1, stopper=lambda x, u, p: -p.K * ca.fmax(x.x, 0))
    assert [b.state for b in model.system.balances] == [s.name for s in model.states]


def effect(site: str = "force", unit: str = "{force}", **functions: object) -> Effect:
    return Effect("guess", site, [Parameter("c", unit, 1.0)], **functions)


ON = "model 'rig + guess': "


@pytest.mark.parametrize(
    ("added", "message"),
    [
        (effect(terms=lambda x, u, p: p.c * x.v), "balance 'force' [N]: term 'guess' has unit W, expected N"),
        (
            effect(unit="{velocity}", dry=lambda x, u, p: DryFriction(p.c, p.c)),
            "balance 'force' [N]: sliding friction 'guess' has unit m/s, expected N",
        ),
        (
            effect(dry=lambda x, u, p: DryFriction(p.c, 1.5)),
            "balance 'force' [N]: static friction 'guess' has no unit, expected N",
        ),
        (
            effect(on_parameter=lambda x, u, p: {"stiffness": p.K * (1 - p.c * x.x)}),
            "effect 'guess' on parameter 'K': subtracts a number and N*m in '1 - c x'",
        ),
        (
            effect(on_parameter=lambda x, u, p: {"K": p.c}),
            "effect 'guess' on parameter 'K': has unit N, expected N/m",
        ),
        (
            effect(on_parameter=lambda x, u, p: {"Kk": p.c}),
            "effect 'guess': no parameter 'Kk' to change; did you mean 'K'? (known: M, K, c)",
        ),
        (
            effect("input", "{displacement}", on_input=lambda value, x, u, p: value * p.c),
            "effect 'guess' on input 'F': has unit N*m, expected N",
        ),
        (
            effect("sensor", on_output=lambda value, x, u, p: value + p.c),
            "effect 'guess' on output 'y': adds m and N in 'measured value + c'",
        ),
        (effect(unit="{force}*"), "effect 'guess': unit '(N)*' cannot be read"),
    ],
)
def test_mistakes_in_an_effect(added: Effect, message: str) -> None:
    base = rig()
    with pytest.raises(ModelError) as error:
        base + added
    assert message in str(error.value)
    assert isinstance(error.value, UnitError) is str(error.value).startswith(ON)


def test_the_states_of_an_effect_are_checked_too() -> None:
    def creep(unit: str) -> Effect:
        return Effect(
            "creep",
            "force",
            [Parameter("tau", unit, 1.0)],
            states=[State("z", "{displacement}")],
            balances=lambda x, u, p: [Balance("creep", "{displacement}/s", 1, "z", pull=(x.x - x.z) / p.tau)],
        )

    right = rig() + creep("s")
    assert right.system.balances[-1].unit == "m/s"
    assert right.all_states[-1].unit == "m"
    with pytest.raises(UnitError, match=r"balance 'creep.creep' \[m/s\]: term 'pull' has no unit, expected m/s"):
        rig() + creep("m")
