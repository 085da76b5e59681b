"""Scans over structures, the best black boxes of a record, Hammerstein models, records brought to equal steps."""

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox.comparison.blackbox.resample import keep_measured_rows
from greybox.data.findings import RecordCode

A, B = [1.0, -1.5, 0.7], [0.0, 0.0, 1.0, 0.5]  # two samples of delay


def record(rows, seed, *, bend=lambda u: u, noise=0.05, name=""):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(rows)
    y = lfilter(B, A, bend(u)) + noise * rng.standard_normal(rows)
    return gb.Experiment(name or f"record {seed}", 0.1 * np.arange(rows), {"u": u}, {"y": y})


def free_run_error(model, judge, skip):
    run = model.simulate(judge, rows=skip)["y"]
    return np.sqrt(np.mean((judge.outputs["y"] - run)[skip:] ** 2))


@pytest.fixture(scope="module")
def scan():
    told = []
    judge = record(300, 2)
    found = gb.blackbox.scan_structures(
        record(400, 1),
        "output error",
        nb=(1, 2, 400),
        nf=(1, 2),
        nk=(1, 2),
        validation=judge,
        skip=40,
        units={"y": "mm"},
        report=lambda done, of, candidate: told.append((done, of, candidate.label)),
    )
    return found, judge, told


def test_a_scan_is_one_call_with_table_progress_and_selection(scan):
    found, judge, told = scan
    assert [t[:2] for t in told] == [(k, 12) for k in range(1, 13)]
    assert [c.label for c in found.structures] == [t[2] for t in told]
    fitted = [c for c in found.structures if c.model is not None]
    for c in fitted:
        assert c.free_run == pytest.approx(free_run_error(c.model, judge, 40), rel=1e-12)
    assert found.chosen.label == found.best.label == "output error(2, 2, 2)"
    # of several within half a percent of the smallest error the one of fewest coefficients
    near = [c.model.parameters for c in fitted if c.free_run <= 1.005 * min(x.free_run for x in fitted)]
    assert found.best.parameters == min(near)
    assert found.validation == ("record 2",) and found.criterion == "free run" and found.unit == "mm"
    assert (
        next(c.label for c in found.structures if c.model is None) == "output error(nb 400, nf 1, nk 1, offset False)"
    )
    assert sum(bool(c.failure) for c in found.structures) == 4


@pytest.mark.parametrize(("by", "price"), [("aic", 2.0), ("bic", np.log(397))])
def test_criteria_are_those_of_the_definition(by, price):
    r = record(400, 1)
    found = gb.blackbox.scan_structures(r, "arx", na=(1, 2, 3), nb=(1, 2), nk=2, criterion=by)
    for c in found.structures:
        # with the same number of rows for every structure: those that the longest history, of three, leaves
        expected = 397 * np.log(c.model.loss) + price * c.model.parameters
        assert (c.aic if by == "aic" else c.bic) == pytest.approx(expected, rel=1e-12)
    best = min(found.structures, key=lambda c: getattr(c, by))
    assert found.chosen is best and found.best.coefficients == best.model.coefficients


def test_a_scan_without_any_structure_gives_the_reason():
    with pytest.raises(gb.errors.DataError, match=r"arx\(50, 50, 1\).*at least 101 are needed"):
        gb.blackbox.scan_structures(record(60, 1), na=50, nb=50, nk=1)


@pytest.mark.slow
def test_the_best_black_boxes_reach_the_noise():
    train, told = [record(250, 1), record(250, 2), record(250, 3)], []
    kinds = ("arx", "armax", "output error", "box-jenkins", "hammerstein")
    scans = gb.blackbox.best_black_boxes(
        train, kinds=kinds, report=lambda kind, done, of: told.append((kind, done, of))
    )
    assert tuple(scans) == kinds
    last = {kind: (done, of) for kind, done, of in told}
    assert set(last) == set(kinds) and all(done == of >= 3 for done, of in last.values())
    judge = record(400, 9)
    for kind, scan in scans.items():
        assert free_run_error(scan.best, judge, 50) < (1.2 if kind in ("arx", "armax") else 1.05) * 0.05, kind
    assert scans["arx"].validation == ("record 3",)  # of several records the last third validates


