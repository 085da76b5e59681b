"""Data frames in, data frames out: what pandas holds is read as the file that it writes, and a fit says its parameters as a frame."""

from __future__ import annotations

import pickle

import numpy as np
import pandas as pd
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import DataError

lag = Model(
    "lag",
    [State("x", "m")],
    [Input("u", "V")],
    [Output("x", "m")],
    [Parameter("T", "s", 1.0, (1e-3, 1e3)), Parameter("K", "m/V", 1.0, (1e-3, 1e3), fixed=True)],
    lambda x, u, p: [Balance("b", "m", p.T, "x", fall=-x.x, drive=p.K * u.u)],
)
TIME = np.round(0.05 * np.arange(120), 6)


@pytest.fixture(scope="module")
def frame() -> pd.DataFrame:
    drive = np.sign(np.sin(2 * TIME))
    run = gb.simulate(lag.start(T=0.7), {"time": TIME, "u": drive})
    level = run.outputs["x"] + 1e-3 * np.random.default_rng(1).normal(size=len(TIME))
    return pd.DataFrame({"time [s]": TIME, "u [V]": drive, "x [mm]": 1e3 * level})


@pytest.mark.rest
def test_a_frame_is_read_as_the_file_that_it_writes(frame, tmp_path):
    frame.to_csv(tmp_path / "run.csv", index=False)
    file = gb.read_csv(tmp_path / "run.csv", lag)
    start = pd.Timestamp("2024-03-31 08:00", tz="UTC")
    bare = frame.drop(columns="time [s]")
    ways = {
        "columns": frame,
        "rows that were picked": frame[frame["u [V]"].abs() >= 0],
        "index": frame.set_index("time [s]"),
        "index without a name": bare.set_index(pd.Index(TIME)),
        "dates": bare.set_index(start.tz_localize(None) + pd.to_timedelta(TIME, unit="s")),
        "dates with a zone": bare.set_index(start + pd.to_timedelta(TIME, unit="s")),
        "lengths of time": bare.set_index(pd.to_timedelta(TIME, unit="s")),
        "arrays": {name: frame[name].to_numpy() for name in frame},
    }
    for way, given in ways.items():
        record = gb.read_csv(given, lag)
        np.testing.assert_allclose(record.time, file.time, atol=1e-9, err_msg=way)
        for name, values in {**record.inputs, **record.outputs}.items():
            np.testing.assert_allclose(values, {**file.inputs, **file.outputs}[name], rtol=1e-12, err_msg=way)


def test_a_fit_takes_frames_and_says_its_parameters_as_one(frame, tmp_path):
    frame.to_csv(tmp_path / "run.csv", index=False)
    from_file = gb.fit(lag, gb.read_csv(tmp_path / "run.csv", lag), noise={"x": 1e-3})
    fit = gb.fit(lag, frame, noise={"x": 1e-3}, validation=frame.iloc[:60])
    assert fit.parameters["T"] == from_file.parameters["T"] and fit.validation.misfit
    table = fit.parameters.to_frame()
    assert list(table.index) == ["T", "K"] and table.index.name == "parameter"
    estimate = fit.parameters["T"]
    assert tuple(table.loc["T", ["value", "std", "low", "high", "unit"]]) == (
        estimate.value,
        estimate.std,
        *estimate.interval,
        "s",
    )
    assert np.isnan(table.loc["K", "std"]) and table.loc["K", "fixed"]
    assert "<table" in fit.parameters._repr_html_() and fit._repr_html_().startswith("<pre>lag ")
    with pytest.raises(TypeError):
        fit.parameters["T"] = estimate


def test_verbs_take_frames(frame):
    fit = gb.fit(lag, frame, noise={"x": 1e-3})
    validated = gb.validate(fit, frame)
    assert validated.misfit["x"].rmse == pytest.approx(fit.misfit["x"].rmse, rel=0.05)
    assert len(gb.predict(fit, frame)["x"]) == 120
    many = gb.multistart(lag, frame, starts=2, noise={"x": 1e-3}, workers=1)
    assert many.best.parameters["T"].value == pytest.approx(fit.parameters["T"].value, rel=1e-6)
    found = gb.discover(lag, frame[:80], validation=frame[80:], noise={"x": 1e-3}, effects=[gb.effect("sensor_offset")])
    from_records = gb.discover(
        lag,
        gb.read_csv(frame[:80], lag),
        validation=gb.read_csv(frame[80:], lag),
        noise={"x": 1e-3},
        effects=[gb.effect("sensor_offset")],
    )
    assert found.verdict == from_records.verdict and found.best.misfit == from_records.best.misfit
    with pytest.raises(DataError, match="no column for input 'u'"):
        gb.fit(lag, frame.drop(columns="u [V]"))


