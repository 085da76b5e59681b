"""Slips in writing a model down: each is named, with the line where the file has one."""

from __future__ import annotations

import math
import re
import traceback

import casadi as ca
import pytest

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.model.signals import NamedValues
from greybox.model.system import unused_parameters


def spring(x, u, p):
    return [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", push=u.F, spring=-p.K * x.x),
    ]


def rig(**changes) -> Model:
    parts = {
        "name": "rig",
        "states": [State("x", "m"), State("v", "m/s")],
        "inputs": [Input("F", "N")],
        "outputs": [Output("x", "m")],
        "parameters": [Parameter("M", "kg", 1.0, (0.1, 10)), Parameter("K", "N/m", 50.0, (1, 1e4))],
        "balances": spring,
    }
    return Model(**(parts | changes))


@pytest.mark.parametrize("name", ["../../evil", "my rig+1", "a/b", "", "rig.v2", "a\\b"])
def test_a_name_that_is_no_file_name_is_refused(name):
    with pytest.raises(ModelError, match="use only letters, digits, _ and -"):
        rig(name=name)


@pytest.mark.parametrize("name", ["rig", "rig-2", "my_rig", "2nd", "größe"])
def test_ordinary_names_are_kept(name):
    assert rig(name=name).name == name


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inputs": [Input("time", "N")]}, "input 'time': a column of this name holds the time of a record"),
        ({"inputs": [Input("t", "N")]}, "input 't': a column of this name holds the time"),
        ({"outputs": [Output("t", "m", lambda x, u, p: x.x)]}, "output 't': a column of this name holds the time"),
        ({"inputs": [Input("names", "N")]}, "input 'names': this name is taken"),
        ({"parameters": [Parameter("replaced", "kg", 1.0)]}, "parameter 'replaced': this name is taken"),
        (
            {"states": [State("_values", "m"), State("v", "m/s")]},
            "state '_values': a name is a letter and then letters",
        ),
        ({"states": [State("x 1", "m"), State("v", "m/s")]}, "state 'x 1': a name is a letter"),
        ({"inputs": [Input("u=2", "N")]}, "input 'u=2': a name is a letter"),
    ],
)
def test_a_signal_that_could_not_be_reached_is_refused(changes, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        rig(**changes)


def test_every_public_attribute_of_the_namespace_is_refused_as_a_name():
    public = [name for name in dir(NamedValues) if not name.startswith("_")]
    assert public
    for name in public:
        with pytest.raises(ModelError, match="is taken"):
            rig(parameters=[Parameter(name, "kg", 1.0)])


def forgotten_return(x, u, p):
    spring(x, u, p)


def decides(x, u, p):
    return [*spring(x, u, p)[:1], Balance("force", "N", p.M, "v", spring=-p.K * x.x if x.x > 0 else 0 * p.K * x.x)]


def takes_the_larger(x, u, p):
    return [*spring(x, u, p)[:1], Balance("force", "N", p.M, "v", spring=-p.K * max(x.x, 0))]


def lost(x, u, p):
    return [*spring(x, u, p)[:1], Balance("force", "N", p.M, "v", push=u.F, spring=-p.K * math.sin(x.x))]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"balances": forgotten_return}, "balances returns nothing; end it with return [Balance(...), ...]"),
        ({"balances": lambda x, u, p: 3}, "balances returns 3; end it with return"),
        ({"balances": lambda x, u, p: [p.K]}, "as number 1 of its list; write Balance(...)"),
        ({"balances": decides}, "balances: a decision on a symbol (if, and, or, min, max), which has no value yet"),
        ({"balances": takes_the_larger}, "casadi.fmin or casadi.fmax"),
        ({"balances": lost}, "balance 'force', term 'spring' is not a number; use casadi.sin"),
        (
            {"outputs": [Output("y", "m")]},
            "output 'y' has no equation, and there is no state of that name; known: x, v",
        ),
        ({"outputs": [Output("y", "m", lambda x, u, p: x.x if x.x > 0 else 0)]}, "output 'y': a decision on a symbol"),
        ({"outputs": [Output("y", "m", lambda x, u, p: None)]}, "output 'y' is None; write an expression"),
    ],
)
def test_what_is_no_equation_is_named(changes, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        rig(**changes)


def test_the_traceback_of_a_decision_ends_in_its_line():
    with pytest.raises(ModelError) as error:
        rig(balances=decides)
    own = [frame for frame in traceback.extract_tb(error.value.__traceback__) if frame.filename == __file__]
    assert own[-1].name == "decides"
    assert "if x.x > 0" in own[-1].line


def test_if_else_of_casadi_is_the_remedy():
    def one_sided(x, u, p):
        return [*spring(x, u, p)[:1], Balance("force", "N", p.M, "v", spring=ca.if_else(x.x > 0, -p.K * x.x, 0))]

    assert rig(balances=one_sided).system.state_names == ("x", "v")


def test_constants_in_no_equation_are_listed():
    spare = Parameter("B", "N*s/m", 0.5)
    assert unused_parameters(rig().system) == ()
    assert unused_parameters(rig(parameters=[*rig().parameters, spare]).system) == ("B",)
    started = [State("x", "m", start=lambda p: p.x0), State("v", "m/s")]
    assert unused_parameters(
        rig(states=started, parameters=[*rig().parameters, Parameter("x0", "m", 1.0), spare]).system
    ) == ("B",)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.fix(M="a"), "parameter 'M': value 'a'; give a number, without its unit"),
        (lambda m: m.fix(M=None), "parameter 'M': value None; give a number"),
        (lambda m: m.start(K="5 N/m"), "parameter 'K': value '5 N/m'; give a number, without its unit"),
        (lambda m: m.bound(K=3), "parameter 'K': bounds 3; give (low, high), two numbers"),
        (lambda m: m.bound(K=("a", 4)), "parameter 'K': bounds ('a', 4); give (low, high)"),
        (lambda m: m.fix(Q="a", M="b"), "has no parameter 'Q'"),
    ],
)
def test_what_is_no_number_is_refused_as_a_value(change, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        change(rig())
    assert rig().fix(M="0.5").parameter("M").value == 0.5


def test_a_table_of_casadi_is_refused_with_what_to_write_instead():
    table = ca.interpolant("table", "linear", [[0.0, 1.0, 2.0]], [0.0, 0.5, 3.0])
    with pytest.raises(
        ModelError, match=r"term 'fan': calls a function of its own, such as casadi.interpolant.*greybox.Characteristic"
    ):
        Model(
            "tabled",
            states=[State("w", "rad/s")],
            inputs=[Input("T", "N*m")],
            outputs=[Output("w", "rad/s")],
            parameters=[Parameter("J", "kg*m^2", 1.0)],
            balances=lambda x, u, p: [Balance("torque", "N*m", p.J, "w", motor=u.T, fan=-table(x.w))],
        )


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: Parameter("k", 2.0, "1/s"),
            "parameter 'k': its unit is 2.0, which is no text; its value is '1/s', which is no number: write"
            ' Parameter("k", "1/s", 2.0, (low, high)) with name, unit, value and bounds',
        ),
        (lambda: Parameter("k", "1/s", None), "parameter 'k': its value is None, which is no number"),
        (lambda: Parameter("k", "1/s", 2.0, ("0", 1.0)), "its lower bound is '0', which is no number"),
        (lambda: Parameter("k", "1/s", 2.0, 5.0), "its lower bound is None, which is no number"),
        (lambda: State("x", 0.0), "state 'x': its unit is 0.0, which is no text"),
        (lambda: Input(1, "V"), "input 1: its name is 1, which is no text"),
        (lambda: Output("x", lambda x, u, p: x.x), "which is no text: write Output"),
    ],
)
def test_arguments_in_another_order_are_named(make, said):
    with pytest.raises(ModelError, match=re.escape(said)):
        make()


def test_another_value_does_not_keep_the_source_of_the_one_before() -> None:
    stated = Parameter("k", "N/m", 2.0, (0.0, 10.0), source="data sheet")
    model = Model(
        "spring",
        states=[State("x", "m")],
        inputs=[Input("f", "N")],
        outputs=[Output("x", "m")],
        parameters=[stated, Parameter("d", "N*s/m", 1.0)],
        balances=lambda x, u, p: [Balance("force", "N", p.d, "x", drive=u.f, spring=-p.k * x.x)],
    )
    sources = {
        "data sheet": (
            model,
            model.start(k=2.0),
            model.fix("k"),
            model.fix(k=2.0),
            model.bound(k=(1.0, 5.0)),
            model.start(d=3.0),
        ),
        "": (model.start(k=2.5), model.fix(k=2.5), model.start(k=2.5).start(k=2.0)),
    }
    for source, models in sources.items():
        assert {m.parameter("k").source for m in models} == {source}
