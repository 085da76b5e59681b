"""A base that moves: in its frame a second mass on the body feels the acceleration of the base as the body does."""

import numpy as np

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.model.effects.catalogue import effect

M, K, B, M2, K2, C2 = 2.0, 800.0, 4.0, 0.3, 300.0, 0.6
# Isolated body, position relative to the base.
ISOLATOR = Model(
    "isolator",
    states=[State("r", "m", role="displacement"), State("w", "m/s", role="velocity")],
    inputs=[Input("a", "m/s^2", role="base_acceleration")],
    outputs=[Output("r", "m")],
    parameters=[Parameter("M", "kg", M), Parameter("K", "N/m", K), Parameter("B", "N*s/m", B)],
    balances=lambda x, u, p: [
        Balance("position", "m/s", 1, "r", velocity=x.w),
        Balance("force", "N", p.M, "w", base=-p.M * u.a, spring=-p.K * x.r, damper=-p.B * x.w),
    ],
)


def test_a_second_mass_is_carried_by_the_base() -> None:
    """Against the same two masses in absolute coordinates, in small steps, on a base that is moved by a constant jerk a row."""
    period, rows, fine = 0.01, 200, 200
    a = np.repeat(np.random.default_rng(1).normal(size=rows // 10), 10)

    def rate(s: np.ndarray, acceleration: float) -> np.ndarray:
        base, base_speed, x, v, z, w = s
        on_second = K2 * (x - z) + C2 * (v - w)
        on_body = -K * (x - base) - B * (v - base_speed) - on_second
        return np.array([base_speed, acceleration, v, on_body / M, w, on_second / M2])

    s, h, expected = np.zeros(6), period / fine, []
    for held in a:
        expected.append(s[2] - s[0])
        for _ in range(fine):
            k1 = rate(s, held)
            k2 = rate(s + h / 2 * k1, held)
            s = s + h * k2
    model = (ISOLATOR + effect("second_mode")).start(m2=M2, k2=K2, c2=C2)
    run = gb.simulate(model, {"time": period * np.arange(rows), "a": a}, substeps=10)
    assert np.abs(run.outputs["r"] - expected).max() < 1e-4 * np.ptp(expected)
    plain = gb.simulate(ISOLATOR, {"time": period * np.arange(rows), "a": a})
    assert np.abs(plain.outputs["r"] - expected).max() > 0.1 * np.ptp(expected)
