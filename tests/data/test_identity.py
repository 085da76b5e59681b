"""Whether two records are the same measurement: copies of every kind are known, experiments that were repeated are not taken for them."""

import numpy as np
import pytest

from greybox import Balance, Experiment, Input, Model, Output, Parameter, State, fit
from greybox.base import DataError
from greybox.data.findings import RecordCode
from greybox.data.identity import _Readings, find_shared_readings, refuse_repeated

ROWS = 500


def lag(u, pole=0.9, start=0.0):
    y = np.zeros(len(u))
    y[0] = start
    for k in range(len(u) - 1):
        y[k + 1] = pole * y[k] + (1 - pole) * u[k]
    return y


def record(y, u=None, *, step=0.01, begin=0.0, name="run", source=""):
    y = np.asarray(y, float)
    return Experiment(
        name, begin + step * np.arange(len(y)), {"u": np.zeros(len(y)) if u is None else u}, {"y": y}, source=source
    )


def shared(a, b):
    return next(find_shared_readings([a, b]), None)


DRIVE = np.repeat(np.random.default_rng(5).choice([-1.0, 1.0], ROWS // 10), 10)
READING = 21.3 + lag(DRIVE) + 0.02 * np.random.default_rng(6).normal(size=ROWS)


def significant(values, digits):
    return np.array([float(f"%.{digits}g" % value) for value in values])


COPIES = {
    "fewer decimals": np.round(READING, 3),
    "five significant digits": significant(READING, 5),
    "single precision": READING.astype(np.float32),
    "four digits of kelvin": significant(READING + 273.15, 6) - 273.15,
    "four digits per minute": significant(READING * 60, 5) / 60,
    "Fahrenheit with two decimals": (np.round(READING * 1.8 + 32, 2) - 32) / 1.8,
    "revolutions with four decimals": np.round(READING / (2 * np.pi), 4) * 2 * np.pi,
}


@pytest.mark.parametrize("reading", COPIES.values(), ids=COPIES)
def test_a_copy_with_fewer_digits_is_the_same_measurement_whatever_its_clock(reading):
    for clock in ({}, {"begin": 1e5}, {"step": 0.0101}):
        found = shared(record(READING, DRIVE), record(reading, DRIVE, **clock))
        assert found is not None
        assert (found.rows, found.start, found.second_start) == (ROWS, 0, 0)


@pytest.mark.parametrize(
    ("first", "second", "rows"),
    [
        ((0, 300), (200, 500), 100),
        ((200, 500), (0, 300), 100),
        ((0, 500), (150, 400), 250),
        ((150, 400), (0, 500), 250),
        ((0, 300), (260, 500), 40),
    ],
)
def test_windows_that_overlap_share_their_rows(first, second, rows):
    a, b = (record(np.round(READING[slice(*w)], d), DRIVE[slice(*w)]) for w, d in ((first, 9), (second, 4)))
    found = shared(a, b)
    assert found is not None
    assert found.rows == rows
    assert first[0] + found.start == second[0] + found.second_start


def test_neighbouring_windows_share_nothing():
    whole = record(READING, DRIVE)
    assert shared(*whole.split(0.6)) is None


NOISES = [(0.02, 0.0), (1e-5, 0.0), (0.02, 0.001), (0.02, 0.05), (0.002, 0.02), (1e-4, 1e-3)]
DRIVES = {
    "switched": DRIVE,
    "a constant start": np.r_[np.zeros(200), DRIVE[200:]],
    "a sine": np.sin(2 * np.pi * np.arange(ROWS) / 50),
    "at rest": np.zeros(ROWS),
}


@pytest.mark.crossed(3)
@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
@pytest.mark.parametrize(("noise", "digit"), NOISES)
def test_an_experiment_that_was_repeated_is_another_measurement(noise, digit, drive):
    for seed in range(10):
        generator = np.random.default_rng(seed)
        runs = [lag(drive) + noise * generator.normal(size=ROWS) for _ in range(2)]
        a, b = (record(np.round(run / digit) * digit if digit else run, drive) for run in runs)
        assert shared(a, b) is None


SMOOTH = np.r_[np.zeros(40), np.ones(160)]
TOLD_APART = {
    "simulated runs that begin alike": (lag(np.r_[SMOOTH, DRIVE]), lag(np.r_[SMOOTH, -np.ones(ROWS)])),
    "simulated steps after rests of two lengths": (lag(SMOOTH), lag(np.r_[np.zeros(25), SMOOTH])),
    "simulated decays from two places": (lag(np.zeros(300), 0.97, 2.0), lag(np.zeros(300), 0.97, 1.0)),
    "a periodic coarse reading": (np.tile([20.0, 20.5, 21.0, 20.5], 100), np.tile([21.0, 20.5, 20.0, 20.5], 80)),
    "readings that never move": (np.full(300, 7.0), np.full(200, 7.0)),
}


@pytest.mark.parametrize(("first", "second"), TOLD_APART.values(), ids=TOLD_APART)
def test_what_a_repetition_would_read_as_well_is_no_evidence(first, second):
    assert shared(record(first), record(second)) is None
    assert shared(record(np.round(first, 3)), record(np.round(second, 3))) is None


def test_runs_of_one_file_may_be_alike_and_a_file_given_twice_may_not():
    run = lag(DRIVE)
    refuse_repeated([record(run, DRIVE, name=f"sim.csv[{k}]", source="sim.csv") for k in range(2)])
    with pytest.raises(DataError, match=r"^sim.csv: given twice; its data would count twice"):
        refuse_repeated([record(run, DRIVE, source="sim.csv")] * 2)
    with pytest.raises(
        DataError, match=r"^b.csv: rows 1 to 300 are the readings of rows 101 to 400 of a.csv; its data"
    ):
        refuse_repeated(
            [record(READING, source="a.csv"), record(np.round(READING[100:400], 4), source="b.csv", begin=3.0)]
        )


def first_order():
    return Model(
        "lag",
        states=[State("y", "V", 21.3)],
        inputs=[Input("u", "V")],
        outputs=[Output("y", "V")],
        parameters=[
            Parameter("y0", "V", 21.3, (0.0, 50.0)),
            Parameter("tau", "s", 0.05, (1e-3, 10.0)),
            Parameter("K", "1", 1.0, (0.1, 10.0)),
        ],
        balances=lambda x, u, p: [Balance("lag", "V", p.tau, "y", drive=p.K * u.u, rest=p.y0 - x.y)],
    )


def test_a_fit_refuses_copies_and_says_what_cannot_validate_it():
    whole = record(READING, DRIVE)
    for copies in ([whole] * 4, [whole, record(np.round(READING, 4), DRIVE)], [whole, whole.window(100, 400)]):
        with pytest.raises(DataError, match="would count twice"):
            fit(first_order(), copies)
    judged = fit(
        first_order(), whole.window(0, 400), validation=record(np.round(READING[300:], 4), DRIVE[300:], name="v")
    )
    (finding,) = (f for f in judged.findings if f.code == RecordCode.ALSO_FITTED)
    assert finding.values["place"].startswith("rows 1 to 100 are the readings of rows 301 to 400 of run")
    fresh = fit(first_order(), whole.window(0, 300), validation=whole.window(300, 500))
    assert RecordCode.ALSO_FITTED not in [f.code for f in fresh.findings]


@pytest.mark.parametrize(("every", "offset"), [(2, 0), (2, 1), (5, 3), (10, 0)])
@pytest.mark.parametrize("decimals", [17, 6, 3])
def test_a_copy_that_kept_one_row_in_several_is_the_same_measurement(every, offset, decimals):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([0.0, 1.0], 60), 20)
    y = lag(u) + 0.02 * rng.normal(size=len(u))
    whole, thin = (
        record(y, u),
        record(np.round(y[offset::every], decimals), u[offset::every], step=0.01 * every, begin=7.0),
    )
    for first, second in ((whole, thin), (thin, whole)):
        (found,) = find_shared_readings([first, second])
        assert (found.every, found.rows) == (every, len(y[offset::every]))
        assert f"one in {every} rows" in found.place
    # An experiment of the same plant at another rate is another measurement.
    again = lag(u) + 0.02 * rng.normal(size=len(u))
    assert not list(find_shared_readings([whole, record(again[offset::every], u[offset::every], step=0.01 * every)]))


def test_a_smooth_signal_has_no_events_and_a_jump_is_one():
    k = np.arange(80.0)
    # Its curvature, cos(0.7 k) - 0.4, changes its sign: there a second difference is nearly zero, and its neighbours are not.
    smooth = -np.cos(0.7 * k) / 0.7**2 - 0.2 * k**2
    assert not len(_Readings(record(smooth)).events["y"])
    jumps = _Readings(record(smooth + 50.0 * (k >= 40))).events["y"]
    assert len(jumps) and (np.abs(jumps - 40) <= 4).all()
