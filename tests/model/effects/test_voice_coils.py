"""A coil whose textbook line has one constant for force and back EMF, and balances of other names."""

import numpy as np
import pytest

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.model.effects.catalogue import CATALOGUE, effect, find_placements


def speaker(role_of_back_emf: str = "") -> Model:
    emf = "Kv" if role_of_back_emf else "Bl"
    return Model(
        "speaker",
        states=[State("x", "m"), State("v", "m/s"), State("i", "A")],
        inputs=[Input("U", "V")],
        outputs=[Output("x", "m"), Output("i", "A")],
        parameters=[
            Parameter("M", "kg", 0.01),
            Parameter("K", "N/m", 1500.0),
            Parameter("Bl", "N/A", 5.0, role="force_constant"),
            Parameter("Re", "ohm", 6.0, role="resistance"),
            Parameter("Le", "H", 5e-4, role="inductance"),
            *([Parameter("Kv", "V*s/m", 4.0, role=role_of_back_emf)] if role_of_back_emf else []),
        ],
        balances=lambda x, u, p: [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("cone", "N", p.M, "v", motor=p.Bl * x.i, suspension=-p.K * x.x),
            Balance("coil", "V", p.Le, "i", amplifier=u.U, resistance=-p.Re * x.i, emf=-p[emf] * x.v),
        ],
    )


@pytest.mark.parametrize(("role", "emf"), [("", 5.0), ("back_emf_constant", 4.0)])
def test_force_and_back_emf_droop_together(role: str, emf: float) -> None:
    model = (speaker(role) + effect("force_constant_droop")).start(a=1e4)
    x, v, i, U = 2e-3, 0.3, 0.5, 4.0
    left = 1 - 1e4 * x**2
    rates = np.array(model.system.rhs_function([x, v, i], [U], list(model.values.values()))).ravel()
    assert rates == pytest.approx([v, (5.0 * left * i - 1500 * x) / 0.01, (U - 6 * i - emf * left * v) / 5e-4])


@pytest.mark.rest
def test_an_input_without_a_role_drives_the_coil() -> None:
    lacking = {p.name: p.missing for p in find_placements(speaker(), CATALOGUE) if p.effect is None}
    assert "winding_heating" not in lacking and "force_constant_droop" not in lacking
    assert lacking["eddy_current"] != ("input", "drive")