def test_a_settled_step_is_validated_by_the_run_over_itself():
    policy = gb.blackbox.StructureScanPolicy(largest_poles=2, largest_searched_poles=2)
    y = lfilter(B, A, np.ones(40)) + 0.01 * np.random.default_rng(0).standard_normal(40)
    step = gb.Experiment("step", 0.1 * np.arange(40), {"u": np.ones(40)}, {"y": y})
    scans = gb.blackbox.best_black_boxes(step, kinds=("arx", "hammerstein"), at_rest=True, policy=policy)
    assert set(scans) == {"arx"}  # an input of two levels has no curve
    assert scans["arx"].validation == () and scans["arx"].policy is policy
    with pytest.raises(gb.errors.DataError, match=r"no black-box model of these records: .* equations for"):
        gb.blackbox.best_black_boxes(record(3, 1), kinds=("arx",))
    with pytest.raises(gb.errors.DataError, match=r"output 'y': no input ever moves \(u\)"):
        gb.blackbox.best_black_boxes(step, kinds=("arx",))


# ---- Hammerstein ----


@pytest.mark.parametrize(
    ("bend", "options"),
    [
        (lambda u: u + 0.4 * u**2 - 0.1 * u**3, {"shape": "polynomial", "basis_size": 3}),
        (lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.5, 0), {"shape": "piecewise", "basis_size": 16}),
    ],
)
def test_a_curve_in_front_comes_back(bend, options):
    model = gb.blackbox.hammerstein(record(1200, 4, bend=bend), nb=2, nf=2, nk=2, history="zero", **options)
    u = np.linspace(-1.8, 1.8, 37)
    (curve,) = model.curves
    scale = (curve(u) @ bend(u)) / (curve(u) @ curve(u))  # the gain behind it is not told apart
    assert np.abs(scale * curve(u) - bend(u)).max() < 0.05
    assert curve(np.zeros(1)) == pytest.approx(0)
    assert model.linear.poles == pytest.approx(np.roots(A), abs=0.01)
    assert free_run_error(model, record(300, 5, bend=bend), 0) < 1.3 * 0.05
    assert model.parameters == 4 + options["basis_size"] - 1


def test_a_straight_curve_is_the_output_error_model():
    r = record(300, 6)
    bent, plain = (
        gb.blackbox.hammerstein(r, nb=2, nf=2, nk=2, basis_size=1),
        gb.blackbox.output_error(r, nb=2, nf=2, nk=2),
    )
    assert bent.simulate(r)["y"] == pytest.approx(plain.simulate(r)["y"], abs=1e-7)
    assert bent.linear.f[0] == pytest.approx(plain.f[0], abs=1e-7) and bent.parameters == plain.parameters


# ---- Equal steps ----


def test_resampling_holds_inputs_and_joins_outputs():
    time = np.array([0.0, 1.0, 2.5, 4.0, 5.0])
    r = gb.Experiment("r", time, {"u": time}, {"y": 2 * time, "z": np.where(time == 2.5, np.nan, time)})
    found = gb.blackbox.resample(r, 0.5)
    assert found.sampling_time == 0.5 and found.rows == 11
    assert found.inputs["u"][:6] == pytest.approx([0, 0, 1, 1, 1, 2.5])
    assert found.outputs["y"] == pytest.approx(2 * found.time)
    assert np.flatnonzero(np.isnan(found.outputs["z"])).tolist() == [3, 4, 5, 6, 7]
    assert found.findings[-1].code == RecordCode.RESAMPLED and found.findings[-1].values["sampling_time"] == 0.5


def test_a_slow_sensor_has_its_own_rows():
    y = np.full(100, np.nan)
    y[4::10] = np.arange(10)
    r = gb.Experiment("r", 0.1 * np.arange(100), {"u": np.arange(100.0)}, {"y": y, "z": np.arange(100.0)})
    found = keep_measured_rows(r, "y")
    assert found is not None and found.sampling_time == pytest.approx(1.0)
    assert found.outputs["y"] == pytest.approx(np.arange(10))
    assert found.inputs["u"][0] == pytest.approx(np.arange(4, 14).mean())  # of the rows it acts on until the next value
    assert keep_measured_rows(r, "z") is None
