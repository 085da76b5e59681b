"""Readings that start anew after a period: an angle between -180 and 180 degrees, a counter of 16 bits."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.data.findings import RecordCode
from greybox.extensions.export.python_model import to_python
from greybox.shell.project import find_model

SPINDLE = Model(
    "spindle",
    states=[State("a", "rad"), State("w", "rad/s")],
    inputs=[Input("T", "N*m")],
    outputs=[Output("a", "rad", wraps=2 * np.pi)],
    parameters=[Parameter("J", "kg*m^2", 1e-3, (1e-5, 1.0)), Parameter("B", "N*m*s/rad", 2e-3, (1e-5, 1.0))],
    balances=lambda x, u, p: [
        Balance("angle", "rad/s", 1, "a", speed=x.w),
        Balance("torque", "N*m", p.J, "w", motor=u.T, bearing=-p.B * x.w),
    ],
)


def write(path, angle, time, torque) -> None:
    rows = zip(time, torque, angle, strict=True)
    path.write_text(
        "t [s],T [N*m],a [deg]\n" + "".join(f"{t:.6g},{u:.9g},{a if a == '' else f'{a:.9g}'}\n" for t, u, a in rows)
    )


def test_an_angle_that_wraps_is_fitted_as_it_turns(tmp_path) -> None:
    time, rng = 0.01 * np.arange(400), np.random.default_rng(1)
    torque = 0.05 + 0.05 * np.repeat(rng.normal(size=40), 10)
    turned = gb.simulate(SPINDLE, {"time": time, "T": torque}).outputs["a"] + 1e-3 * rng.normal(size=400)
    degrees = list(np.rad2deg((turned + np.pi) % (2 * np.pi) - np.pi))
    degrees[100] = ""  # a gap does not stop it
    write(tmp_path / "run.csv", degrees, time, torque)
    record = gb.read_csv(tmp_path / "run.csv", SPINDLE)
    measured = np.isfinite(record.outputs["a"])
    assert np.allclose(record.outputs["a"][measured], turned[measured], atol=1e-7) and measured.sum() == 399
    (jumps,) = [f for f in record.findings if f.code is RecordCode.OUTPUT_UNWRAPPED]
    assert jumps.values["jumps"] == abs(round((turned[-1] - turned[0]) / (2 * np.pi))) > 2
    fit = gb.fit(SPINDLE.start(J=2e-3, B=1e-3), record, noise={"a": 1e-3})
    assert fit.parameters["J"].value == pytest.approx(1e-3, rel=0.01)
    assert "wraps=" in to_python(fit, tmp_path / "spindle_fitted.py").read_text()
    assert find_model(str(tmp_path / "spindle_fitted.py")).outputs[0].wraps == pytest.approx(2 * np.pi)


@pytest.mark.parametrize("period", [-1.0, float("nan"), float("inf")])
def test_a_period_is_above_zero(period: float) -> None:
    with pytest.raises(ModelError, match=r"output 'a': wraps = .*give a period above 0 in rad"):
        Output("a", "rad", wraps=period)


@pytest.mark.parametrize(
    ("rate", "gap", "uncertain"),
    [(3.0, 0, False), (3.0, 60, False), (3.0, 150, True), (-8.0, 45, True), (0.02, 150, False), (300.0, 0, True)],
    ids=["no gap", "a short gap", "a gap of half a turn", "a fast turn back", "nearly at rest", "sampled too slowly"],
)
def test_turns_that_nobody_saw_are_said_to_be_a_guess(tmp_path, rate, gap, uncertain) -> None:
    time, rng = 0.01 * np.arange(400), np.random.default_rng(2)
    turned = rate * time + 0.2 * np.sin(3 * time) * min(1.0, abs(rate)) + 1e-3 * rng.normal(size=400)
    degrees = list(np.rad2deg((turned + np.pi) % (2 * np.pi) - np.pi))
    for k in range(200, 200 + gap):
        degrees[k] = ""
    write(tmp_path / "run.csv", degrees, time, np.repeat(rng.normal(size=40), 10))
    record = gb.read_csv(tmp_path / "run.csv", SPINDLE)
    found = [f for f in record.findings if f.code is RecordCode.TURNS_UNCERTAIN]
    assert bool(found) == uncertain
    if uncertain and gap:
        (finding,) = found
        assert (finding.values["times"], finding.values["start"]) == (1, pytest.approx(1.99))
