"""Observers: the filter that runs in Python, C and an FMU is the library's own, to 1e-9."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess

import numpy as np
import pytest

import greybox as gb
from greybox.data.experiment import Experiment
from greybox.simulation.filtering.kalman_filter import KalmanFilter
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.kernel.c_compiler import find_compiler
from greybox.simulation.records import to_record
from models.micro_actuator import micro_actuator
from tests.support.filters import tank

LINEAR = micro_actuator.with_process_noise(v=0.5, i=0.2)
CASES = {"linear": (LINEAR, 2.5e-4, {"x": 2e-7, "i": 5e-3}, 0), "extended": (tank(), 5.0, {"h": 0.01, "out": 1e-3}, 4)}
HAS_COMPILER = any(map(shutil.which, ("cc", "gcc", "clang")))


def make_case(name):
    """Observer, inputs (N, 1), measurements (N, 2) with gaps, and the run of the library's filter."""
    model, dt, noise, substeps = CASES[name]
    observer = gb.export.design_observer(model, dt, noise=noise, substeps=substeps)
    rng = np.random.default_rng(4)
    time = dt * np.arange(80)
    u = 0.02 * (1 + np.sin(0.3 * np.arange(80)))
    run = gb.simulate(model, {"time": time, model.inputs[0].name: u}, substeps=substeps)
    clean = np.column_stack([run.outputs[o.name] for o in model.outputs])
    y = clean + rng.standard_normal(clean.shape) * list(noise.values())
    y[10:14, 0], y[30, :] = np.nan, np.nan
    outputs = {o.name: y[:, j] for j, o in enumerate(model.outputs)}
    record = Experiment("run", time, {model.inputs[0].name: u}, outputs)
    rows, p = to_record(model, record), observer.corrected.model.values
    p = np.array(list(p.values()))
    step = discretise(model.system, p, observer.start[None, : model.system.x.numel()], rows.lengths, substeps=substeps)
    kalman = KalmanFilter.of(model.system, step, known_start=False)
    x0, covariance = observer.split(observer.start)
    own = kalman.run(rows, np.append(p, list(noise.values())), x0, covariance)
    return observer, u[:, None], y, own


@pytest.fixture(scope="module", params=CASES)
def case(request):
    return make_case(request.param)


def agree(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_predictions_are_those_of_the_librarys_filter(case):
    observer, u, y, own = case
    run = observer.run(u, y)
    agree(run.predicted, own.predicted)
    agree(run.predicted_covariance, own.covariance)
    assert np.all(np.linalg.eigvalsh(run.covariance)[:, 0] > -1e-18)
    assert np.trace(run.covariance[5]) < np.trace(run.predicted_covariance[5])


def test_the_first_covariance_is_that_of_the_librarys_filter():
    observer, _, _, _ = make_case("linear")
    assert observer.split(observer.start)[1][1, 1] == pytest.approx(0.5**2 * 2.5e-4, rel=0.1)
    known = gb.export.design_observer(LINEAR, 2.5e-4, noise={"x": 2e-7, "i": 5e-3}, initial_std={"x": 1e-6})
    np.testing.assert_allclose(known.split(known.start)[1], np.diag([1e-12, 0, 0]))


def test_the_python_class_needs_numpy_alone(case, tmp_path):
    observer, u, y, own = case
    path = gb.export.to_python(observer, tmp_path / "observer.py")
    assert "greybox" not in [line.split()[1] for line in path.read_text().splitlines() if line.startswith("import ")]
    spec = importlib.util.spec_from_file_location("written_observer", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (name,) = [n for n in vars(module) if n.endswith("Observer")]
    written = getattr(module, name)()
    corrected, predicted = [], [written.state[: own.predicted.shape[1]]]
    for k in range(len(u)):
        corrected.append(written.correct(u[k], y[k])[0])
        predicted.append(written.advance(u[k], y[k])[0])
    agree(np.array(predicted[:-1]), own.predicted)
    agree(np.array(corrected), observer.run(u, y).estimate)


@pytest.mark.skipif(not HAS_COMPILER, reason="there is no C compiler on the path")
def test_the_c_code_is_the_same_filter(case, tmp_path):
    observer, u, y, own = case
    source, header = gb.export.to_c(observer, tmp_path / "observer.c")
    command = [*find_compiler().command, "-std=c99", "-O1", "-Wall", "-pedantic", "-Werror", "-shared", "-fPIC"]
    subprocess.run([*command, "-o", str(tmp_path / "observer.so"), str(source), "-lm"], check=True)
    library = ctypes.CDLL(str(tmp_path / "observer.so"))
    name, nx = observer.corrected.signals.name, own.predicted.shape[1]
    state, shown = (ctypes.c_double * 64)(), (ctypes.c_double * 16)()
    getattr(library, f"{name}_start")(state)
    predicted, corrected = [], []
    for k in range(len(u)):
        given = (ctypes.c_double * 3)(*u[k], *y[k])
        predicted.append(list(state)[:nx])
        getattr(library, f"{name}_outputs")(state, given, shown)
        corrected.append(list(shown)[: 2 * nx])
        getattr(library, f"{name}_step")(state, given)
    run = observer.run(u, y)
    agree(np.array(predicted), own.predicted)
    agree(np.array(corrected)[:, :nx], run.estimate)
    agree(np.array(corrected)[:, nx:], np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2)))
    assert "measured_" in header.read_text()


