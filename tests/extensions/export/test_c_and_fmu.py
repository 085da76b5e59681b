"""C and FMU: compiled, run, and compared with the library step by step; what cannot be carried is refused."""

import ctypes
import shutil
import subprocess
import sys
import zipfile
from contextlib import contextmanager

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import GreyboxError
from greybox.model.effects.catalogue import applicable_effects
from greybox.simulation.kernel.c_compiler import find_compiler
from models.cascaded_tanks import cascaded_tanks
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from models.pneumatic_full import pneumatic_full
from models.silverbox import silverbox

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler on the path"
)
VALUES = {
    "Fc": 0.05,
    "Fs": 0.08,
    "vs": 0.01,
    "s0": 1e4,
    "s1": 1.0,
    "gap": 1e-6,
    "delay": 4e-4,
    "d": 0.3,
    "B2": 1.0,
    "K3": 1e11,
    "a": 1e6,
    "alpha": 500.0,
    "beta": 2e4,
    "K1": 300.0,
    "tau1": 0.01,
    "F0": 0.05,
    "u0": 0.1,
    "rate": 1e-5,
    "Rth": 0.1,
    "u_max": 1.5,
    "tau_v": 2e-3,
    "tau_s": 1e-3,
    "kl": 1.0,
    "r": 0.05,
    "scale": 1.0,
    "k2": 2e3,
    "c2": 0.1,
    "m2": 1e-3,
    "Re": 10.0,
    "Ks": 100.0,
}
BIG = {
    "Fc": 20.0,
    "Fs": 30.0,
    "vs": 0.02,
    "s0": 1e5,
    "s1": 50.0,
    "gap": 1e-4,
    "F0": 20.0,
    "delay": 4e-3,
}  # of the cylinder


def with_effect(base, entry):
    """``base`` with an effect that is there."""
    size = VALUES | (BIG if base.name == "pneumatic_cylinder" else {})
    return (base + entry).start(**{q.name: size[q.name] for q in entry.parameters if q.name in size})


# What makes the step itself another one: friction that sticks, bristles, play, delays, lags. The others only write longer
# expressions, which all of them together show; each alone is a matter for the slow run.
OWN_STEP = {
    micro_actuator: (
        "coulomb_friction",
        "stribeck_friction",
        "lugre_friction",
        "transport_delay",
        "sensor_lag",
        "input_saturation",
    ),
    pneumatic_cylinder: ("choked_flow", "valve_lag", "backlash"),
}
CASES = [
    pytest.param(
        base, entry, id=f"{base.name}-{entry.name}", marks=[pytest.mark.slow] * (entry.name not in OWN_STEP[base])
    )
    for base in OWN_STEP
    for entry in applicable_effects(base)
    # A row in which an input was written is one of the record: the header says so, and the step has none of it.
    if not entry.late
]
TOGETHER = [
    (
        micro_actuator,
        (
            "quadratic_damping",
            "cubic_stiffness",
            "quadratic_stiffness",
            "viscoelastic_creep",
            "bouc_wen_hysteresis",
            "second_mode",
            "force_constant_droop",
            "winding_heating",
            "constant_load",
            "soft_saturation",
            "input_dead_zone",
            "input_offset",
            "sensor_drift",
        ),
    ),
    (micro_actuator, ("eddy_current", "end_stop", "end_stops", "cogging", "gain_by_sign")),
    (micro_actuator, ("reversed_input", "reversed_reading")),
    (pneumatic_cylinder, ("valve_hysteresis",)),
    (
        pneumatic_cylinder,
        ("return_spring", "chamber_leakage", "supply_droop", "position_dependent_volume", "valve_dead_zone"),
    ),
]


