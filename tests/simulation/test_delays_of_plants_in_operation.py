"""What an input was before a record: its first value, what is told, or what a longer record holds; against a closed form."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.data.findings import RecordCode
from greybox.estimation.findings import EstimationCode
from greybox.estimation.predictor import predictor
from greybox.simulation.simulate import read_inputs

STEP, DELAY, TAU = 0.02, 0.13, 0.2


def lag(level=0.0):
    model = Model(
        "lag",
        [State("x", "K", level)],
        [Input("u", "K"), Input("d", "K")],
        [Output("x", "K")],
        [Parameter("tau", "s", TAU, (1e-3, 10.0)), Parameter("share", "1", 0.5, fixed=True)],
        lambda x, u, p: [Balance("mixing", "K", p.tau, "x", inlet=u.u, side=p.share * u.d, outlet=-x.x)],
    )
    return (model + gb.effect("transport_delay")).bound(delay=(0.0, 0.3)).start(delay=DELAY)


def exact(u, d, before, start, first=0):
    """The lag under held inputs, ``u`` late by six and a half rows: the exact step of each half interval, from row ``first`` on."""
    late = np.concatenate([np.full(7, before), u])
    x, half = [start], np.exp(-STEP / 2 / TAU)
    for k in range(first, len(u) - 1):
        for part in (late[k], late[k + 1]):
            target = part + 0.5 * d[k]
            x.append(target + (x[-1] - target) * half)
    return np.array(x[::2])


def drive(level, rows=300, seed=1):
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.normal(size=rows // 15), 15)
    steps[:15] = 0.0
    return level + steps, 0.3 * np.repeat(rng.normal(size=rows // 10), 10)


@pytest.mark.parametrize("level", [0.0, 330.0, -5.0])
@pytest.mark.parametrize("told", [None, 7.0])
def test_a_run_begins_with_what_the_input_was(level, told):
    u, d = drive(level)
    record = gb.Experiment(
        "run", STEP * np.arange(len(u)), {"u": u, "d": d}, {}, before={} if told is None else {"u": told}
    )
    run = gb.simulate(lag(level), record)
    expected = exact(u, d, u[0] if told is None else told, level)
    assert run.outputs["x"] == pytest.approx(expected, abs=1e-6 * max(1.0, abs(level)))


def test_a_constant_input_changes_nothing():
    flat = np.full(50, 5.0)
    run = gb.simulate(lag(5.0), {"time": STEP * np.arange(50), "u": flat, "d": 0 * flat})
    assert run.outputs["x"] == pytest.approx(flat, abs=1e-12)


@pytest.mark.parametrize("level", [0.0, 330.0])
def test_the_delay_of_a_plant_in_operation_is_that_of_one_at_zero(level):
    u, d = drive(level)
    y = exact(u, d, u[0], level) + 0.01 * np.random.default_rng(2).normal(size=len(u))
    found = gb.fit(
        lag(level).start(delay=0.05, tau=0.4),
        gb.Experiment("run", STEP * np.arange(len(u)), {"u": u, "d": d}, {"x": y}),
    )
    delay = found.parameters["delay"]
    assert abs(delay.value - DELAY) < 4 * delay.std < 0.004


def test_rows_that_hang_on_what_nobody_recorded_do_not_count():
    u, d = drive(20.0)
    time = STEP * np.arange(len(u))
    kept = np.r_[0:100, 140:300]
    y = exact(u, d, u[0], 20.0) + 0.01 * np.random.default_rng(3).normal(size=len(u))
    holed = gb.Experiment("run", time[kept], {"u": u[kept], "d": d[kept]}, {"x": y[kept]})
    pieces = holed.split_at_time_gaps()
    assert len(pieces) == 2
    found = gb.fit(lag(20.0), pieces, noise={"x": 0.01})
    delay = found.parameters["delay"]
    assert abs(delay.value - DELAY) < 4 * delay.std < 0.004
    assert found.misfit["x"].noise_ratio < 1.15
    # Fifteen rows of 20 ms may be reached by a delay of up to 0.3 s.
    assert np.isnan(found.traces[1].measured["x"]).sum() == 15


def test_a_fit_bounds_a_delay_by_its_records():
    u, d = drive(0.0)
    y = exact(u, d, 0.0, 0.0) + 0.01 * np.random.default_rng(4).normal(size=len(u))
    model = Model("lag", lag().states, lag().inputs, lag().outputs, lag().parameters, lag().balances) + gb.effect(
        "transport_delay"
    )
    found = gb.fit(model, gb.Experiment("run", STEP * np.arange(len(u)), {"u": u, "d": d}, {"x": y}))
    assert found.parameters["delay"].value == pytest.approx(DELAY, abs=0.003)


def test_at_rest_an_input_that_moves_the_plant_began_with_the_record():
    """The plant rests at 0 K without the input and not under its first value; at 20 K it rests under that."""
    for level, before in ((0.0, 0.0), (20.0, 20.0)):
        u, d = drive(20.0)
        d[:15] = 0.0
        y = exact(u, d, before, level) + 0.01 * np.random.default_rng(5).normal(size=len(u))
        record = gb.Experiment("run", STEP * np.arange(len(u)), {"u": u, "d": d}, {"x": y})
        found = gb.fit(lag(level), record, noise={"x": 0.01}, options=gb.FitOptions(at_rest=True))
        delay = found.parameters["delay"]
        assert abs(delay.value - DELAY) < 4 * delay.std < 0.004 and found.misfit["x"].noise_ratio < 1.15


@pytest.mark.parametrize("at_rest", [True, False])
def test_a_run_tells_what_it_took_for_the_input_before(at_rest):
    """From 0 K under a first input of 1 K, where a fit at rest would take the input to have begun with the record."""
    u, d = drive(1.0)
    run = gb.simulate(lag(), gb.Experiment("run", STEP * np.arange(len(u)), {"u": u, "d": d}, {}))
    record = run.record({"x": 0.01}, np.random.default_rng(3))
    assert record.before["u"] == pytest.approx([1.0])
    found = gb.fit(lag(), record, noise={"x": 0.01}, options=gb.FitOptions(at_rest=at_rest))
    delay = found.parameters["delay"]
    assert abs(delay.value - DELAY) < 4 * delay.std < 0.004 and found.misfit["x"].noise_ratio < 1.15


def test_a_sensor_that_no_record_holds_asks_nothing_of_the_past():
    model = lag()
    silent = Output("rate", "K/s", lambda x, u, p: (u.d - x.x) / p.tau)
    two = Model("lag", model.states, model.inputs, [*model.outputs, silent], lag().parameters[:2], model.balances)
    u, d = drive(0.0)
    y = exact(u, d, 0.0, 0.0) + 0.01 * np.random.default_rng(4).normal(size=len(u))
    record = gb.Experiment("run", STEP * np.arange(len(u)), {"u": u, "d": d}, {"x": y})
    for delayed in (model, (two + gb.effect("transport_delay")).bound(delay=(0.0, 0.3)).start(delay=DELAY)):
        found = gb.fit(delayed, record, noise={"x": 0.01}, options=gb.FitOptions(at_rest=True))
        assert found.parameters["delay"].value == pytest.approx(DELAY, abs=4 * found.parameters["delay"].std)
        assert not warnings_of_the_past(found)


def test_a_window_of_a_file_of_inputs_knows_the_rows_before_it(tmp_path):
    u, d = drive(1.0)
    u[:20] = 4.0
    file = tmp_path / "drive.csv"
    rows = "\n".join(f"{STEP * k!r},{a!r},{b!r}" for k, (a, b) in enumerate(zip(u.tolist(), d.tolist(), strict=True)))
    file.write_text(f"time [s],u [K],d [K]\n{rows}\n")
    part = read_inputs(file, lag(), hold="zero", window=(STEP * 22, None))
    run = gb.simulate(lag(), part)
    assert run.outputs["x"] == pytest.approx(exact(u, d, u[0], 0.0, first=22), abs=1e-9)


def warnings_of_the_past(result):
    return [f for f in result.findings if f.code == EstimationCode.INPUT_BEFORE_OPEN]


def drive_in_motion():
    """From 16 K under an input that was 12 K before and is 20 K in the first row."""
    u, d = drive(20.0)
    y = exact(u, d, 12.0, 16.0) + 0.01 * np.random.default_rng(2).normal(size=len(u))
    return STEP * np.arange(len(u)), {"u": u, "d": d}, {"x": y}


@pytest.mark.parametrize("told", [None, 12.0])
def test_the_first_rows_of_a_record_in_motion_tell_the_past_of_the_rest(told):
    record = gb.Experiment("run", *drive_in_motion(), before={} if told is None else {"u": told})
    found = gb.fit(lag(20.0), record, noise={"x": 0.01})
    notes = [f for f in found.findings if f.code == RecordCode.ROWS_OF_PAST]
    assert len(notes) == (told is None) and not warnings_of_the_past(found)
    # Fifteen rows of 20 ms may be reached by a delay of up to 0.3 s.
    left_out = 15 if told is None else 0
    assert found.traces[0].time[0] == pytest.approx(left_out * STEP)
    if notes:
        assert notes[0].values["rows"] == left_out and "--before INPUT=VALUE" in str(notes[0])
    assert found.misfit["x"].noise_ratio < 1.1
    assert found.parameters["delay"].value == pytest.approx(DELAY, abs=4 * found.parameters["delay"].std)


def test_a_short_record_in_motion_asks_for_what_the_input_was():
    time, inputs, outputs = drive_in_motion()
    first = ({n: v[:50] for n, v in signals.items()} for signals in (inputs, outputs))
    record = gb.Experiment("run", time[:50], *first)
    found = gb.fit(lag(20.0), record, noise={"x": 0.01})
    (note,) = warnings_of_the_past(found)
    assert note.values["first"] == record.inputs["u"][0]
    assert "--before u=VALUE" in str(note)
    # The remedy: what follows knows its past.
    later = record.window(int(np.ceil(note.values["until"] / STEP)), record.rows)
    assert not warnings_of_the_past(gb.fit(lag(20.0), later, noise={"x": 0.01}))


def test_a_record_that_begins_at_rest_asks_for_nothing():
    u, d = drive(20.0)
    # The other input moves the plant before the delayed one arrives.
    y = exact(u, d, 20.0, 20.0 + 0.5 * d[0]) + 0.01 * np.random.default_rng(2).normal(size=len(u))
    record = gb.Experiment("run", STEP * np.arange(len(u)), {"u": u, "d": d}, {"x": y})
    assert not warnings_of_the_past(gb.fit(lag(20.0), record, noise={"x": 0.01}))


def test_an_input_that_began_with_its_record_is_that_everywhere():
    u, d = np.full(200, 5.0), np.zeros(200)
    y = exact(u, d, 0.0, 0.0) + 0.01 * np.random.default_rng(2).normal(size=200)
    record = gb.Experiment("run", STEP * np.arange(200), {"u": u, "d": d}, {"x": y})
    found = gb.fit(lag(), record, noise={"x": 0.01}, options=gb.FitOptions(at_rest=True))
    (trace,) = found.traces
    assert trace.experiment.before["u"] == 0.0
    run = gb.simulate(found.model, trace.experiment, initial=trace.initial_state)
    assert run.outputs["x"] == pytest.approx(trace.simulated["x"], abs=1e-12)
    assert trace.simulated["x"] == pytest.approx(exact(u, d, 0.0, 0.0), abs=0.01)


def test_a_prediction_has_all_rows_of_a_record_in_motion():
    """What is fitted and judged leaves the first rows out; what is predicted is of each row, from the first state that is given."""
    record = gb.Experiment("run", *drive_in_motion())
    found = gb.fit(lag(20.0), record, noise={"x": 0.01})
    begun = predictor(found).simulate(record, initial={"x": 16.0})["x"]
    assert len(begun) == len(gb.predict(found, record)["x"]) == record.rows
    assert begun[0] == pytest.approx(16.0)
    assert gb.validate(found, record).misfit["x"].samples == record.rows - 7  # 0.13 s reach into seven rows
