"""What a verb does not take is refused with the place where it is given."""

import numpy as np
import pandas as pd
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import DataError

LAG = Model(
    "lag",
    [State("x", "m")],
    [Input("u", "m")],
    [Output("x", "m")],
    [Parameter("a", "1/s", 2.0, (0.1, 50.0))],
    lambda x, u, p: [Balance("rate", "m/s", 1, "x", drive=p.a * u.u, back=-p.a * x.x)],
)
FRAME = pd.DataFrame({"time": 0.1 * np.arange(50), "u": np.sin(np.arange(50)), "x_mm": np.cos(np.arange(50))})


@pytest.mark.parametrize("verb", [gb.fit, gb.discover, gb.compare, gb.validate, gb.multistart, gb.fit_each])
@pytest.mark.parametrize(
    ("given", "remedy"),
    [
        ({"at_rest": True}, r"options=gb\.FitOptions\(at_rest=True\)"),
        ({"fix": {"a": 0.8}}, r"model\.fix\(a=0\.8\)"),
        ({"columns": {"x [mm]": "x_mm"}}, r"gb\.read_csv\(frame, model, columns=\.\.\.\)"),
        ({"nois": {"x": 1e-3}}, r"no argument 'nois'"),
    ],
)
def test_an_unknown_argument_names_its_place(verb, given, remedy):
    with pytest.raises(TypeError, match=remedy):
        verb(LAG, FRAME, **given)


def test_a_frame_with_other_headers_is_sent_to_where_they_are_given():
    with pytest.raises(
        DataError, match=r"columns=\{'x \[mm\]': 'x_mm'\}.*\n.*gb\.read_csv\(frame, model, columns=\.\.\., \.\.\.\)"
    ):
        gb.fit(LAG, FRAME)
    record = gb.read_csv(FRAME, LAG, columns={"x [mm]": "x_mm"})
    assert record.outputs["x"] == pytest.approx(1e-3 * FRAME["x_mm"].to_numpy())


def test_frames_by_name_are_no_record():
    with pytest.raises(
        DataError, match=r"^'a', 'b': .* list, \[first, second\], or by their names as \[gb\.read_csv\([^\n]*$"
    ):
        gb.fit(LAG, {"a": FRAME, "b": FRAME})
    record = gb.Experiment("r", 0.1 * np.arange(9), {"u": np.arange(9.0)}, {"x": np.arange(9.0)})
    with pytest.raises(DataError, match=r"'a': .* these are records themselves"):
        gb.fit(LAG, {"a": record})
