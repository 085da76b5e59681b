"""What a delayed input was before a record: a file that is simulated says it, to whoever reads the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.data.findings import RecordCode
from greybox.simulation.simulate import write_csv

lag = Model(
    "lag",
    [State("x", "V")],
    [Input("u", "V")],
    [Output("x", "V")],
    [Parameter("T", "s", 0.5, (1e-2, 10.0))],
    lambda x, u, p: [Balance("b", "V", p.T, "x", fall=-x.x, drive=u.u)],
)
late = (lag + gb.effect("transport_delay")).bound(delay=(0.0, 1.0)).start(delay=0.33)
TIME = 0.05 * np.arange(80)


def write(path: Path, model: Model, before: float | None) -> Path:
    drive = 2.0 + np.sign(np.sin(2 * TIME + 0.1))
    told = {} if before is None else {"u": before}
    run = gb.simulate(model, Experiment("r", TIME, {"u": drive}, {}, before=told), initial={"x": 0.5})
    return write_csv(run.record(), model, path)


@pytest.mark.parametrize("before", [0.0, -1.25, 3.0])
def test_a_run_is_read_back_with_what_its_delayed_input_was(tmp_path: Path, before: float) -> None:
    record = gb.read_csv(write(tmp_path / "run.csv", late, before), late)
    assert record.before.get("u", record.inputs["u"])[0] == before
    again = gb.simulate(late, record, initial={"x": 0.5})
    np.testing.assert_allclose(again.outputs["x"], record.outputs["x"], rtol=1e-12)
    # 3 V is what the input is in its first row: nothing has to be said.
    said = [f.values["value"] for f in record.findings if f.code == RecordCode.CONDITION_READ]
    assert said == ([] if before == 3.0 else [before])
    assert gb.read_csv(tmp_path / "run.csv", late, before={"u": 7.0}).before["u"][0] == 7.0
    if before != 3.0:
        # In a unit of its own, as a person writes it.
        text = (
            (tmp_path / "run.csv")
            .read_text()
            .replace(f"# before u = {before!r} V", f"# before u [mV]: {1e3 * before:g}")
        )
        (tmp_path / "by_hand.csv").write_text(text)
        assert gb.read_csv(tmp_path / "by_hand.csv", late).before["u"][0] == pytest.approx(before)


def test_a_model_whose_inputs_act_at_once_says_nothing(tmp_path: Path) -> None:
    assert write(tmp_path / "run.csv", lag, 0.0).read_text().startswith("time [s],u [V],x [V]\n")
    assert write(tmp_path / "late.csv", late, None).read_text().startswith("time [s],u [V],x [V]\n")
