"""Files: .mat, JSON, NumPy, Python and Modelica read back to what was written."""

import importlib.util
import json
import re
from dataclasses import replace

import casadi as ca
import control
import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import StateSpace, dstep, step

import greybox as gb
from greybox.extensions.export.linear_files import write_control
from greybox.model.effects.catalogue import applicable_effects
from greybox.model.validation import Rule
from greybox.shell.project import find_model
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from models.pneumatic_full import pneumatic_full


def texts(cell):
    return [str(entry[0][0]) for entry in cell]


def test_mat_gives_scipy_the_same_response(tmp_path):
    found = loadmat(gb.export.write_linear(micro_actuator, tmp_path / "plant.mat", "mat"))
    assert found["Ts"].item() == 0
    assert texts(found["StateName"]) == ["x", "v", "i"] and texts(found["OutputUnit"]) == ["m", "A"]
    t = np.linspace(0, 0.05, 400)
    _, y = step(StateSpace(found["A"], found["B"], found["C"][:1], found["D"][:1]), T=t)
    run = gb.simulate(micro_actuator, {"time": t, "u": np.ones(400)})
    np.testing.assert_allclose(y.ravel(), run.outputs["x"], atol=1e-9 * np.abs(y).max())


def test_a_sampled_mat_gives_scipy_the_same_response(tmp_path):
    dt = 2.5e-4
    found = loadmat(gb.export.write_linear(micro_actuator, tmp_path / "plant.mat", "mat", dt=dt))
    assert found["Ts"].item() == dt
    _, (y,) = dstep((*(found[n] for n in "ABCD"), dt), n=300)
    t = dt * np.arange(300)
    run = gb.simulate(micro_actuator, {"time": t, "u": np.ones(300)})
    np.testing.assert_allclose(y[:, 0], run.outputs["x"], atol=1e-12 * np.abs(y[:, 0]).max())


def test_json_and_numpy_keep_every_digit(tmp_path):
    model = gb.linearise(pneumatic_cylinder, dt=0.01, delay=0.004)
    read = json.loads(
        gb.export.write_linear(pneumatic_cylinder, tmp_path / "p.json", "json", dt=0.01, delay=0.004).read_text()
    )
    arrays = np.load(gb.export.write_linear(pneumatic_cylinder, tmp_path / "p.npz", "numpy", dt=0.01, delay=0.004))
    for name in "ABCD":
        np.testing.assert_array_equal(np.array(read[name]).reshape(getattr(model, name).shape), getattr(model, name))
        np.testing.assert_array_equal(arrays[name], getattr(model, name))
    assert read["state_names"] == ["s", "v", "p_a", "p_b", "u_1"] and read["state_units"][-1] == "V"
    assert read["channels"]["u -> s"]["integrators"] == 1
    assert read["parameters"] == pneumatic_cylinder.values


def test_samples_need_a_fit(tmp_path):
    with pytest.raises(gb.errors.ModelError, match="samples need a fit"):
        gb.export.write_linear(micro_actuator, tmp_path / "plant.mat", "mat", samples=5)
    assert not list(tmp_path.iterdir())


