"""The equations of a model as text: every balance with the names of its terms, inputs, outputs, parameters."""

from __future__ import annotations

from textwrap import dedent

import greybox as gb
from greybox import Balance, DryFriction, Effect, Input, Model, Output, Parameter, State
from greybox.model.equations import equations_text, state_whole
from models.micro_actuator import micro_actuator
from tests.support.plants import actuator


def lines(block: str) -> str:
    return dedent(block).strip("\n")


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


def test_what_results_hold_does_not_follow_the_width_of_a_terminal():
    """An older result would be taken for one of another model."""
    wide = micro_actuator + gb.effect("stribeck_friction") + gb.effect("viscoelastic_creep")
    assert equations_text(wide) == equations_text(wide, 110) != equations_text(wide, 60)
    assert state_whole(wide)[0] == equations_text(wide)
