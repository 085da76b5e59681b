"""Sets without a name that object to an answer."""

from types import SimpleNamespace

import greybox as gb
from greybox.discovery.proposers import list_constants_in_place
from greybox.discovery.residual_noise import is_shape_correction


def two_bodies():
    return gb.Model(
        "two_bodies",
        states=[gb.State("v1", "m/s", role="velocity"), gb.State("v2", "m/s", role="velocity")],
        inputs=[gb.Input("f1", "N"), gb.Input("f2", "N")],
        outputs=[gb.Output("v1", "m/s"), gb.Output("v2", "m/s")],
        parameters=[gb.Parameter("m", "kg", 1.0), gb.Parameter("d", "N*s/m", 1.0)],
        balances=lambda x, u, p: [
            gb.Balance("first", "N", p.m, "v1", push=u.f1, slip=p.d * (x.v2 - x.v1)),
            gb.Balance("second", "N", p.m, "v2", push=u.f2, slip=p.d * (x.v1 - x.v2)),
        ],
    )


def test_a_constant_has_no_name_at_whatever_site_it_stands():
    rest = SimpleNamespace(model=two_bodies())
    constants = list_constants_in_place(gb.effect("coulomb_friction"), rest)
    assert len(constants) == 4 and {"f2", "second"} <= {c.site for c in constants}
    assert all(is_shape_correction(c.name) for c in constants)
    assert not list_constants_in_place(gb.effect("constant_load"), rest)
