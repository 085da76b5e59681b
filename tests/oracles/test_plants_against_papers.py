"""The plants against their papers: matrices derived by hand, printed numbers, identities for any constants."""

import copy
import dataclasses
import math

import casadi as ca
import control
import numpy as np
import pytest
from scipy.signal import cont2discrete

from greybox.base.errors import ModelError
from greybox.discovery.disturbance_sites import list_disturbance_sites
from greybox.model.effects.catalogue import effect
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator, micro_actuator_no_inductance
from models.micro_actuator_geometry import PLAUSIBLE, as_printed, corrected, whole_device
from models.pneumatic_cylinder import pneumatic_cylinder
from models.silverbox import silverbox

MODELS = [micro_actuator, micro_actuator_no_inductance, pneumatic_cylinder, emps, silverbox, cascaded_tanks]
LINEAR = [m for m in MODELS if m is not cascaded_tanks]

# Identified in the actuator's paper, section 4.2: gain [m/V], wn^2 [1/s^2], twice the decay rate [1/s].
GAIN, WN2, TWO_SIGMA = 29.539e-6, 590444.53, 51.19


def random_values(model, seed):
    """Constants spread over a decade either side of the model's own."""
    rng = np.random.default_rng(seed)
    return {name: value * 10 ** rng.uniform(-1, 1) for name, value in model.values.items()}


def matrices(model, values=None):
    """A, B, C, D of a linear model from its right-hand side, column by column, without differentiation."""
    p = list((values or model.values).values())
    nx, nu = len(model.system.state_names), len(model.system.input_names)
    rest = np.zeros(nx), np.zeros(nu)

    def columns(function):
        base = np.array(function(*rest, p)).ravel()
        by_x = [np.array(function(row, rest[1], p)).ravel() - base for row in np.eye(nx)]
        by_u = [np.array(function(rest[0], row, p)).ravel() - base for row in np.eye(nu)]
        return np.column_stack(by_x), np.column_stack(by_u)

    return (*columns(model.system.rhs_function), *columns(model.system.output_function))


def response(system, s):
    """Transfer matrix at the complex frequency s."""
    A, B, C, D = system
    return C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D


def equation_16_1(s, M, B, K, Kf, Kv, Ra, La):
    return Kf / (La * M * s**3 + (La * B + Ra * M) * s**2 + (Ra * B + K * La + Kf * Kv) * s + K * Ra)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_every_constant_has_a_source_and_a_description_and_room_either_side(model):
    for q in model.parameters:
        assert q.source.strip(), q.name
        assert q.description.strip(), q.name
        assert "\n" not in q.description, q.name
        assert q.bounds[0] * 6 < q.value < q.bounds[1] / 9, q.name
        if not q.fixed:
            assert q.bounds[0] * 20 <= q.value <= q.bounds[1] / 20, q.name
    assert model.source
    assert model.description


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_which_models_are_linear(model):
    assert model.system.linear == (model in LINEAR)


