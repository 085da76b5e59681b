"""Slopes by an FMU's own directional derivatives are those of its equations."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox.data.experiment import Experiment
from greybox.extensions.fmu.plant import read_fmu
from greybox.extensions.fmu.simulator import FmuSimulator
from tests.support.reference_fmus import DAHLQUIST, MASS, VAN_DER_POL, build_reference_fmu

pytest.importorskip("fmpy", reason="fmpy comes with the extra 'fmu'")
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler on the path"
)
TIME = 0.05 * np.arange(200)


def van_der_pol_slopes(mu):
    """By the variational equations."""

    def rates(t, z):
        x, v, sx, sv = z
        return [v, mu * (1 - x**2) * v - x, sv, (-2 * mu * x * v - 1) * sx + mu * (1 - x**2) * sv + (1 - x**2) * v]

    return solve_ivp(rates, (0, TIME[-1]), [2.0, 0, 0, 0], t_eval=TIME, rtol=1e-11, atol=1e-13).y


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_slopes_are_those_of_the_variational_equations(tmp_path, version):
    plant = read_fmu(build_reference_fmu(VAN_DER_POL, tmp_path, version, "ModelExchange"))
    record = Experiment("r", TIME, {}, {"x0": np.cos(TIME)})
    with FmuSimulator(plant.fmu) as simulator:
        assert simulator.has_derivatives
        run = simulator.run(record, {"mu": 1.3})
        slopes = simulator.differentiate(record, {"mu": 1.3}, plant.fmu.parameters[-1:], np.array([1e-4]), run)
    exact = van_der_pol_slopes(1.3)[2:]
    assert [p.name for p in plant.fmu.parameters[-1:]] == ["mu"]
    np.testing.assert_allclose(slopes[:, :, 0], exact.T, atol=1e-4 * np.abs(exact).max())


@pytest.mark.crossed(3)
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("hold", ["zero", "first"])
def test_inputs_act_as_they_are_held(tmp_path, version, hold):
    plant = read_fmu(build_reference_fmu(MASS, tmp_path, version, "ModelExchange"))
    time = TIME[:100]
    u = np.sin(1.7 * time) + 0.5 * np.sign(np.sin(0.9 * time))
    record = Experiment("r", time, {"F": u}, {"x": 0 * time}, hold)
    k = next(v for v in plant.fmu.parameters if v.label == plant.find("K"))
    with FmuSimulator(plant.fmu) as simulator:
        run, more, less = (simulator.run(record, {"K": value}) for value in (30.0, 30.3, 29.7))
        slopes = simulator.differentiate(record, {"K": 30.0}, [k], np.array([3e-3]), run)
    expected = (more["x"] - less["x"]) / 0.6
    np.testing.assert_allclose(slopes[:, 0, 0], expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.rest
def test_a_fit_uses_them_and_finds_the_same(tmp_path):
    record = Experiment(
        "r", TIME, {}, {"x0": van_der_pol_slopes(1.4)[0] + 0.02 * np.random.default_rng(0).standard_normal(200)}
    )
    fits = []
    for kind in ("ModelExchange", "CoSimulation"):
        plant = read_fmu(build_reference_fmu(VAN_DER_POL, tmp_path, "2.0", kind))
        fits.append(gb.fit(plant.model.start(mu=0.8), record))
    one, other = (f.parameters["mu"] for f in fits)
    assert all(f.success and f.solver.statistics["simulation_equivalents"] <= 11 for f in fits)
    assert abs(one.value - other.value) < 0.02 * one.std and one.std == pytest.approx(other.std, rel=0.01)
    assert one.interval[0] < 1.4 < one.interval[1]


def test_where_there_are_none_differences_take_their_place(tmp_path):
    plant = read_fmu(build_reference_fmu(DAHLQUIST, tmp_path, "2.0", "ModelExchange"))
    record = Experiment("r", TIME, {}, {"x": np.exp(-TIME)})
    with FmuSimulator(plant.fmu) as simulator:
        run = simulator.run(record, {"k": 1.0})
        assert not simulator.has_derivatives
        assert simulator.differentiate(record, {"k": 1.0}, plant.fmu.parameters[-1:], np.array([1e-4]), run) is None


def test_derivatives_that_fail_are_not_asked_for_again(tmp_path, monkeypatch):
    from greybox.extensions.fmu.simulator import SensitivityRunner

    plant = read_fmu(build_reference_fmu(VAN_DER_POL, tmp_path, "2.0", "ModelExchange"))
    record = Experiment("r", TIME, {}, {"x0": van_der_pol_slopes(1.4)[0]})
    asked = []

    def fail(*_):
        asked.append(1)
        raise RuntimeError("fmi2GetDirectionalDerivative failed")

    monkeypatch.setattr(SensitivityRunner, "_along_states", fail)
    # Here and not in the process in which a fit runs the FMU.
    monkeypatch.setattr(type(plant), "is_native", False)
    result = gb.fit(plant.model.start(mu=0.8), record)
    assert len(asked) == 1 and result.success and result.parameters["mu"].value == pytest.approx(1.4, rel=1e-4)
