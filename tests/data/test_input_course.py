"""The course of each input between rows: what its values show of it, what was told, and that every way into a record keeps it."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.signal import butter, lfilter

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.base import DataError
from greybox.data.experiment import collect_record_findings
from greybox.data.findings import RecordCode
from greybox.data.input_course import CourseEvidence, inspect_course
from greybox.data.read import read_experiments
from greybox.simulation.simulate import read_inputs

ROWS = 800
NUMBER = np.arange(ROWS)
STEPS, SMOOTH, OPEN = CourseEvidence.STEPS, CourseEvidence.SMOOTH_AND_NOISY, CourseEvidence.NONE


def multisine(highest: float, rng: np.random.Generator) -> np.ndarray:
    phases = rng.uniform(0, 2 * np.pi, 15)
    return sum(np.sin(2 * np.pi * f * NUMBER + p) for f, p in zip(np.linspace(0.002, highest, 15), phases, strict=True))


SIGNALS = {
    "random levels": (STEPS, lambda rng: np.repeat(rng.normal(size=ROWS // 8), 8)),
    "a noisy binary sequence": (
        STEPS,
        lambda rng: np.repeat(rng.integers(0, 2, ROWS // 8), 8) + 0.01 * rng.normal(size=ROWS),
    ),
    "white noise": (STEPS, lambda rng: rng.normal(size=ROWS)),
    "a step": (STEPS, lambda rng: (NUMBER > 100) * 5.0),
    "a computed multisine": (OPEN, lambda rng: multisine(0.05, rng)),
    "a computed multisine, printed": (OPEN, lambda rng: np.round(multisine(0.05, rng), 3)),
    "a computed chirp": (OPEN, lambda rng: np.sin(2 * np.pi * 0.04 / ROWS * NUMBER**2)),
    "noise behind a filter": (OPEN, lambda rng: lfilter(*butter(2, 0.05), rng.normal(size=ROWS))),
    "noise behind two poles": (OPEN, lambda rng: lfilter([1.0], [1.0, -1.9, 0.9025], rng.normal(size=ROWS))),
    "the weather by the tenth": (OPEN, lambda rng: np.round(280 + 4 * np.sin(2 * np.pi * NUMBER / ROWS), 1)),
    "a measured multisine": (SMOOTH, lambda rng: multisine(0.05, rng) + 0.02 * rng.normal(size=ROWS)),
    "a loudly measured pressure": (SMOOTH, lambda rng: 101e3 + 500 * multisine(0.02, rng) + 50 * rng.normal(size=ROWS)),
    "a converter with noise": (SMOOTH, lambda rng: np.round(500 * multisine(0.03, rng) + 3 * rng.normal(size=ROWS))),
}


@pytest.mark.parametrize("name", SIGNALS)
def test_the_values_of_an_input_show_how_it_moves(name: str) -> None:
    evidence, make = SIGNALS[name]
    seen = [inspect_course(make(np.random.default_rng(seed))) for seed in range(20)]
    assert seen.count(evidence) >= 18, seen
    # What may be held is never taken as straight.
    assert evidence is SMOOTH or SMOOTH not in seen


def room() -> Model:
    return Model(
        "room",
        states=[State("T", "K", 290.0)],
        inputs=[Input("P", "W"), Input("Ta", "K")],
        outputs=[Output("T", "K")],
        parameters=[Parameter("C", "J/K", 1e6, (1e4, 1e8)), Parameter("R", "K/W", 0.01, (1e-4, 1.0))],
        balances=lambda x, u, p: [Balance("air", "W", p.C, "T", heater=u.P, loss=(u.Ta - x.T) / p.R)],
    )


def columns(rng: np.random.Generator, rows: int = 200) -> dict[str, np.ndarray]:
    time = 600.0 * np.arange(rows)
    return {
        "time": time,
        "P": 1000.0 * (rng.random(rows) < 0.4),
        "Ta": 280 + 5 * np.sin(2 * np.pi * time / 5000),
        "T": 290 + rng.normal(size=rows),
    }


def write(path: Path, data: dict[str, np.ndarray]) -> Path:
    if path.suffix == ".csv":
        np.savetxt(path, np.column_stack([*data.values()]), delimiter=",", header=",".join(data), comments="")
    elif path.suffix == ".mat":
        savemat(path, data)
    else:
        np.savez(path, **data)
    return path


@pytest.mark.parametrize("suffix", ["csv", "mat", "npz"])
@pytest.mark.parametrize(
    "told",
    [{"interpolation": {"Ta": "first"}}, {"hold": {"Ta": "first"}}, {"hold": "first", "interpolation": {"P": "zero"}}],
)
def test_a_file_of_one_table_keeps_the_course_of_each_input(tmp_path: Path, suffix: str, told: dict) -> None:
    path = write(tmp_path / f"record.{suffix}", columns(np.random.default_rng(0)))
    for record in (
        gb.read_csv(path, room(), **told),
        *gb.read_experiments([path], room(), **told),
        read_inputs(path, room(), **told),
    ):
        assert dict(record.hold) == {"P": "zero", "Ta": "first"}


def test_a_course_that_is_none_is_refused() -> None:
    data = columns(np.random.default_rng(0))
    inputs = {n: data[n] for n in ("P", "Ta")}
    with pytest.raises(DataError) as error:
        Experiment("run", data["time"], inputs, {"T": data["T"]}, {"T_a": "first", "P": "linear"})  # type: ignore[dict-item]
    for part in (
        "2 problems",
        "hold names 'T_a', which is no input; did you mean 'Ta'?",
        "hold 'linear' of 'P' is unknown",
    ):
        assert part in str(error.value)
    assert "auto" in str(error.value)


def test_parts_and_copies_of_a_record_keep_the_courses() -> None:
    data = columns(np.random.default_rng(0))
    inputs = {n: data[n] for n in ("P", "Ta")}
    record = Experiment.from_arrays(data["time"], inputs, {"T": data["T"]}, hold={"Ta": "first"})
    parts = (*record.split(0.5), record.window(10, 50), record.with_outputs({}), pickle.loads(pickle.dumps(record)))
    assert all(dict(part.hold) == {"P": "zero", "Ta": "first"} for part in parts)
    assert record.with_hold({"P": "first"}).hold == "first"
    assert record.identity != record.with_hold("zero").identity


def test_what_was_decided_is_said_and_what_is_told_is_kept() -> None:
    rng, data = np.random.default_rng(0), columns(np.random.default_rng(0), ROWS)
    inputs = {"P": data["P"], "Ta": 280 + multisine(0.05, rng) + 0.02 * rng.normal(size=ROWS)}
    decided = Experiment.from_arrays(data["time"], inputs, {"T": data["T"]})
    assert dict(decided.courses) == {"P": "zero", "Ta": "first"}
    assert [f.subject for f in decided.findings if f.code is RecordCode.INPUT_TAKEN_STRAIGHT] == ["Ta"]
    for told in ("zero", "first", {"Ta": "zero", "P": "zero"}):
        record = Experiment.from_arrays(data["time"], inputs, {"T": data["T"]}, hold=told)  # type: ignore[arg-type]
        assert record.courses["Ta"] == ("first" if told == "first" else "zero")
        assert RecordCode.INPUT_TAKEN_STRAIGHT not in {f.code for f in record.findings}


def _measured(rows, noise, seed):
    """A lag of 0.5 s and gain 2 behind a sine of 1.1 rad/s, its steady answer in closed form, the input read with noise."""
    time, rng = 0.05 * np.arange(rows), np.random.default_rng(seed)
    answer = 2 * np.sin(1.1 * time - np.arctan(0.55)) / np.hypot(1, 0.55)
    return np.column_stack([time, np.sin(1.1 * time) + noise * rng.normal(size=rows), answer])


@pytest.mark.parametrize(("told", "courses"), [({}, {"first"}), ({"hold": "zero"}, {"zero"})])
def test_records_that_are_read_together_hold_an_input_in_one_way(tmp_path, told, courses):
    """The second is too noisy for its rows to show what the first shows."""
    model = Model(
        "lag",
        [State("x", "V")],
        [Input("u", "V")],
        [Output("x", "V")],
        [Parameter("tau", "s", 0.5, (0.01, 10.0))],
        lambda x, u, p: [Balance("lag", "V", p.tau, "x", drive=2 * u.u, decay=-x.x)],
    )
    for k, (rows, noise) in enumerate([(400, 0.02), (80, 0.3)]):
        np.savetxt(
            tmp_path / f"r{k}.csv", _measured(rows, noise, k), delimiter=",", header="time [s],u [V],x [V]", comments=""
        )
    files = [tmp_path / "r0.csv", tmp_path / "r1.csv"]
    alone = [gb.read_csv(file, model) for file in files]
    assert [r.courses["u"] for r in alone] == ["first", "zero"]
    assert RecordCode.INPUT_COURSES_DIFFER in [f.code for f in collect_record_findings(alone)]
    together = read_experiments(files, model, **told)
    assert {r.courses["u"] for r in together} == courses
    codes = [f.code for f in collect_record_findings(together)]
    assert codes.count(RecordCode.INPUT_COURSE_SHARED) == (not told) and RecordCode.INPUT_COURSES_DIFFER not in codes
