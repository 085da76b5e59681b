"""A model whose units disagree is refused with every offender: balances, effects, outputs, starts."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp

import casadi as ca
import numpy as np
import pytest

from greybox import Balance, DryFriction, Effect, Input, Model, Output, Parameter, State, simulate
from greybox.base.errors import ModelError, UnitError
from greybox.extensions.export.python_model import to_python
from greybox.model.effects import effect as catalogue_effect
from greybox.shell.project import load_model_file


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


@pytest.mark.parametrize(
    ("output", "wanted", "computed"),
    [
        (lambda x, u, p: x.x / (1 * p.L), "deg", "has no unit, expected deg (it is computed in rad: "),
        (lambda x, u, p: x.x / (1 * p.L), "%", "has no unit, expected % (it is computed in 1: "),
        (lambda x, u, p: x.x, "mm", "has unit m, expected mm (it is computed in m: "),
    ],
)
def test_an_output_in_another_unit_of_its_quantity_is_told_what_to_declare(output, wanted: str, computed: str) -> None:
    with pytest.raises(UnitError) as refused:
        Model(
            "arm",
            states=[State("x", "m")],
            inputs=[Input("v", "m/s")],
            outputs=[Output("y", wanted, output)],
            parameters=[Parameter("L", "m", 1.0)],
            balances=lambda x, u, p: [Balance("position", "m/s", 1, "x", velocity=u.v)],
        )
    assert f"output 'y' {computed}declare it so, and records in {wanted} are converted)" in str(refused.value)


def test_right_models_pass() -> None:
    model = rig(zero=lambda x, u, p: 0, start=lambda p: 0.1, stopper=lambda x, u, p: -p.K * ca.fmax(x.x, 0))
    assert [b.state for b in model.system.balances] == [s.name for s in model.states]


def plain(rate_unit: str = "1") -> Model:
    """The logistic equation of plain numbers: a rate and a number are added."""
    return Model(
        "growth",
        states=[State("n", "1", 0.1)],
        inputs=[],
        outputs=[Output("n", "1")],
        parameters=[Parameter("r", rate_unit, 1.0)],
        balances=lambda x, u, p: [Balance("growth", "1", 1, "n", growth=p.r * x.n, crowding=-(x.n**2), drift=0.1)],
    )


def test_in_a_model_of_plain_numbers_time_is_one_too() -> None:
    assert plain().system.state_names == ("n",)
    with pytest.raises(UnitError, match="growth"):
        plain("1/s")


@pytest.mark.parametrize(
    "name", ["sensor_drift", "sensor_lag", "clock_skew", "drive_lag", "transport_delay", "input_gain"]
)
def test_an_effect_with_a_constant_in_seconds_leaves_a_model_of_plain_numbers_one(name: str) -> None:
    driven = Model(
        "growth",
        states=[State("n", "1", 0.1)],
        inputs=[Input("u", "1")],
        outputs=[Output("n", "1")],
        parameters=[Parameter("r", "1", 1.0)],
        balances=lambda x, u, p: [Balance("growth", "1", 1, "n", growth=p.r * x.n, crowding=-(x.n**2), drive=u.u)],
    )
    model = driven + catalogue_effect(name)
    written = to_python(model, Path(mkdtemp()) / "model.py")
    again = next(v for v in vars(load_model_file(written)).values() if isinstance(v, Model))
    assert again.system.parameter_names == model.system.parameter_names
    # A number and a reading times a second are still no sum for a model with units.
    with pytest.raises(UnitError, match="growth"):
        plain("1/s") + catalogue_effect("sensor_drift")


def test_an_effect_of_another_dimension_is_refused_by_a_model_of_plain_numbers() -> None:
    with pytest.raises(UnitError, match="'guess' has unit m, expected 1"):
        plain() + Effect("guess", "growth", [Parameter("c", "m/s", 1.0)], terms=lambda x, u, p: p.c)


@pytest.mark.parametrize(
    ("unit", "rate", "seconds"), [("g/h", "1/h", 3600.0), ("mg/s", "1/s", 1.0), ("g/min", "1/min", 60.0)]
)
def test_a_balance_counts_in_the_time_and_the_scale_of_its_unit(unit: str, rate: str, seconds: float) -> None:
    scale = 1e3 if unit.startswith("m") else 1.0
    model = Model(
        "demand",
        states=[State("y", "g", 0.0)],
        inputs=[Input("u", "g")],
        outputs=[Output("y", "g")],
        parameters=[Parameter("b", rate, 0.5), Parameter("m", "mg/g" if scale > 1 else "1", scale)],
        balances=lambda x, u, p: [Balance("demand", unit, 1, "y", growth=p.m * p.b * (u.u - x.y))],
    )
    time = np.linspace(0, 6 * seconds, 61)
    run = simulate(model, {"time": time, "u": np.full(61, 20.0)})
    # y = u (1 - exp(-b t)), t in the time of the rate
    np.testing.assert_allclose(run.outputs["y"], 20 * (1 - np.exp(-0.5 * time / seconds)), rtol=1e-6)
    written = to_python(model, Path(mkdtemp()) / "model.py")
    again = next(v for v in vars(load_model_file(written)).values() if isinstance(v, Model))
    np.testing.assert_allclose(simulate(again, {"time": time, "u": np.full(61, 20.0)}).outputs["y"], run.outputs["y"])


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
