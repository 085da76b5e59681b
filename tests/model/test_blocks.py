"""Blocks: a long term under a short name, in equations, pages, exports and the check of units."""

import casadi as ca
import numpy as np
import pytest

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import UnitError
from greybox.extensions.export.python_model import to_python
from greybox.model import Block, equations_text
from greybox.shell.project import find_model
from greybox.show.documents.tables import typeset_equations


def weight(q, m):
    """A tree that is 2^40 operations long where nothing is shared."""
    value = m * ca.sin(q)
    for _ in range(40):
        value = ca.cos(value) + value
    return value


def arm(block: Block) -> Model:
    return Model(
        "arm",
        states=[State("tau", "N*m")],
        inputs=[Input("q", "rad"), Input("v", "rad/s", role="velocity")],
        outputs=[Output("tau", "N*m")],
        parameters=[Parameter("m", "kg*m", 1.5), Parameter("B", "N*m*s/rad", 0.2)],
        balances=lambda x, u, p: [
            Balance("joint", "N*m", 0, "tau", motor=x.tau, oil=-p.B * u.v, body=block_of(block, u.q, p.m))
        ],
    )


def block_of(block, q, m):
    return Block(block.label, block.expression(q, m), block.unit)


LONG = arm(Block("-rigid body of 1 link", lambda q, m: -weight(q, m), "N*m"))


def test_equations_and_pages_show_the_name_and_the_full_one_on_request() -> None:
    text = equations_text(LONG)
    assert "0 = tau - B v - rigid body of 1 link" in " ".join(text.split())
    assert "body" in text.splitlines()[1]
    latex = typeset_equations(LONG).items[0].latex
    assert r"- \underset{\text{body}}{\text{rigid body of 1 link}}" in latex and len(latex) < 300
    full = equations_text(LONG, in_full=True)
    assert full.startswith(text) and "part_1 = " in full and "joint: rigid body of 1 link = -(" in full
    assert len(full) < 5000


def test_a_unit_that_is_told_is_the_balance_s_and_is_not_looked_for_inside() -> None:
    with pytest.raises(UnitError, match=r"term 'body' has unit kg, expected N\*m"):
        arm(Block("-body", lambda q, m: -9.81 * m * ca.sin(q), "kg"))
    with pytest.raises(UnitError, match="term 'body' has unit kg"):
        arm(Block("-body", lambda q, m: -9.81 * m * ca.sin(q)))


def test_a_block_computes_what_its_term_does_and_survives_a_file(tmp_path) -> None:
    plain = arm(Block("-weight", lambda q, m: -9.81 * m * ca.sin(q), "N*m"))
    again = find_model(str(to_python(plain, tmp_path / "arm.py")))
    for model in (plain, again):
        tau = model.system.output_function([], [0.3, 0.5], [1.5, 0.2])
        assert float(tau) == pytest.approx(0.2 * 0.5 + 9.81 * 1.5 * np.sin(0.3))
        assert "- weight" in equations_text(model)