@pytest.mark.skipif(not HAS_COMPILER, reason="there is no C compiler on the path")
def test_the_fmu_is_the_same_filter(case, tmp_path):
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    observer, u, y, own = case
    path = gb.export.to_fmu(observer, tmp_path / "observer.fmu")
    assert validate_fmu(str(path)) == []
    model = observer.plant.model
    names = [*(i.name for i in model.inputs), *(f"measured_{o.name}" for o in model.outputs)]
    time = observer.dt * np.arange(len(u))
    signals = np.array(
        [tuple(row) for row in np.column_stack([time, u, y])], dtype=[("time", float), *((n, float) for n in names)]
    )
    states = [s.name for s in model.all_states]
    found = fmpy.simulate_fmu(
        str(path), stop_time=time[-1], output_interval=observer.dt, step_size=observer.dt, input=signals, output=states
    )
    agree(np.column_stack([found[name] for name in states]), own.predicted)


def test_the_noise_of_a_fit_makes_its_observer():
    model = tank().fix("gust").with_process_noise(h=0.003)
    rng = np.random.default_rng(1)
    time = 5.0 * np.arange(120)
    q = np.repeat(rng.uniform(0.01, 0.04, 12), 10)
    level = [0.4]
    for k in range(119):  # exact enough: a hundred steps of Euler with the push of each
        h = level[-1]
        for push in 0.003 * np.sqrt(0.05) * rng.standard_normal(100):
            h += 0.05 * (q[k] - 0.05 * np.sqrt(max(h, 0))) + push
        level.append(h)
    record = Experiment("run", time, {"q": q}, {"h": np.array(level) + 0.01 * rng.standard_normal(120)})
    fit = gb.fit(model, record, noise={"h": 0.01, "out": 1e-3})
    observer = gb.export.design_observer(fit, noise={"h": 0.01, "out": 1e-3})
    measured = np.column_stack([record.outputs["h"], np.full(120, np.nan)])
    run = observer.run(q[:, None], measured)
    error = run.estimate[:, 0] - level
    assert np.std(error[20:]) < 0.9 * 0.01
    assert np.mean(np.abs(error[20:]) < 2 * np.sqrt(run.covariance[20:, 0, 0])) > 0.85


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"noise": {"x": 1e-7}}, "the noise of i is not known"),
        ({"noise": {"x": 1e-7, "i": 1e-3}, "process_noise": {"w": 1}}, "no state 'w'"),
        ({"noise": {"x": -1.0, "i": 1e-3}}, "give a number above 0"),
    ],
)
def test_what_is_missing_is_named(how, message):
    with pytest.raises(gb.errors.ModelError, match=message):
        gb.export.design_observer(LINEAR, 1e-3, **how)


def test_a_model_without_process_noise_or_with_a_delay_is_refused():
    noise = {"x": 1e-7, "i": 1e-3}
    with pytest.raises(gb.errors.ModelError, match="no process noise, and there are no records"):
        gb.export.design_observer(micro_actuator, 1e-3, noise=noise)
    late = (LINEAR + gb.effect("transport_delay")).start(delay=4e-4)
    with pytest.raises(gb.errors.ModelError, match="delayed input"):
        gb.export.design_observer(late, 1e-3, noise=noise)
    with pytest.raises(gb.errors.ModelError, match="has its sampling time"):
        gb.export.to_c(gb.export.design_observer(LINEAR, 1e-3, noise=noise), "x.c", dt=1e-3)