def test_the_control_file_makes_the_same_system(tmp_path):
    model = gb.linearise(micro_actuator, dt=2.5e-4)
    path = write_control(model, tmp_path / "plant_file.py")
    spec = importlib.util.spec_from_file_location("plant_file", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    np.testing.assert_array_equal(module.plant.A, model.A)
    assert isinstance(module.plant, control.StateSpace) and module.plant.dt == 2.5e-4
    assert module.plant.output_labels == ["x", "i"] and module.output_units == {"x": "m", "i": "A"}


def same_run(model, back, tolerance=1e-12):
    t = np.arange(300) * 2.5e-4
    u = 2 * np.sin(60 * t) + np.sign(np.sin(300 * t)) + 3 * (model.name == "cascaded_tanks")
    one, other = (gb.simulate(m, {"time": t, m.inputs[0].name: u}, substeps=4) for m in (model, back))
    for name, values in one.outputs.items():
        np.testing.assert_allclose(other.outputs[name], values, atol=tolerance * np.abs(values).max(), rtol=0)


def read_back(model, folder):
    return find_model(str(gb.export.to_python(model, folder / f"{model.name}.py")))


@pytest.mark.parametrize(
    ("value", "bounds"),
    [(3e9, (1e9, 1e10)), (5e30, (1e30, 1e31)), (0.0, (-1.0, 1.0))],
    ids=["bounds without zero", "a value beyond the catalogue's bounds", "the neutral value"],
)
def test_a_written_model_takes_its_values_and_bounds_back(tmp_path, value, bounds):
    """As a discovery writes them: bounds that suit the record may leave out the neutral value of the catalogue."""
    model = micro_actuator + gb.effect("cubic_stiffness")
    effect = model.bound_effects[-1].effect
    (amplitude,) = effect.parameters
    fitted = replace(effect, parameters=(replace(amplitude, value=value, bounds=bounds),))
    again = read_back(micro_actuator + fitted, tmp_path)
    written = again.parameter(again.names_of("cubic_stiffness")[amplitude.name])
    assert (written.value, written.bounds) == (value, bounds)


@pytest.mark.parametrize("model", [micro_actuator, pneumatic_full, cascaded_tanks, emps], ids=lambda m: m.name)
def test_a_python_file_is_the_model_again(tmp_path, model):
    back = read_back(model, tmp_path)
    assert str(back) == str(model)
    assert [vars(q) for q in back.all_parameters] == [vars(q) for q in model.all_parameters]
    assert [r.name for r in back.rules] == [r.name for r in model.rules]
    same_run(model, back)


def test_a_python_file_says_which_rule_it_leaves_out(tmp_path):
    odd = Rule("damping below stiffness", "1", lambda p: 1.0 if p.B < p.K else -1.0, "raise K")
    model = replace(micro_actuator, rules=(*micro_actuator.rules, odd))
    path = gb.export.to_python(model, tmp_path / "rig.py")
    assert (
        "Left out, because its function cannot be written out: the rule 'damping below stiffness'" in path.read_text()
    )
    assert [r.name for r in find_model(str(path)).rules] == [r.name for r in micro_actuator.rules]


def test_a_python_file_keeps_catalogue_effects_by_name(tmp_path):
    model = micro_actuator + gb.effect("stribeck_friction") + gb.effect("transport_delay") + gb.effect("backlash")
    model = model.start(Fc=0.05, Fs=0.08, delay=4e-4, gap=1e-6).bound(Fc=(0, 10)).fix("vs").tie(Kv="Kf")
    back = read_back(model, tmp_path)
    assert 'micro_actuator + effect("stribeck_friction")' in (tmp_path / "micro_actuator.py").read_text()
    assert back.values == model.values and str(back) == str(model)
    assert back.parameter("vs").fixed and back.parameter("Fc").bounds == (0, 10)
    assert {t.name: t.formula for t in back.ties} == {"Kv": "Kf"}
    same_run(model, back)


@pytest.mark.rest
@pytest.mark.parametrize("base", [micro_actuator, pneumatic_cylinder], ids=lambda m: m.name)
def test_a_python_file_writes_other_effects_out(tmp_path, base):
    others = {entry.name for entry in applicable_effects(micro_actuator)} if base is pneumatic_cylinder else set()
    # What an effect says of a record is no part of what is exported, and a warning says so.
    for entry in (e for e in applicable_effects(base) if e.name not in others and not e.is_of_record):
        moved = [replace(q, value=min(q.value + 1e-6, q.bounds[1])) for q in entry.parameters]
        own = replace(entry, name=f"my_{entry.name}", parameters=tuple(moved))
        folder = tmp_path / entry.name
        folder.mkdir()
        same_run(base + own, read_back(base + own, folder))


def test_a_fitted_constant_says_so_in_the_file(tmp_path):
    t = np.arange(400) * 2.5e-4
    record = gb.simulate(micro_actuator, {"time": t, "u": np.sign(np.sin(300 * t))}).record(
        {"x": 1e-7, "i": 1e-3}, np.random.default_rng(0)
    )
    fit = gb.fit(micro_actuator.fix("M", "Ra", "La", "Kv", "Kf"), record)
    text = gb.export.to_python(fit, tmp_path / "rig.py").read_text()
    assert re.search(r'"K", "N/m", 58\d\d\.\d{8,}', text) and "fitted, 95 % interval [58" in text
    assert "fitted to record 1" in text


def test_an_expression_keeps_its_meaning_in_python(tmp_path):
    """Signs, brackets, powers, choices: each written and evaluated again."""

    def balances(x, u, p):
        a, b = x.a, u.u
        tricky = -(a - b) - (a + b) / (a * (b - 2 * p.k)) * -((a**2) ** p.k)
        chosen = ca.if_else(ca.logic_and(a > b, ca.logic_not(b < -1)), -a / -b, ca.fmin(a, -b) ** 3)
        return [
            gb.Balance(
                "rate", "1/s", 1, "a", tricky=tricky * p.r, chosen=-chosen * p.r, decay=-1e-3 * (a - (b - a)) * p.r
            )
        ]

    model = gb.Model(
        "tricky",
        [gb.State("a", "1", 0.7)],
        [gb.Input("u", "1")],
        [gb.Output("a", "1")],
        [gb.Parameter("k", "1", 1.3), gb.Parameter("r", "1/s", 1.0)],
        balances,
    )
    back = read_back(model, tmp_path)
    rng = np.random.default_rng(0)
    for x, u in rng.uniform(-2, 2, (50, 2)):
        one, other = (m.system.rhs_function(x, u, [1.3, 1.0]) for m in (model, back))
        assert float(one) == pytest.approx(float(other), rel=1e-14, nan_ok=True)


def test_modelica_refuses_what_it_cannot_say(tmp_path):
    with pytest.raises(gb.errors.ModelError, match=r"backlash .* is set after each step and has no equation"):
        gb.export.to_modelica(micro_actuator + gb.effect("backlash"), tmp_path / "p.mo")
    bell = gb.Model(
        "bell",
        [gb.State("a", "1")],
        [gb.Input("u", "1")],
        [gb.Output("a", "1")],
        [gb.Parameter("r", "1/s", 1.0)],
        lambda x, u, p: [gb.Balance("rate", "1/s", 1, "a", bell=p.r * ca.erf(x.a - u.u))],
    )
    with pytest.raises(gb.GreyboxError, match="Modelica has no erf"):
        gb.export.to_modelica(bell, tmp_path / "p.mo")
    assert not list(tmp_path.iterdir())


def test_modelica_has_units_and_the_events_of_dry_friction(tmp_path):
    model = (micro_actuator + gb.effect("stribeck_friction") + gb.effect("transport_delay")).start(Fc=0.05, Fs=0.08)
    text = gb.export.to_modelica(model, tmp_path / "rig.mo").read_text()
    assert 'parameter Real B(unit = "N.s/m", min = 0.0001, max = 100.0) = 0.2691' in text
    assert "M * der(v) = if way_v == 0 then 0 else push_v - way_v * level_v" in text
    assert "push_v = Kf * i - B * v - K * x;" in text and "most_v = max(Fs, Fc);" in text
    assert "u_late = delay(u, delay_2);" in text  # delay is a word of the language


def modelica_rates(model, folder, monkeypatch):
    """The rates of the Modelica text, as another program reads it: a function of states and input."""
    api = pytest.importorskip("pymoca.backends.casadi.api", reason="pymoca reads Modelica")
    from pymoca.backends.casadi import generator

    monkeypatch.setitem(generator.OP_MAP, "/", "__truediv__")  # its name in Python 3
    path = gb.export.to_modelica(model, folder / "plant.mo")
    name = re.search(r"^model (\w+)", path.read_text(), re.MULTILINE).group(1)
    read = api.transfer_model(str(folder), name, {})
    residual = read.dae_residual_function
    nx, na = len(read.states), len(read.alg_states)
    x, u, z = ca.MX.sym("x", nx), ca.MX.sym("u"), ca.MX.sym("z", nx + na)
    p = [float(q.value) for q in read.parameters]
    assert [q.symbol.name() for q in read.parameters] == [n.replace(".", "_") for n in model.system.parameter_names]
    left = residual(0, x, z[:nx], z[nx:], u, [], p)
    newton = ca.Function("newton", [z, x, u], [z - ca.solve(ca.jacobian(left, z), left)])

    def rates(x, u):
        found = np.ones(nx + na)
        for _ in range(12):
            found = newton(found, x, u)
        return found.full().ravel()[:nx]

    return rates


@pytest.mark.rest
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    "name",
    [
        "",
        "lugre_friction",
        "cubic_stiffness",
        "eddy_current",
        "winding_heating",
        "second_mode",
    ],
)
def test_another_program_reads_the_same_rates_from_modelica(tmp_path, monkeypatch, name):
    model = micro_actuator + gb.effect(name) if name else pneumatic_full
    model = model.start(Fc=0.05, Fs=0.08, s1=2.0) if name == "lugre_friction" else model
    rates = modelica_rates(model, tmp_path, monkeypatch)
    rng, s = np.random.default_rng(0), model.system
    p = list(model.values.values())
    start = s.start_function(p)[0].full().ravel()
    for _ in range(10):
        size = np.where(start > 0, start, 1e-3)
        x, u = start + 0.3 * size * rng.standard_normal(len(start)), rng.standard_normal()
        ours = s.rhs_function(x, u, p).full().ravel()
        np.testing.assert_allclose(rates(x, u), ours, rtol=1e-9, atol=1e-9 * np.abs(ours).max())


def test_names_of_other_languages_are_kept_apart():
    from greybox.base.texts import to_identifier, to_identifiers

    assert to_identifier("micro_actuator + coulomb_friction") == "micro_actuator_coulomb_friction"
    assert to_identifiers(["a.b", "a_b", "int", "2x"], ["int"]) == ["a_b", "a_b_2", "int_2", "_2x"]