def test_several_starts_take_constants_of_each_record(frame):
    halves = [
        gb.read_csv(part.reset_index(drop=True), lag, name=n) for n, part in (("a", frame[:60]), ("b", frame[60:]))
    ]
    own = gb.multistart(lag, halves, starts=2, noise={"x": 1e-3}, per_experiment="T", workers=1).best
    alone = gb.fit(lag, halves, noise={"x": 1e-3}, per_experiment="T")
    assert list(own.constraints.per_experiment["T"]) == ["a", "b"]
    for name, estimate in own.constraints.per_experiment["T"].items():
        assert estimate.value == pytest.approx(alone.constraints.per_experiment["T"][name].value, rel=1e-6)


def test_a_fit_of_a_model_of_lambdas_is_pickled(frame):
    fit = gb.fit(lag, frame, noise={"x": 1e-3})
    again = pickle.loads(pickle.dumps(fit))
    assert again.parameters == fit.parameters and str(again) == str(fit)
    assert gb.predict(again, frame)["x"] == pytest.approx(gb.predict(fit, frame)["x"], rel=1e-12)


FORMS = {
    "headers with units": lambda f: f,
    "plain names in the model's units": lambda f: pd.DataFrame(
        {"time": f["time [s]"], "u": f["u [V]"], "x": 1e-3 * f["x [mm]"]}
    ),
    "a time in ms and an input in mV": lambda f: pd.DataFrame(
        {"time [ms]": 1e3 * f["time [s]"], "u [mV]": 1e3 * f["u [V]"], "x [mm]": f["x [mm]"]}
    ),
    "dates called time": lambda f: f.drop(columns="time [s]").assign(
        time=pd.Timestamp("2024-03-31 08:00") + pd.to_timedelta(f["time [s]"], unit="s")
    ),
    "dates in the index": lambda f: f.set_index(
        pd.Timestamp("2024-03-31 08:00", tz="UTC") + pd.to_timedelta(f["time [s]"], unit="s")
    ).drop(columns="time [s]"),
    "arrays by name": lambda f: {name: f[name].to_numpy() for name in f},
}


@pytest.mark.crossed(3)
@pytest.mark.parametrize("form", FORMS)
def test_every_verb_reads_a_table_as_a_file(frame, form):
    record = gb.read_csv(frame, lag)
    fit = gb.fit(lag, record, noise={"x": 1e-3})
    given = FORMS[form](frame)
    close = {"rtol": 1e-6, "atol": 1e-9}
    np.testing.assert_allclose(
        gb.simulate(fit.model, given).outputs["x"], gb.simulate(fit.model, record).outputs["x"], **close
    )
    # Where a rounding makes it another record, its first state is estimated anew: within a hundredth of the noise.
    np.testing.assert_allclose(gb.predict(fit, given)["x"], gb.predict(fit, record)["x"], atol=1e-5)
    noisy = lag.with_process_noise(x=1e-2)
    np.testing.assert_allclose(
        gb.smooth(noisy, given, noise={"x": 1e-3}).mean["x"],
        gb.smooth(noisy, record, noise={"x": 1e-3}).mean["x"],
        **close,
    )
    compared, expected = (gb.compare([fit], table)["lag"].validation["x"].rmse for table in (given, record))
    assert compared == pytest.approx(expected, rel=1e-6)
    assert gb.fit_each(lag, [given, given], noise={"x": 1e-3}, workers=1).records
    assert not gb.detect_changes(fit, given, search_effects=False).moved


def test_a_simulation_and_a_comparison_are_frames(frame):
    fit = gb.fit(lag, frame, noise={"x": 1e-3})
    run = gb.simulate(fit.model, frame)
    table = run.to_frame()
    assert table.index.name == "time" and list(table.columns) == [*run.inputs, *run.outputs]
    np.testing.assert_array_equal(table["x"].to_numpy(), run.outputs["x"])
    np.testing.assert_array_equal(table.index.to_numpy(), run.time)
    # What a simulation gives is a record again.
    np.testing.assert_allclose(gb.read_csv(table, lag).outputs["x"], run.outputs["x"], rtol=1e-15)
    comparison = gb.compare({"fitted": fit, "stated": lag}, frame)
    rows = comparison.to_frame()
    assert rows.index.name == "model" and set(rows.index) == {"fitted", "stated"}
    for name, row in rows.iterrows():
        score = comparison.deciding_scores(comparison[name])["x"]
        assert (row["error"], row["fit_percent"]) == (score.rmse, score.best_fit_percent)
    assert rows["error"].is_monotonic_increasing
