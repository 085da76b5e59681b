"""What an input was before a record, for a plant that takes it late: against the answer of a lag, 1 - exp(-t / tau)."""

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError
from greybox.model.effects.catalogue import effect
from greybox.simulation.records import to_record

T, TAU, LATE, ROWS = 0.5, 4.0, 3.2, 60
TANK = gb.Model(
    "tank",
    states=[gb.State("level", "m")],
    inputs=[gb.Input("flow", "m")],
    outputs=[gb.Output("level", "m")],
    parameters=[gb.Parameter("tau", "s", TAU, (0.1, 100))],
    balances=lambda x, u, p: [gb.Balance("water", "m", p.tau, "level", inflow=u.flow, outflow=-x.level)],
)
MODEL = (TANK + effect("transport_delay")).bound(delay=(0, 8)).start(delay=LATE)
TIME = T * np.arange(ROWS)


def answer(low, high):
    """The level of a tank that stood at ``low``, and whose inflow steps to ``high`` at time zero."""
    return low + (high - low) * -np.expm1(-np.maximum(TIME - LATE, 0) / TAU)


@pytest.mark.parametrize("level", [-3.0, 0.7, 330.0])
@pytest.mark.parametrize("hold", ["zero", "first", "band-limited"])
def test_a_plant_at_rest_in_a_constant_input_stays_there(level, hold):
    record = gb.Experiment("rest", TIME, {"flow": np.full(ROWS, level)}, {}, hold)
    run = gb.simulate(MODEL, record, initial={"level": level})
    # The interpolating filter passes a constant to a part in a million.
    assert np.allclose(run.outputs["level"], level, rtol=1e-5 if hold == "band-limited" else 1e-9)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (5.0, 15.0), (330.0, 310.0)])
def test_a_step_in_the_first_row_from_what_was_told(low, high):
    record = gb.Experiment("step", TIME, {"flow": np.full(ROWS, high)}, {}, before={"flow": low})
    run = gb.simulate(MODEL, record, initial={"level": low})
    assert np.allclose(run.outputs["level"], answer(low, high), rtol=1e-9)


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("start", [1, 3, 20])
def test_a_window_knows_what_was_before_it(start, hold):
    flow = 300 + np.random.default_rng(2).normal(size=ROWS).cumsum()
    whole = gb.Experiment("whole", TIME, {"flow": flow}, {}, hold, before={"flow": 290.0})
    run = gb.simulate(MODEL, whole, initial={"level": 300.0})
    again = gb.simulate(MODEL, whole.window(start, ROWS), initial={"level": run.states["level"][start]})
    assert np.allclose(again.outputs["level"], run.outputs["level"][start:], rtol=1e-9)
    twice = whole.window(start, ROWS).window(4, ROWS - start)
    later = gb.simulate(MODEL, twice, initial={"level": run.states["level"][start + 4]})
    assert np.allclose(later.outputs["level"], run.outputs["level"][start + 4 :], rtol=1e-9)


def test_rows_before_a_hole_stand_where_they_were():
    """What is 1, 2, 3, 4 rows before the piece; in the hole nobody recorded it."""
    time, flow = np.r_[TIME[:10], TIME[12:]], np.r_[np.arange(10.0), np.arange(12.0, ROWS)]
    level = np.sin(time)
    pieces = gb.Experiment("hole", time, {"flow": flow}, {"level": level}).split_at_time_gaps(5)
    before = to_record(TANK, pieces[1]).before[-4:, 0]
    assert before[:2].tolist() == [8, 9] and np.isnan(before[2:]).all()


@pytest.mark.parametrize(
    ("before", "ages", "words"),
    [
        ({"heat": 1.0}, (), "no input 'heat'"),
        ({"flow": np.inf}, (), "give a finite number"),
        ({"flow": [1.0, 2.0]}, [1.0, 2.0], "above 0, falling"),
        ({"flow": [1.0, 2.0]}, [2.0], "one for each of the 1 ages"),
    ],
)
def test_what_says_nothing_of_the_past_is_refused(before, ages, words):
    with pytest.raises(DataError, match=words):
        gb.Experiment("record", TIME, {"flow": TIME}, {}, before=before, before_ages=np.array(ages))


def test_a_file_from_a_time_on_keeps_what_it_has_before(tmp_path):
    flow = np.round(300 + np.random.default_rng(3).normal(size=ROWS).cumsum(), 6)
    rows = np.column_stack([TIME, flow, flow])
    np.savetxt(tmp_path / "r.csv", rows, delimiter=",", header="time [s],flow [m],level [m]", comments="")
    part = gb.read_csv(tmp_path / "r.csv", MODEL, window=(10.0, None), before={"flow": 7.0})
    assert part.before["flow"].tolist() == [7.0, *flow[:20]]
    assert np.allclose(part.before_ages, 10.0 - T * np.arange(-1, 20))
