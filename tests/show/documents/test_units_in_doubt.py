"""A unit that no header states is among the first notes: of a check always, of a fit where the model does not explain its records."""

import numpy as np
import pandas as pd

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.data.findings import RecordCode
from greybox.estimation.check import check
from greybox.show.documents.check import describe_check
from greybox.show.documents.fit import fit_notes
from greybox.simulation.simulate import simulate_twin

LAG = Model(
    "lag",
    [State("x", "m")],
    [Input("u", "m")],
    [Output("x", "m")],
    [Parameter("a", "1/s", 2.0, (0.1, 50.0)), Parameter("g", "1", 1.0, (0.5, 2.0))],
    lambda x, u, p: [Balance("rate", "m/s", 1, "x", drive=p.a * p.g * u.u, back=-p.a * x.x)],
)
UNITS = {"units": {"time": "s", "u": "m", "x": "m"}}


def frame(scale: float) -> pd.DataFrame:
    drive = np.repeat(np.random.default_rng(2).standard_normal(12), 20)
    record = simulate_twin(LAG, {"u": drive}, 0.05, {"x": 1e-3}, 1)
    return pd.DataFrame({"time": record.time, "u": record.inputs["u"], "x": scale * record.outputs["x"]})


def test_a_check_says_at_once_which_units_it_took():
    first = describe_check(check(LAG, gb.read_csv(frame(1.0), LAG))).notes[0]
    assert "the header gives no unit for time, u, x: s, m, m assumed" in first


def test_a_fit_says_it_first_where_the_model_does_not_explain_the_record():
    def places(fit: gb.Fit) -> tuple[int, int]:
        notes = fit_notes(fit)
        codes = [getattr(note, "code", "") for note in notes]
        place = codes.index(RecordCode.UNITS_ASSUMED)
        assert notes[place].values["units"] == UNITS["units"]
        return place, len(notes)

    # Millimetres where the model has metres.
    wrong = gb.fit(LAG, frame(1e3), noise={"x": 1e-3}, options=gb.FitOptions(other_starts=0))
    assert not wrong.explains_records and places(wrong)[0] == 0
    right = gb.fit(LAG, frame(1.0), noise={"x": 1e-3})
    place, count = places(right)
    # Behind every warning of a fit that is right, and said once.
    assert right.explains_records and place == count - 1