@pytest.mark.parametrize("seed", range(5))
def test_actuator_has_the_transfer_function_of_equation_16_1(seed):
    values = random_values(micro_actuator, seed)
    A, B, C, D = matrices(micro_actuator, values)
    M, B_, K, Kf, Kv, Ra, La = (values[n] for n in ("M", "B", "K", "Kf", "Kv", "Ra", "La"))

    tf = control.ss2tf(control.ss(A, B, C[:1], D[:1]))
    numerator, denominator = np.trim_zeros(tf.num[0][0], "f"), tf.den[0][0]
    expected = np.array([La * M, La * B_ + Ra * M, Ra * B_ + K * La + Kf * Kv, K * Ra]) / (La * M)
    np.testing.assert_allclose(denominator, expected, rtol=1e-9)
    assert numerator[-1] == pytest.approx(Kf / (La * M), rel=1e-8)

    for s in (0.0, 30j, 500j, 2000j - 100.0):
        x, i = response((A, B, C, D), s).ravel()
        assert x == pytest.approx(equation_16_1(s, **values), rel=1e-10)
        # eq. 15: (M s^2 + B s + K) X = Kf I
        assert i == pytest.approx((M * s**2 + B_ * s + K) / Kf * x, rel=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_actuator_without_inductance_is_equation_16_2_and_the_limit_of_16_1(seed):
    values = random_values(micro_actuator_no_inductance, seed)
    system = matrices(micro_actuator_no_inductance, values)
    fast_coil = matrices(micro_actuator, {n: (values | {"La": 1e-13})[n] for n in micro_actuator.values})
    for s in (0.0, 30j, 500j, 2000j - 100.0):
        assert response(system, s)[0, 0] == pytest.approx(equation_16_1(s, **values, La=0.0), rel=1e-10)
        np.testing.assert_allclose(response(system, s), response(fast_coil, s), rtol=1e-5)


def test_actuator_default_poles_and_gain_are_the_papers():
    for model, rtol in ((micro_actuator_no_inductance, 2e-4), (micro_actuator, 2e-4)):
        system = matrices(model)
        poles = np.linalg.eigvals(system[0])
        slow = poles[poles.imag > 0][0]
        assert response(system, 0.0)[0, 0] == pytest.approx(GAIN, rel=rtol)
        assert abs(slow) ** 2 == pytest.approx(WN2, rel=rtol)
        assert -2 * slow.real == pytest.approx(TWO_SIGMA, rel=1e-3)
    assert poles.real.min() == pytest.approx(-15976, abs=1)


def test_actuator_zero_order_hold_at_4_khz():
    A, B, C, D = matrices(micro_actuator)
    Ad, Bd, Cd, Dd, _ = cont2discrete((A, B, C[:1], D[:1]), 1 / 4000)
    tf = control.ss2tf(control.ss(Ad, Bd, Cd, Dd, 1 / 4000))
    np.testing.assert_allclose(tf.den[0][0], [1, -1.96916, 1.02323, -0.01819], atol=1e-5)
    np.testing.assert_allclose(1e6 * tf.num[0][0][-3:], [0.33717, 0.67133, 0.05141], atol=2e-5)


def test_mass_times_resistance_is_bounded_by_passivity():
    # With Kf = Kv = g Ra K and K = wn^2 M the coil's share of the damping is (g wn^2)^2 M Ra: all of it at the bound.
    bound = TWO_SIGMA / (GAIN * WN2) ** 2
    assert bound == pytest.approx(0.1683, abs=5e-5)
    M = 0.02
    K, Ra = WN2 * M, bound / M
    values = {"M": M, "B": 0.0, "K": K, "Kf": GAIN * Ra * K, "Kv": GAIN * Ra * K, "Ra": Ra}
    A, B, C, D = matrices(micro_actuator_no_inductance, values)
    assert list(values) == list(micro_actuator_no_inductance.values)
    assert -np.trace(A) == pytest.approx(TWO_SIGMA, rel=1e-9)
    assert response((A, B, C, D), 0.0)[0, 0] == pytest.approx(GAIN, rel=1e-9)
    defaults = micro_actuator.values
    assert defaults["M"] * defaults["Ra"] < bound


def test_back_emf_takes_from_the_circuit_what_the_coil_gives_to_the_mechanism():
    # With Kf = Kv the stored energy M v^2/2 + K x^2/2 + La i^2/2 changes by u i - B v^2 - Ra i^2 and nothing else.
    values = micro_actuator.values
    x, v, i, u = 2e-5, -0.013, 0.21, 1.7
    rates = np.array(micro_actuator.system.rhs_function([x, v, i], [u], list(values.values()))).ravel()
    power = values["K"] * x * rates[0] + values["M"] * v * rates[1] + values["La"] * i * rates[2]
    assert power == pytest.approx(u * i - values["B"] * v**2 - values["Ra"] * i**2, rel=1e-12)


def test_actuator_geometry_from_the_motion_of_the_links():
    g = dataclasses.replace(PLAUSIBLE, beta1=0.37, I1=5e-8, B2=2.2e-5, K2=0.11)
    mass, damping, stiffness = dataclasses.astuple(corrected(g))
    angle, h = 1e-4, 1e-7  # deflection of link 1 from 90 degrees and a step of it

    def places(phi):  # mass centre of link 1, and the end that carries the moving link
        return g.beta1 * g.r1 * np.array([math.cos(phi), math.sin(phi)]), g.r1 * math.cos(phi)

    (c0, x0), (c1, x1) = places(math.pi / 2 - h / 2), places(math.pi / 2 + h / 2)
    kinetic = g.m1 * np.sum((c1 - c0) ** 2) + g.I1 * h**2 + g.m2 * (x1 - x0) ** 2
    assert mass == pytest.approx(kinetic / (x1 - x0) ** 2, rel=1e-9)

    moving_link_turns = 0.0
    hinges = g.K1 * angle**2 + g.K2 * (moving_link_turns - angle) ** 2
    losses = g.B1 * angle**2 + g.B2 * (moving_link_turns - angle) ** 2
    assert stiffness == pytest.approx(hinges / (g.r1 * angle) ** 2, rel=1e-12)
    assert damping == pytest.approx(losses / (g.r1 * angle) ** 2, rel=1e-12)


def test_actuator_geometry_as_printed_misses_hinge_two_and_misplaces_the_inertia():
    mass, *hinges = dataclasses.astuple(corrected(PLAUSIBLE))
    mass_printed, *hinges_printed = dataclasses.astuple(as_printed(PLAUSIBLE))
    assert hinges == pytest.approx([2 * value for value in hinges_printed])  # equal hinges
    assert mass - mass_printed == pytest.approx((1 - PLAUSIBLE.m1) * PLAUSIBLE.I1 / PLAUSIBLE.r1**2)
    no_inertia = dataclasses.replace(PLAUSIBLE, I1=0.0, K2=0.0, B2=0.0)
    assert dataclasses.astuple(as_printed(no_inertia)) == pytest.approx(dataclasses.astuple(corrected(no_inertia)))


def test_actuator_geometry_gives_the_defaults_for_four_quarters():
    device = dataclasses.astuple(whole_device(corrected(PLAUSIBLE)))
    assert device == pytest.approx([micro_actuator.values[name] for name in ("M", "B", "K")], rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_cylinder_pressure_difference_is_equation_10_5_and_the_sum_stays(seed):
    c = random_values(pneumatic_cylinder, seed)
    v, u = 0.13, -2.4
    rates = np.array(pneumatic_cylinder.system.rhs_function([0.05, v, 5e5, 3e5], [u], list(c.values()))).ravel()
    by_valve = 2 * c["P_a"] * c["K2"] * c["P_S"] / (c["rho_a"] * c["V_total"]) * u
    by_piston = 2 * c["P_S"] * c["A_piston"] / c["V_total"] * v
    assert rates[2] - rates[3] == pytest.approx(by_valve - by_piston, rel=1e-12)
    assert rates[2] + rates[3] == pytest.approx(0.0, abs=1e-9 * abs(by_valve))
    assert rates[1] == pytest.approx(c["A_piston"] * 2e5 / c["M_piston"] - c["f_v"] * v, rel=1e-12)  # eq. 10.7


@pytest.mark.parametrize("seed", range(5))
def test_cylinder_is_equation_10_9_in_position_velocity_acceleration(seed):
    c = random_values(pneumatic_cylinder, seed)
    A, B, _, _ = matrices(pneumatic_cylinder, c)
    wn2 = 2 * c["P_S"] * c["A_piston"] ** 2 / (c["M_piston"] * c["V_total"])
    A9 = np.array([[0, 1, 0], [0, 0, 1], [0, -wn2, -c["f_v"]]])
    b9 = 2 * c["P_a"] * c["K2"] * c["P_S"] * c["A_piston"] / (c["rho_a"] * c["M_piston"] * c["V_total"])
    T = np.array([[1, 0, 0, 0], [0, 1, 0, 0], A[1]])  # (s, v, p_a, p_b) -> (s, s', s'')
    np.testing.assert_allclose(T @ A, A9 @ T, rtol=1e-10, atol=1e-12 * wn2)
    np.testing.assert_allclose(T @ B, [[0], [0], [b9]], rtol=1e-10)

    # two poles at 0 (position, p_a + p_b) and the pair of wn
    polynomial = np.poly(np.linalg.eigvals(A)).real
    np.testing.assert_allclose(polynomial, [1, c["f_v"], wn2, 0, 0], rtol=1e-8, atol=1e-7 * wn2)


def test_cylinder_defaults():
    c = pneumatic_cylinder.values
    wn = c["A_piston"] * math.sqrt(2 * c["P_S"] / (c["M_piston"] * c["V_total"]))
    assert wn == pytest.approx(48.6, abs=0.1)
    assert c["f_v"] / (2 * wn) == pytest.approx(0.48, abs=0.01)
    assert c["f_v"] / wn**2 == pytest.approx(19.6e-3, abs=1e-4)

    A, B, C, D = matrices(pneumatic_cylinder)
    s = 1e-3j
    assert abs(s * response((A, B, C, D), s)[0, 0]) == pytest.approx(0.0472, abs=1e-4)  # m/s per volt
    Ad = cont2discrete((A, B, C, D), 0.01)[0]
    poles = np.linalg.eigvals(Ad)
    np.testing.assert_allclose(np.sort(poles.real), [0.722, 0.722, 1, 1], atol=1e-3)
    assert poles.imag.max() == pytest.approx(0.329, abs=1e-3)


def test_cylinder_rests_at_half_the_supply_pressure_and_only_friction_and_flow_are_free():
    model = pneumatic_cylinder.fix(P_S=7e5)
    start, slope = model.system.start_function(list(model.values.values()))
    np.testing.assert_allclose(np.array(start).ravel(), [0, 0, 3.5e5, 3.5e5])
    column = model.system.parameter_names.index("P_S")
    np.testing.assert_allclose(np.array(slope)[:, column], [0, 0, 0.5, 0.5])
    assert [q.name for q in pneumatic_cylinder.free_parameters] == ["K2", "f_v"]


@pytest.mark.parametrize("seed", range(3))
def test_emps_speed_follows_force_with_the_lag_of_mass_over_friction(seed):
    c, s = random_values(emps, seed), 0.7 + 3j
    assert response(matrices(emps, c), s)[0, 0] == pytest.approx(c["g"] / (s * (c["M"] * s + c["Fv"])), rel=1e-10)
    assert [q.name for q in emps.free_parameters] == ["M", "Fv"]
    assert emps.values["g"] == 35.15065


@pytest.mark.parametrize("seed", range(3))
def test_silverbox_is_a_mass_on_a_spring(seed):
    c, s = random_values(silverbox, seed), -20 + 400j
    assert response(matrices(silverbox, c), s)[0, 0] == pytest.approx(c["b"] / (s**2 + c["d"] * s + c["k1"]), rel=1e-10)
    assert math.sqrt(silverbox.values["k1"]) / (2 * math.pi) == pytest.approx(70, abs=2)


def tank_rates(x, u, values):
    return np.array(cascaded_tanks.system.rhs_function(x, [u], [values[n] for n in cascaded_tanks.values])).ravel()


def test_tanks_come_to_rest_where_outflow_balances_inflow():
    c, u = cascaded_tanks.values, 2.0
    upper = (c["k4"] * u / c["k1"]) ** 2
    lower = (c["k2"] / c["k3"]) ** 2 * upper
    np.testing.assert_allclose(tank_rates([upper, lower], u, c), 0, atol=1e-12)
    assert tank_rates([upper * 1.1, lower], u, c)[0] < 0 < tank_rates([upper * 1.1, lower], u, c)[1]
    y = cascaded_tanks.system.output_function([upper, lower], [u], list(c.values()))
    assert float(y) == pytest.approx(lower)


def test_the_scale_of_the_upper_level_is_free():
    c, x1, x2, u = cascaded_tanks.values, 7.0, 4.0, 3.0
    plain = tank_rates([x1, x2], u, c)
    for scale in (0.3, 4.0):
        other = c | {"k1": c["k1"] / scale**0.5, "k2": c["k2"] * scale**0.5, "k4": c["k4"] / scale}
        rates = tank_rates([x1 / scale, x2], u, other)
        np.testing.assert_allclose(rates, [plain[0] / scale, plain[1]], rtol=1e-12)
    assert cascaded_tanks.parameter("k2").fixed


@pytest.mark.parametrize("level", [0.0, -0.1])
def test_an_empty_tank_has_finite_slopes(level):
    system = cascaded_tanks.system
    p = list(cascaded_tanks.values.values())
    slopes = ca.Function(
        "slopes", [system.x, system.u, system.p], [ca.jacobian(system.rhs, ca.vertcat(system.x, system.p))]
    )
    assert np.isfinite(np.array(slopes([level, level], [1.0], p))).all()
    assert np.array(system.rhs_function([level, level], [1.0], p))[0] == pytest.approx(
        cascaded_tanks.values["k4"], rel=1e-3
    )


def test_other_values_keep_the_equations_and_other_bounds_of_a_delay_do_not():
    heated = micro_actuator + effect("winding_heating")
    assert heated.start(K=5000.0).fix(M=0.02).system is heated.system
    with pytest.raises(ModelError, match="finite"):
        micro_actuator.with_process_noise(v=0.1).start(B=math.nan)
    late = (micro_actuator + effect("transport_delay")).bound(delay=(0.0, 1e-3))
    assert late.bound(delay=(0.0, 2e-3)).system.delays[0].longest == 2e-3
    assert late.fix(delay=5e-4).system.delays[0].longest == 5e-4


def test_a_deep_copy_of_a_model_has_the_same_system():
    assert copy.deepcopy(micro_actuator).system is micro_actuator.system


def test_something_is_missing_in_the_plant_and_not_in_the_balance_of_an_effect():
    names = [p.name for p in list_disturbance_sites(micro_actuator + effect("winding_heating"), ["x", "i"])]
    assert names == ["force", "voltage", "u", "x", "i"]
