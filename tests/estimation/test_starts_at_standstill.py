"""Records that begin in motion, of a plant with dry friction whose first velocity is not measured: the search begins at standstill."""

from __future__ import annotations

import numpy as np
import pytest

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, effect, fit, simulate

NOISE = 1e-3
TRUTH = {"J": 1.5e-4, "b": 1.5e-4, "Fc": 0.015}


def drive() -> Model:
    """A DC drive of which the angle is measured, begun away from its constants."""
    return Model(
        "drive",
        states=[
            State("th", "rad", role="displacement"),
            State("w", "rad/s", role="velocity"),
            State("i", "A", role="current"),
        ],
        inputs=[Input("u", "V", role="drive")],
        outputs=[Output("th", "rad")],
        parameters=[
            Parameter("J", "kg*m^2", 1e-4, (1e-6, 1e-1), role="mass"),
            Parameter("b", "N*m*s", 2e-4, (1e-7, 1.0), role="damping"),
            Parameter("K", "N*m/A", 0.045, fixed=True, role="force_constant"),
            Parameter("R", "ohm", 1.2, fixed=True, role="resistance"),
            Parameter("L", "H", 8e-4, fixed=True, role="inductance"),
        ],
        balances=lambda x, u, p: [
            Balance("angle", "rad/s", 1, "th", rate=x.w),
            Balance("torque", "N*m", p.J, "w", motor=p.K * x.i, viscous=-p.b * x.w),
            Balance("voltage", "V", p.L, "i", source=u.u, resistance=-p.R * x.i, back_emf=-p.K * x.w),
        ],
    ) + effect("coulomb_friction")


@pytest.fixture(scope="module")
def records() -> list[Experiment]:
    """At rest first, then driven; cut into three, of which the later ones begin in motion."""
    t = np.arange(3000) * 1e-3
    levels = np.repeat(np.random.default_rng(3).choice([-20.0, -12.0, -6.0, 7.0, 13.0, 20.0], 20), 150)
    u = np.where(t < 0.3, 0.0, levels)
    true = drive().start(**TRUTH)
    run = simulate(true, {"time": t, "u": u}, initial={"th": 0.0, "w": 0.0, "i": 0.0})
    th = run.outputs["th"] + NOISE * np.random.default_rng(4).standard_normal(len(t))
    cuts = [slice(0, 1200), slice(1290, 2100), slice(2190, 3000)]
    return [Experiment(f"part {k}", t[c] - t[c][0], {"u": u[c]}, {"th": th[c]}) for k, c in enumerate(cuts)]


def test_a_search_that_stands_at_the_standstill_is_no_success(records):
    found = fit(drive().start(Fc=0.01), records, noise={"th": NOISE}, options=FitOptions(other_starts=0))
    assert not found.success or found.misfit["th"].noise_ratio < 1.1