def drive(model, rows=150):
    dt = 2.5e-4 if model.name == "micro_actuator" else 0.01
    t = np.arange(rows) * dt
    rng = np.random.default_rng(3)
    return dt, t, 2 * np.sin(2 * np.pi * t / (40 * dt)) + np.repeat(rng.uniform(-1, 1, rows // 10), 10)


def compiled(folder, model, optimise, **options):
    """The exported step as a library, with its state, inputs and outputs as arrays of doubles (the structs hold nothing else)."""
    source, _ = gb.export.to_c(model, folder / "plant.c", **options)
    library = folder / "plant.so"
    command = [
        *find_compiler().command,
        "-std=c99",
        optimise,
        "-Wall",
        "-Wextra",
        "-pedantic",
        "-Werror",
        "-shared",
        "-fPIC",
    ]
    subprocess.run([*command, "-o", str(library), str(source), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def run_in_c(folder, model, u, optimise="-O2", **options):
    library = compiled(folder, model, optimise, **options)
    name = model.name
    state, shown = (ctypes.c_double * 64)(), (ctypes.c_double * 8)()
    getattr(library, f"{name}_start")(state)
    rows = []
    for value in u:
        given = (ctypes.c_double * 1)(value)
        getattr(library, f"{name}_outputs")(state, given, shown)
        rows.append(list(shown)[: len(model.outputs)])
        getattr(library, f"{name}_step")(state, given)
    return np.array(rows)


def compare(found, run, tolerance=1e-12):
    for j, values in enumerate(run.outputs.values()):
        np.testing.assert_allclose(found[:, j], values, atol=tolerance * np.abs(values).max(), rtol=0)


@pytest.mark.crossed(3)
@pytest.mark.parametrize(("base", "entry"), CASES)
def test_c_is_the_library_step_for_every_effect(tmp_path, base, entry):
    model = with_effect(base, entry)
    dt, t, u = drive(base)
    found = run_in_c(tmp_path, model, u, "-O0", dt=dt, substeps=4)  # compiling is most of the time
    run = gb.simulate(model, {"time": t, "u": u}, substeps=4)
    assert np.abs(run.outputs[model.outputs[0].name]).max() > 0
    compare(found, run)


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(("base", "names"), TOGETHER)
def test_c_is_the_library_step_for_effects_together(tmp_path, base, names):
    model = base
    for name in names:
        model = with_effect(model, gb.effect(name))
    dt, t, u = drive(base)
    found = run_in_c(tmp_path, model, u, "-O0", dt=dt, substeps=4)
    compare(found, gb.simulate(model, {"time": t, "u": u}, substeps=4))


def test_every_effect_is_in_the_ordinary_run():
    for base, alone in OWN_STEP.items():
        met = {*alone, *(name for other, names in TOGETHER if other is base for name in names)}
        actuator = {
            *OWN_STEP[micro_actuator],
            *(name for other, names in TOGETHER if other is micro_actuator for name in names),
        }
        of_the_other = actuator if base is pneumatic_cylinder else set()
        assert {
            e.name.partition("_at_")[0] for e in applicable_effects(base) if not e.late
        } - met - of_the_other == set()


@pytest.mark.parametrize("model", [micro_actuator, pneumatic_full, cascaded_tanks], ids=lambda m: m.name)
def test_c_of_the_plants(tmp_path, model):
    dt, t, u = drive(model)
    u = u + 4 if model is cascaded_tanks else u
    options = {"substeps": 0 if model is micro_actuator else 4}
    found = run_in_c(tmp_path, model, u, dt=dt, **options)
    compare(found, gb.simulate(model, {"time": t, "u": u}, **options))


def test_the_header_says_what_the_numbers_are(tmp_path):
    model = with_effect(micro_actuator, gb.effect("stribeck_friction")) + gb.effect("transport_delay")
    _, header = gb.export.to_c(model.start(delay=4e-4), tmp_path / "rig.c", dt=2.5e-4)
    text = header.read_text()
    assert "M dv/dt = Kf i - B v" in text and "stribeck_friction holds up to max(Fs, Fc)" in text
    assert "double v;   /* [m/s] velocity of the moving link, eq. 9 */" in text
    assert "double u_2; /* [V] u of 2 steps ago; DBL_MAX: as in the first step */" in text
    assert "  Ra     8.0" in text and "assumed, plausible" in text
    assert "#define MICRO_ACTUATOR_SAMPLING_TIME 0.00025 /* s */" in text


@pytest.mark.parametrize("name", ["linear_input", "band_limited_input", "late_row", "early_row"])
def test_the_header_says_that_the_input_of_a_record_did_not_wait_between_its_rows(tmp_path, name):
    _, header = gb.export.to_c(micro_actuator + gb.effect(name), tmp_path / "plant.c", dt=1e-4)
    text = " ".join(line.strip(" *") for line in header.read_text().splitlines())
    assert f"{name} says what the input did between the rows" in text
    _, header = gb.export.to_c(micro_actuator, tmp_path / "plain.c", dt=1e-4)
    assert "between the rows" not in header.read_text()


# Words of C and C++, macros of headers and systems, and names in the text itself.
TAKEN_NAMES = [
    "class",
    "this",
    "double",
    "errno",
    "stdin",
    "EOF",
    "I",
    "M_PI",
    "NQ",
    "SUBSTEPS",
    "unix",
    "none",
    "sensors",
]


def lags(title, names):
    """Lags of one input, one behind the other, whose states have these ``names``."""
    return gb.Model(
        title,
        states=[gb.State(name, "V") for name in names],
        inputs=[gb.Input("u", "V")],
        outputs=[gb.Output(names[-1], "V")],
        parameters=[gb.Parameter("tau", "s", 0.5, (1e-3, 1e3))],
        balances=lambda x, u, p: [
            gb.Balance(f"lag {k}", "V", p.tau, name, drive=x[names[k - 1]] if k else u.u, decay=-x[name])
            for k, name in enumerate(names)
        ],
    )


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    "model", [lags("lag", TAKEN_NAMES), *(lags(name, ["y"]) for name in TAKEN_NAMES)], ids=lambda m: m.title
)
def test_no_name_of_a_model_is_one_of_c(tmp_path, model):
    source, _ = gb.export.to_c(model, tmp_path / "plant.c", dt=0.1)
    headers = ["errno", "stdio", "stdlib", "complex", "signal", "limits", "stdbool", "iso646", "unistd"]
    beside = "".join(f"#include <{header}.h>\n" for header in headers)
    (tmp_path / "all.c").write_text(beside + '#include "plant.c"\n')
    warnings = ["-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only"]
    for standard in ("-std=c99", "-std=gnu11"):
        command = [*find_compiler().command, standard, *warnings]
        subprocess.run([*command, str(source), str(tmp_path / "all.c")], check=True, cwd=tmp_path)
    if shutil.which("g++"):
        subprocess.run(["g++", *warnings, str(source)], check=True)
    # The other languages, too.
    gb.export.to_python(model, tmp_path / "plant.py")
    compile((tmp_path / "plant.py").read_text(), "plant.py", "exec")
    gb.export.to_casadi(model)


def test_c_without_a_sampling_time_is_refused(tmp_path):
    with pytest.raises(gb.errors.ModelError, match="no sampling time is known; give dt in seconds"):
        gb.export.to_c(micro_actuator, tmp_path / "plant.c")
    assert not list(tmp_path.iterdir())


fmpy = pytest.importorskip("fmpy", reason="fmpy comes with the extra 'test'")


def run_fmu(path, t, u, outputs, **options):
    signal = np.array(list(zip(t, u, strict=True)), dtype=[("time", float), ("u", float)])
    step = t[1] - t[0]
    found = fmpy.simulate_fmu(
        str(path), stop_time=t[-1], output_interval=step, step_size=step, input=signal, output=outputs, **options
    )
    return np.column_stack([found[name] for name in outputs])


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    """The actuator, stepped every 0.25 ms with 16 substeps."""
    return gb.export.to_fmu(micro_actuator, tmp_path_factory.mktemp("fmu") / "plant.fmu", dt=2.5e-4, substeps=16)


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("lugre_friction", "sensor_lag")]


@pytest.mark.crossed(3)
@pytest.mark.parametrize("name", ["", "stribeck_friction", "transport_delay", "backlash", *SLOW])
def test_the_fmu_runs_as_the_library(tmp_path, fmu, name):
    from fmpy.validation import validate_fmu

    model = with_effect(micro_actuator, gb.effect(name)) if name else micro_actuator
    dt, t, u = drive(model)
    path = gb.export.to_fmu(model, tmp_path / "plant.fmu", dt=dt, substeps=16) if name else fmu
    assert validate_fmu(str(path)) == []
    compare(run_fmu(path, t, u, ["x", "i"]), gb.simulate(model, {"time": t, "u": u}, method="rk4", substeps=16))


def test_the_fmu_of_the_cylinder_starts_from_its_constants(tmp_path):
    dt, t, u = drive(pneumatic_full)
    path = gb.export.to_fmu(pneumatic_full, tmp_path / "plant.fmu", dt=dt, substeps=8)
    raised = pneumatic_full.start(P_S=7e5)
    found = run_fmu(path, t, u, ["s", "p_a", "p_b"], start_values={"P_S": 7e5})
    compare(found, gb.simulate(raised, {"time": t, "u": u}, method="rk4", substeps=8))
    assert found[0, 1] == 3.5e5


def test_constants_and_initial_states_of_the_fmu_can_be_set(fmu):
    _, t, u = drive(micro_actuator)
    found = run_fmu(fmu, t, 0 * u, ["x", "i"], start_values={"K": 6500.0, "state.x": 1e-5})
    stiff = gb.simulate(
        micro_actuator.start(K=6500.0), {"time": t, "u": 0 * u}, initial={"x": 1e-5}, method="rk4", substeps=16
    )
    compare(found, stiff)


def test_finer_communication_steps_change_nothing_visible(tmp_path):
    dt, t, u = drive(micro_actuator)
    path = gb.export.to_fmu(micro_actuator, tmp_path / "plant.fmu", dt=4 * dt, substeps=64)
    coarse = gb.simulate(micro_actuator, {"time": t, "u": u}, method="rk4", substeps=64)
    compare(run_fmu(path, t, u, ["x", "i"]), coarse, 1e-7)


def test_a_delay_refuses_other_communication_steps(tmp_path):
    model = with_effect(micro_actuator, gb.effect("transport_delay"))
    dt, t, u = drive(model)
    path = gb.export.to_fmu(model, tmp_path / "plant.fmu", dt=2 * dt, substeps=8)
    heard = []
    with pytest.raises(Exception, match="fmi2DoStep"):
        run_fmu(path, t, u, ["x"], logger=lambda *said: heard.append(str(said[-1])))
    assert "whole multiples of 0.0005 s" in " ".join(heard)


def test_the_fmu_carries_its_sources_and_units(tmp_path, fmu):
    names = zipfile.ZipFile(fmu).namelist()
    assert "sources/micro_actuator.c" in names and any(n.startswith("binaries/") for n in names)
    described = fmpy.read_model_description(str(fmu))
    units = {v.name: v.unit for v in described.modelVariables}
    assert units["state.v"] == "m/s" and units["Kf"] == "N/A" and units["u"] == "V"
    again = gb.export.to_fmu(micro_actuator, tmp_path / "again.fmu", dt=2.5e-4, substeps=16, binary=False)
    source = [zipfile.ZipFile(p).read("sources/micro_actuator.c") for p in (fmu, again)]
    assert source[0] == source[1]
    assert not any(n.startswith("binaries/") for n in zipfile.ZipFile(again).namelist())


@contextmanager
def opened(path):
    """An instance of an FMU after its initialisation."""
    from fmpy import fmi2

    described = fmpy.read_model_description(str(path))
    folder = fmpy.extract(str(path))
    # A logger of its own: fmpy's default one goes on to that of the last simulation, which may be gone.
    calls = fmi2.fmi2CallbackFunctions()
    calls.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *_: None)
    calls.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
    calls.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
    slave = fmi2.FMU2Slave(
        guid=described.guid,
        unzipDirectory=folder,
        modelIdentifier=described.coSimulation.modelIdentifier,
        instanceName="one",
    )
    slave.instantiate(callbacks=calls)
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    yield slave
    slave.terminate()
    slave.freeInstance()
    shutil.rmtree(folder)


def test_the_state_of_an_fmu_can_be_kept_and_taken_up_again(fmu):
    with opened(fmu) as slave:
        slave.setReal([0], [1.0])
        slave.doStep(0.0, 2.5e-4)
        kept = slave.getFMUState()
        slave.doStep(2.5e-4, 2.5e-4)
        once = slave.getReal([1])
        slave.setFMUState(kept)
        slave.doStep(2.5e-4, 2.5e-4)
        assert slave.getReal([1]) == once
        slave.freeFMUState(kept)


@pytest.mark.parametrize("reference", [2**31, 2**32 - 1, 2**32 - 5, 1000])
def test_the_fmu_refuses_references_beyond_its_variables(fmu, reference):
    with opened(fmu) as instance:
        for call in (lambda: instance.getReal([reference]), lambda: instance.setReal([reference], [1.0])):
            with pytest.raises(fmpy.fmi1.FMICallException):
                call()


@pytest.mark.parametrize("length", [1e9, 1e300, float("nan"), float("inf"), -1.0])
def test_the_fmu_refuses_a_step_that_it_cannot_take(fmu, length):
    with opened(fmu) as instance, pytest.raises(fmpy.fmi1.FMICallException):
        instance.doStep(0.0, length)


@pytest.mark.parametrize("now", [0.0, 5e-4, -1.0, float("nan")])
def test_the_fmu_refuses_a_step_that_does_not_begin_where_it_stands(fmu, now):
    with opened(fmu) as instance:
        instance.doStep(0.0, 2.5e-4)
        with pytest.raises(fmpy.fmi1.FMICallException):
            instance.doStep(now, 2.5e-4)
        instance.doStep(2.5e-4 + 1e-15, 2.5e-4)


def test_the_fmu_refuses_calls_without_arrays(fmu):
    with opened(fmu) as instance:
        for call in (instance.fmi2GetReal, instance.fmi2SetReal):
            with pytest.raises(fmpy.fmi1.FMICallException):
                call(instance.component, None, 1, None)


@pytest.mark.skipif(sys.platform == "win32", reason="a compiler that is a shell script")
@pytest.mark.parametrize("program", ["printf '\\033[2J no room' >&2; exit 1", "kill -9 $$", None, 'gcc "'])
def test_a_compiler_that_fails_leaves_the_old_fmu_and_is_named(tmp_path, monkeypatch, program):
    compiler, old = tmp_path / "cc", tmp_path / "plant.fmu"
    compiler.write_text(f"#!/bin/sh\n{program}\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", {None: "/no/such/program", 'gcc "': 'gcc "'}.get(program, str(compiler)))
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path / "cache"))
    old.write_text("the old one")
    with pytest.raises(GreyboxError, match="plant\\.fmu: cannot be written") as error:
        gb.export.to_fmu(silverbox, old, dt=1e-3)
    assert str(error.value).isprintable()
    assert old.read_text() == "the old one"
