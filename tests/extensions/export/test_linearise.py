"""Linear models of a fit: against matrices by hand, python-control and scipy; kinks, friction, delays, units of one size."""

import math
from dataclasses import replace

import casadi as ca
import control
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import cont2discrete

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.base.numerics import SMALLEST_TYPICAL_SIZE
from greybox.estimation.linear.exported_model import ExportFinding as Code
from greybox.estimation.linear.operating_point import ModelFunctions, find_operating_point
from greybox.extensions.export.python_control import approximate_delays
from greybox.show.documents.linearisation import linear_question
from greybox.simulation.simulate import simulate_twin
from models.micro_actuator import micro_actuator, micro_actuator_no_inductance
from models.pneumatic_cylinder import pneumatic_cylinder
from models.pneumatic_full import pneumatic_full
from models.pneumatic_pva import pneumatic_pva
from tests.support.findings import find

COULOMB = (micro_actuator + gb.effect("coulomb_friction")).start(Fc=0.1)
DEAD = (micro_actuator + gb.effect("input_dead_zone")).start(d=0.5)


def constants(model):
    return type("P", (), model.values)


def test_the_actuator_is_equation_16_1():
    p = constants(micro_actuator)
    a = [[0, 1, 0], [-p.K / p.M, -p.B / p.M, p.Kf / p.M], [0, -p.Kv / p.La, -p.Ra / p.La]]
    found = gb.linearise(micro_actuator)
    np.testing.assert_allclose(found.A, a, rtol=1e-14)
    np.testing.assert_allclose(found.B, [[0], [0], [1 / p.La]], rtol=1e-14)
    channel = gb.export.extract_channel(found, "x", "u")
    by_hand = [p.M * p.La, p.M * p.Ra + p.B * p.La, p.B * p.Ra + p.K * p.La + p.Kf * p.Kv, p.K * p.Ra]
    np.testing.assert_allclose(channel.denominator, np.array(by_hand) / by_hand[0], rtol=1e-10)
    np.testing.assert_allclose(channel.numerator, [p.Kf / by_hand[0]], rtol=1e-10)
    current = gb.export.extract_channel(found, "i", "u")
    np.testing.assert_allclose(current.numerator, np.array([p.M, p.B, p.K]) / by_hand[0], rtol=1e-10)


def test_without_inductance_it_is_equation_16_2():
    p = constants(micro_actuator_no_inductance)
    channel = gb.export.extract_channel(gb.linearise(micro_actuator_no_inductance), "x", "u")
    np.testing.assert_allclose(channel.denominator, [1, (p.B + p.Kf * p.Kv / p.Ra) / p.M, p.K / p.M], rtol=1e-10)
    np.testing.assert_allclose(channel.numerator, [p.Kf / p.Ra / p.M], rtol=1e-10)


@pytest.mark.parametrize("model", [pneumatic_pva, pneumatic_cylinder])
def test_the_cylinder_is_equation_10_9(model):
    p = constants(model)
    spring = 2 * p.P_S * p.A_piston**2 / (p.M_piston * p.V_total)
    gain = 2 * p.P_a * p.K2 * p.P_S * p.A_piston / (p.rho_a * p.M_piston * p.V_total)
    found = gb.linearise(model)
    if model is pneumatic_pva:
        np.testing.assert_allclose(found.A, [[0, 1, 0], [0, 0, 1], [0, -spring, -p.f_v]], rtol=1e-10)
        np.testing.assert_allclose(found.B, [[0], [0], [gain]], rtol=1e-10)
    channel = gb.export.extract_channel(found, "s", "u")
    np.testing.assert_allclose(channel.denominator, [1, p.f_v, spring, 0], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(channel.numerator, [gain], rtol=1e-10)
    assert channel.integrators == 1
    assert channel.gain == pytest.approx(p.P_a * p.K2 / (p.rho_a * p.A_piston), rel=1e-10)
    assert np.isnan(channel.bandwidth)


def test_zeros_gain_and_bandwidth_are_those_of_python_control():
    system = gb.linearise(micro_actuator)
    for output in ("x", "i"):
        channel, theirs = gb.export.extract_channel(system, output, "u"), gb.export.to_state_space(system)[output, "u"]
        assert channel.gain == pytest.approx(control.dcgain(theirs), rel=1e-12)
        at_half = abs(theirs(1j * channel.bandwidth))
        assert at_half == pytest.approx(abs(channel.gain) / np.sqrt(2), rel=1e-9)
        np.testing.assert_allclose(np.sort_complex(channel.zeros), np.sort_complex(theirs.zeros()), rtol=1e-9)
        w = np.geomspace(1, 1e5, 30)
        np.testing.assert_allclose(channel.response(w), theirs(1j * w), rtol=1e-9)
        np.testing.assert_allclose(system.frequency_response(w)[:, "xi".index(output), 0], theirs(1j * w), rtol=1e-9)


def test_what_no_input_reaches_is_taken_out_and_the_rest_keeps_its_names():
    whole = gb.linearise(pneumatic_cylinder)
    small = gb.export.minimal_realisation(whole)
    assert small.state_names == ("s", "v", "p_a")  # p_a + p_b never changes
    w = np.geomspace(0.1, 1e3, 40)
    np.testing.assert_allclose(small.frequency_response(w), whole.frequency_response(w), rtol=1e-10)
    assert small.findings[-1].code == Code.STATES_REMOVED and small.findings[-1].values["unreached"] == ["p_b"]
    assert gb.export.minimal_realisation(gb.linearise(micro_actuator)).state_names == ("x", "v", "i")


def test_what_no_output_shows_is_taken_out():
    warm = (micro_actuator + gb.effect("winding_heating")).start(Rth=0.1)
    assert gb.export.minimal_realisation(gb.linearise(warm)).state_names == (
        "x",
        "v",
        "i",
    )  # heat goes with the square of the current
    leaky = (pneumatic_cylinder + gb.effect("chamber_leakage")).start(kl=1.0)
    # The sum of the pressures is neither reached nor seen.
    only_difference = replace(leaky, outputs=[gb.Output("s", "m")], rules=(), name="position_only")
    small = gb.export.minimal_realisation(gb.linearise(only_difference))
    w = np.geomspace(0.1, 1e3, 40)
    np.testing.assert_allclose(
        small.frequency_response(w), gb.linearise(only_difference).frequency_response(w), rtol=1e-10
    )
    assert len(small.A) == 3


@pytest.mark.parametrize("method", ["zoh", "tustin"])
@pytest.mark.parametrize("model", [micro_actuator, pneumatic_cylinder])
def test_sampling_is_that_of_scipy(model, method):
    dt = 2.5e-4 if model is micro_actuator else 0.01
    c, d = gb.linearise(model), gb.linearise(model, dt=dt, method=method)
    theirs = cont2discrete((c.A, c.B, c.C, c.D), dt, "zoh" if method == "zoh" else "bilinear")
    for ours, matrix in zip((d.A, d.B, d.C, d.D), theirs, strict=False):
        np.testing.assert_allclose(ours, matrix, rtol=1e-9, atol=1e-13 * np.abs(matrix).max())


@pytest.mark.parametrize("method", ["zoh", "tustin"])
@pytest.mark.parametrize("draw", range(4))
def test_sampling_changes_neither_gain_nor_integrators(draw, method):
    """Pressures keep a finite gain and the position integrates, whatever the last digits of the constants."""
    rng = np.random.default_rng(draw)
    model = pneumatic_cylinder.start(
        f_v=46 * (1 + 0.01 * rng.standard_normal()), K2=6.5e-10 * (1 + 0.01 * rng.standard_normal())
    )
    continuous, sampled = gb.linearise(model), gb.linearise(model, dt=0.01, method=method, delay=0.015)
    for output, integrators in (("s", 1), ("p_a", 0), ("p_b", 0)):
        one, other = gb.export.extract_channel(continuous, output), gb.export.extract_channel(sampled, output)
        assert one.integrators == other.integrators == integrators
        assert other.gain == pytest.approx(one.gain, rel=1e-7)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, 2.7])
def test_a_delay_of_any_length_is_exact_for_a_held_input(share):
    dt, rng = 2.5e-4, np.random.default_rng(1)
    c, d = gb.linearise(micro_actuator), gb.linearise(micro_actuator, dt=dt, delay=share * dt)
    u = rng.standard_normal(40)
    x, xd, rows, ours = np.zeros(3), np.zeros(len(d.A)), [], []
    # Between samples the delayed input changes once: two exact pieces.
    whole, part = int(share), share - int(share)

    def piece(x, value, seconds):
        block = np.zeros((4, 4))
        block[:3, :3], block[:3, 3:] = c.A * seconds, c.B * seconds
        e = expm(block)
        return e[:3, :3] @ x + e[:3, 3] * value

    for k in range(len(u)):
        rows.append(c.C @ x)
        ours.append(d.C @ xd + d.D @ u[k : k + 1])
        xd = d.A @ xd + d.B @ u[k : k + 1]
        late = [u[k - n] if k >= n else 0.0 for n in (whole, whole + 1)]
        x = piece(piece(x, late[1], part * dt), late[0], (1 - part) * dt)
    size = np.abs(rows).max(axis=0)
    np.testing.assert_allclose(ours / size, rows / size, atol=1e-12)
    assert len(d.A) == 3 + int(np.ceil(share))


def test_the_models_own_delay_counts_and_a_continuous_system_approximates_it():
    late = (micro_actuator + gb.effect("transport_delay")).start(delay=4e-4)
    model = gb.linearise(late, delay=1e-4)
    np.testing.assert_allclose(model.delay, [5e-4])
    w = np.geomspace(10, 3000, 20)
    plain = gb.linearise(micro_actuator).frequency_response(w)
    np.testing.assert_allclose(model.frequency_response(w), plain * np.exp(-1j * w * 5e-4)[:, None, None], rtol=1e-9)
    np.testing.assert_allclose(
        gb.export.to_state_space(model).frequency_response(w).complex[0, 0],
        model.frequency_response(w)[:, 0, 0],
        rtol=1e-3,
    )
    sampled = gb.linearise(late, dt=2.5e-4)
    assert sampled.state_names == ("x", "v", "i", "u_1", "u_2")


FED_THROUGH = Model(
    "fed_through",
    [State("a", "1")],
    [Input("w", "1")],
    [Output("a", "1"), Output("y", "1", lambda x, u, p: x.a + p.g * u.w)],
    [Parameter("r", "1/s", 5.0), Parameter("g", "1", 0.5)],
    lambda x, u, p: [Balance("rate", "1/s", 1, "a", rate=p.r * (u.w - x.a))],
)


@pytest.mark.parametrize("order", range(1, 11))
@pytest.mark.parametrize("output", [0, 1], ids=["strictly proper", "fed through"])
def test_a_delay_of_every_order_is_right_from_rest_to_infinity(order, output):
    """Against exp(-j w T): an odd order ends at -1, an even one at +1."""
    seconds = 0.02
    model = gb.linearise(FED_THROUGH, delay=seconds)
    # Well inside the band of every order: within a degree.
    w = np.array([0.0, *np.geomspace(0.01, order / 2, 12)]) / seconds
    lag = 1 / (1j * w / 5.0 + 1)
    exact = (lag, lag + 0.5)[output] * np.exp(-1j * w * seconds)
    for system in (gb.export.to_state_space(model, order), gb.export.to_transfer_function(model, order)):
        found = system.frequency_response(w).complex[output, 0]
        np.testing.assert_allclose(found / exact, 1, atol=np.deg2rad(1))
    d = gb.export.to_state_space(model, order).D[output, 0]
    assert d == pytest.approx((-1) ** order * 0.5 * output)


@pytest.mark.parametrize("order", range(1, 11))
def test_an_approximated_delay_says_up_to_where_it_holds(order):
    """At the limit the phase is wrong by a degree, below it by less: P(s) = N(-s) / N(s), so that its phase is twice that of N(-jw)."""
    seconds = 0.02
    approximated = approximate_delays(gb.linearise(FED_THROUGH, delay=seconds), order)
    (limit,) = (f.values["limit"] for f in approximated.findings if f.code is Code.DELAY_APPROXIMATED)
    # N(s) = sum_k (2n - k)! / (k! (n - k)!) s^k (G. H. Golub, C. F. Van Loan, Matrix computations, 9.3).
    n, f = order, math.factorial
    below = np.linspace(0, limit * seconds, 400)
    value = sum(f(2 * n - k) / (f(k) * f(n - k)) * (-1j * below) ** k for k in range(n + 1))
    wrong = np.abs(2 * np.unwrap(np.angle(value)) + below)
    assert wrong.max() == pytest.approx(np.deg2rad(1), rel=0.05) and wrong.argmax() == len(below) - 1


def test_an_equilibrium_is_found_from_the_input_or_from_a_state():
    p = constants(micro_actuator)
    by_input = gb.export.find_operating_point(micro_actuator, {"u": 1.0})
    assert by_input.equilibrium
    assert by_input.states["x"] == pytest.approx(p.Kf / p.Ra / p.K, rel=1e-12)
    by_state = gb.export.find_operating_point(micro_actuator, {"x": 1e-5})
    assert by_state.inputs["u"] == pytest.approx(p.K * 1e-5 * p.Ra / p.Kf, rel=1e-12)


def test_a_nonlinear_equilibrium_is_where_the_spring_carries_the_force():
    hard = (micro_actuator + gb.effect("cubic_stiffness")).start(K3=1e12)
    found = gb.linearise(hard, {"u": 2.0})
    p, x = constants(hard), found.x0[0]
    assert p.K * x + p.K3 * x**3 == pytest.approx(p.Kf * 2.0 / p.Ra, rel=1e-12)
    assert found.A[1, 0] == pytest.approx(-(p.K + 3 * p.K3 * x**2) / p.M, rel=1e-12)
    # About it the model holds for small deviations; that of a linear plant for all.
    plain = gb.linearise(micro_actuator)
    assert [m.is_exact for m in (found, gb.export.sample(plain, 1e-4), plain)] == [False, True, True]
    assert ["small" in linear_question(m) for m in (found, plain)] == [True, False]


def test_an_integrating_state_stays_where_it_starts_or_moves_steadily():
    assert gb.export.find_operating_point(pneumatic_cylinder, {"s": 0.1}).states["s"] == 0.1
    steady = gb.export.find_operating_point(pneumatic_cylinder, {"u": 1.0})
    p = constants(pneumatic_cylinder)
    assert steady.moving == ("s",)
    assert steady.states["v"] == pytest.approx(p.P_a * p.K2 / (p.rho_a * p.A_piston), rel=1e-10)
    (finding,) = steady.findings
    assert (finding.code, finding.subject) == (Code.STEADY_MOTION, "s")
    assert finding.values["speed"] == pytest.approx(0.04727, rel=1e-3) and finding.values["others_rest"]


@pytest.mark.parametrize("start", [1e-5, 1.0, 1e5])
def test_a_motion_against_a_spring_lasts_a_moment_in_whatever_unit_it_is_counted(start):
    counted = Model(
        "counted",
        [State("x", "1", start, role="displacement"), State("v", "1/s", role="velocity")],
        [Input("F", "N")],
        [Output("x", "1")],
        [Parameter("m", "N*s^2", 2.0), Parameter("k", "N", 3.0), Parameter("c", "N*s", 0.5)],
        lambda x, u, p: [
            Balance("way", "1/s", 1, "x", v=x.v),
            Balance("force", "N", p.m, "v", drive=u.F, spring=-p.k * x.x, drag=-p.c * x.v),
        ],
    )
    point = gb.export.find_operating_point(counted, {"v": 10.0})
    assert point.inputs["F"] == pytest.approx(3.0 * start + 5.0, rel=1e-12)
    (finding,) = point.findings
    assert finding.code == Code.STEADY_MOTION and not finding.values["others_rest"]


@pytest.fixture(scope="module")
def steady():
    """The whole chain moving at 0.1 m/s: the valve has no slope at u = 0, where the search begins."""
    return gb.linearise(pneumatic_full, {"v": 0.1})


@pytest.mark.rest
def test_a_valve_that_is_shut_at_first_is_opened_until_the_speed_is_there(steady):
    at = dict(zip(steady.state_names, range(4), strict=True))
    assert steady.x0[at["v"]] == 0.1
    assert abs(steady.rates[at["p_a"]]) < 1e-6 and steady.u0[0] > 1


def test_a_point_that_is_no_equilibrium_says_by_how_much():
    found = gb.linearise(micro_actuator, {"x": 1e-5, "v": 0, "i": 0, "u": 0})
    assert found.findings[0].code == Code.NO_EQUILIBRIUM
    (residual,) = found.findings[0].values["imbalance"]
    assert (residual["balance"], residual["unit"]) == ("force", "N")
    assert residual["value"] == pytest.approx(-0.05896, rel=1e-3)
    assert found.rates[1] == pytest.approx(-constants(micro_actuator).K * 1e-5 / 0.01)
    with pytest.raises(
        gb.errors.ModelError, match=r"no equilibrium with x = 1e-05 m, u = 0 V, out of balance: force by"
    ):
        gb.linearise(micro_actuator, {"x": 1e-5, "u": 0})


def test_bad_names_and_numbers_come_in_one_message():
    with pytest.raises(
        gb.errors.ModelError, match=r"'xx'; did you mean 'x'.*'M' is a parameter.*u = nan is not a finite number"
    ):
        gb.linearise(micro_actuator, {"xx": 0, "M": 1, "u": np.nan})
    with pytest.raises(gb.errors.ModelError, match=r"unknown method 'zho' of sampling; did you mean 'zoh'"):
        gb.linearise(micro_actuator, dt=1e-3, method="zho")
    with pytest.raises(gb.errors.ModelError, match="sampling time -1 s"):
        gb.linearise(micro_actuator, dt=-1)
    with pytest.raises(gb.errors.ModelError, match="no output 'y'"):
        gb.export.extract_channel(gb.linearise(micro_actuator), "y", "u")
    with pytest.raises(gb.errors.ModelError, match="cannot be exported; give a fit"):
        gb.linearise("fit.json")


def test_a_state_at_zero_has_the_size_that_it_was_declared_with():
    room = Model(
        "room",
        [State("T", "K", 300.0), State("x", "m")],
        [Input("P", "K/s")],
        [Output("T", "K")],
        [Parameter("k", "1/s", 0.1), Parameter("g", "m/(K*s)", 1.0)],
        lambda x, u, p: [
            Balance("heat", "K/s", 1, "T", heater=u.P, loss=-p.k * x.T),
            Balance("way", "m/s", 1, "x", bend=p.g * x.T),
        ],
    )
    sizes = [ModelFunctions(room).sizes(np.array(z), np.array([0.1, 1.0])) for z in ([0, 0, 0], [-400.0, 2.0, 3.0])]
    assert sizes[0].tolist() == [300.0, SMALLEST_TYPICAL_SIZE, SMALLEST_TYPICAL_SIZE]
    assert sizes[1].tolist() == [400.0, 2.0, 3.0]


def test_dry_friction_at_rest_is_left_out_and_named():
    stuck, free = gb.linearise(COULOMB), gb.linearise(micro_actuator)
    np.testing.assert_array_equal(stuck.A, free.A)
    assert (stuck.findings[0].code, stuck.findings[0].subject) == (Code.FRICTION_LEFT_OUT, "coulomb_friction")
    assert stuck.findings[0].values["level"] == pytest.approx(0.1) and stuck.findings[0].values["held"] == 0
    held = gb.linearise(COULOMB, {"x": 1e-5, "u": 0})
    assert held.findings[0].values["held"] == pytest.approx(0.05896, rel=1e-3)
    assert held.rates[1] == 0


def test_friction_whose_level_has_a_slope_at_rest_has_the_mean_of_both_ways():
    """The level rises by ``c |v|``: either way the slope of the force is -c, and the jump itself has none."""
    rising = gb.Effect(
        "rising_friction",
        "force",
        [Parameter("Fc", "N", 0.1), Parameter("c", "N*s/m", 0.7)],
        dry=lambda x, u, p: gb.DryFriction(p.Fc + p.c * ca.fabs(x.v), p.Fc + p.c * ca.fabs(x.v)),
        source="a test",
    )
    p = constants(micro_actuator)
    assert gb.linearise(micro_actuator + rising).A[1, 1] == pytest.approx(-(p.B + 0.7) / p.M, rel=1e-12)


def test_sliding_friction_has_the_slope_of_its_level():
    falling = (micro_actuator + gb.effect("stribeck_friction")).start(Fc=0.1, Fs=0.2, vs=0.01)
    p = constants(falling)
    slope = 0.1 * np.exp(-1) * 2 / p.vs  # -d(level)/dv at v = vs
    found = gb.linearise(falling, {"v": 0.01})
    assert found.A[1, 1] == pytest.approx((-p.B + slope) / p.M, rel=1e-12)
    assert [f.code for f in found.findings] == [Code.STEADY_MOTION]  # and nothing about friction


@pytest.mark.parametrize(
    ("u", "gain", "codes", "side"),
    [
        (0.5, 2000.0, [Code.KINK], "above"),
        (-0.5, 2000.0, [Code.KINK], "below"),
        (0.2, 0.0, [Code.INPUT_WITHOUT_EFFECT], None),
        (1.0, 2000.0, [], None),
    ],
)
def test_the_dead_zone_and_its_edges(u, gain, codes, side):
    found = gb.linearise(DEAD, {"u": u})
    np.testing.assert_allclose(found.B[2, 0], gain)
    assert [f.code for f in found.findings] == codes
    assert all(f.values["effects"] == ["input_dead_zone"] for f in found.findings)
    assert all(f.values.get("side") == side for f in found.findings)


def test_the_edge_of_a_saturation_takes_the_side_that_still_moves():
    clipped = (micro_actuator + gb.effect("input_saturation")).start(u_max=2.0)
    found = gb.linearise(clipped, {"u": 2.0})
    np.testing.assert_allclose(found.B[2, 0], 2000.0)
    (finding,) = found.findings
    assert (finding.values["effects"], finding.values["side"]) == (["input_saturation"], "below")


def test_drag_has_no_kink_where_its_slopes_agree():
    drag = (micro_actuator + gb.effect("quadratic_damping")).start(B2=3.0)
    assert gb.linearise(drag).findings == ()
    moving = gb.linearise(drag, {"v": 0.1})
    assert moving.A[1, 1] == pytest.approx(-(0.2691 + 2 * 3.0 * 0.1) / 0.01, rel=1e-12)


def test_play_is_taken_as_closed():
    loose = gb.linearise((micro_actuator + gb.effect("backlash")).start(gap=1e-6))
    tight = gb.linearise(micro_actuator)
    np.testing.assert_array_equal(loose.A, tight.A)
    np.testing.assert_array_equal(loose.C, tight.C)
    assert (loose.findings[0].code, loose.findings[0].subject) == (Code.PLAY_CLOSED, "backlash")


def test_a_slope_that_is_not_finite_is_refused():
    with pytest.raises(gb.errors.ModelError, match="not finite; an equation has no finite slope"):
        gb.linearise(
            gb.Model(
                "orifice",
                [gb.State("h", "m")],
                [gb.Input("q", "m/s")],
                [gb.Output("h", "m")],
                [gb.Parameter("c", "m**0.5/s", 1.0)],
                lambda x, u, p: [gb.Balance("level", "m/s", 1, "h", inflow=u.q, outflow=-p.c * x.h**0.5)],
            ),
            {"h": 0, "q": 0},
        )


@pytest.mark.parametrize(("dt", "samples"), [(2.5e-4, None), (2e-3, 4.09), (1e-2, 0.82)])
def test_a_sampling_time_too_long_for_the_dynamics_is_reported(dt, samples):
    findings = gb.linearise(micro_actuator, dt=dt).findings
    assert [f.code for f in findings] == ([Code.MODE_UNDERSAMPLED] if samples else [])
    assert all(f.values["samples"] == pytest.approx(samples, rel=0.01) for f in findings)


def test_tustin_on_a_fast_coil_is_reported():
    findings = gb.linearise(micro_actuator, dt=2.5e-4, method="tustin").findings
    assert [f.code for f in findings] == [Code.TUSTIN_RINGS]


def test_a_linear_model_converts_as_it_is():
    linear = gb.linearise(micro_actuator)
    np.testing.assert_array_equal(gb.export.to_control(linear).A, linear.A)
    with pytest.raises(gb.errors.ModelError, match="dt cannot be given for a linear model"):
        gb.export.to_control(linear, dt=1e-3)


def test_to_control_hands_over_names_and_warns():
    system = gb.export.to_control(micro_actuator)
    assert (system.state_labels, system.input_labels, system.output_labels) == (["x", "v", "i"], ["u"], ["x", "i"])
    assert system.linearisation.output_units == ("m", "A")
    with pytest.warns(UserWarning, match="coulomb_friction cannot be linearised"):
        gb.export.to_control(COULOMB)
    ratio = gb.export.to_control(micro_actuator, form="transfer_function", dt=2.5e-4)
    w = np.geomspace(10, 1e4, 20)
    theirs = gb.export.to_control(micro_actuator, dt=2.5e-4).frequency_response(w).complex
    np.testing.assert_allclose(ratio.frequency_response(w).complex, theirs, rtol=1e-6)
    with pytest.raises(gb.errors.ModelError, match="unknown form 'tf'"):
        gb.export.to_control(micro_actuator, form="tf")
    with pytest.raises(gb.errors.ModelError, match="at, delay cannot be given with form='nonlinear'"):
        gb.export.to_control(micro_actuator, {"u": 1}, delay=1e-3, form="nonlinear")


@pytest.mark.rest
def test_the_continuous_nonlinear_system_has_the_linear_one_as_its_slope(steady):
    system = gb.export.to_control(pneumatic_full, form="nonlinear")
    theirs = system.linearize(steady.x0, steady.u0)
    np.testing.assert_allclose(theirs.A, steady.A, rtol=1e-3, atol=1e-3)
    with pytest.raises(
        gb.errors.ModelError, match=r"not an ordinary differential equation: coulomb_friction \(it sticks"
    ):
        gb.export.to_nonlinear_system(COULOMB)


def test_the_sampled_nonlinear_system_runs_as_simulate_does():
    full = micro_actuator + gb.effect("stribeck_friction") + gb.effect("transport_delay") + gb.effect("backlash")
    full = full.start(Fc=0.05, Fs=0.08, vs=0.01, delay=4e-4, gap=1e-6)
    dt = 2.5e-4
    t = np.arange(200) * dt
    u = 2 * np.sin(60 * t) + np.sign(np.sin(300 * t))
    system = gb.export.to_nonlinear_system(full, dt, substeps=8)
    run = control.input_output_response(system, t, u, np.zeros(system.nstates))
    ours = gb.simulate(full, {"time": t, "u": u}, substeps=8)
    np.testing.assert_allclose(run.outputs[0], ours.outputs["x"], rtol=1e-12, atol=1e-17)
    assert "delay" not in system.params and system.params["Fc"] == 0.05


@pytest.mark.rest
def test_two_masses_on_one_shaft_turn_steadily():
    motor = gb.Model(
        "motor",
        [gb.State("phi", "rad", role="displacement"), gb.State("w", "rad/s", role="velocity")],
        [gb.Input("M", "N*m", role="torque")],
        [gb.Output("w", "rad/s")],
        [gb.Parameter("J", "kg*m^2", 1e-3, role="inertia"), gb.Parameter("b", "N*m*s/rad", 2e-3)],
        lambda x, u, p: [
            gb.Balance("angle", "rad/s", 1, "phi", w=x.w),
            gb.Balance("torque", "N*m", p.J, "w", drive=u.M, damping=-p.b * x.w),
        ],
    )
    two = (motor + gb.effect("second_mode")).start(m2=3e-4, k2=2.0, c2=1e-3)
    point = find_operating_point(two, {"w": 100.0})
    assert point.inputs["M"] == pytest.approx(2e-3 * 100) and point.states["z2"] == pytest.approx(100)
    assert set(point.moving) == {"phi", "z1"} and all(f.values["others_rest"] for f in point.findings)
    # The equations are linear: their matrices are the same everywhere.
    assert np.allclose(gb.linearise(two, {"w": 100.0}).A, gb.linearise(two).A)
    # Of a mass on a spring to the ground nothing turns steadily.
    with pytest.raises(ModelError, match="no equilibrium with z2 = 100"):
        gb.linearise(micro_actuator + gb.effect("second_mode"), {"z2": 100.0})


FILLED = Model(
    "filled",
    [State("x", "m")],
    [Input("d", "1"), Input("s", "m")],
    [Output("x", "m")],
    [Parameter("a", "1/s", 10.0, (0.1, 100.0)), Parameter("c", "1/s", 3.0, (0.1, 100.0))],
    lambda x, u, p: [Balance("level", "m/s", 1, "x", filling=p.a * u.d * (u.s - x.x), leak=-p.c * x.x)],
)


def test_inputs_that_act_by_products_are_linearised_about_their_means_in_the_records():
    rng = np.random.default_rng(1)
    duty, supply = np.repeat(rng.integers(1, 10, 30) / 10, 10), 2 + 0.1 * np.sin(np.arange(300))
    record = simulate_twin(FILLED, {"d": duty, "s": supply}, 0.02, {"x": 1e-3}, 1)
    fitted = gb.fit(FILLED, record, noise={"x": 1e-3})
    linear = gb.linearise(fitted)
    a, c, d, s = fitted.parameters["a"].value, fitted.parameters["c"].value, duty.mean(), supply.mean()
    # At rest a d (s - x) = c x.
    level = a * d * s / (a * d + c)
    assert linear.u0 == pytest.approx([d, s]) and linear.x0 == pytest.approx([level])
    assert linear.A[0, 0] == pytest.approx(-(a * d + c)) and linear.B[0] == pytest.approx([a * (s - level), a * d])
    assert find(linear.findings, Code.ABOUT_THE_MEANS).values["inputs"] == {"d": d, "s": s}
    family = gb.export.sample_family(fitted, number=2)
    assert family.nominal.x0 == pytest.approx([level])
    asked = gb.linearise(fitted, {"d": 0.5, "s": 1.0})
    assert asked.u0.tolist() == [0.5, 1.0] and find(asked.findings, Code.ABOUT_THE_MEANS) is None
    # A model has no records: its inputs are zero.
    assert gb.linearise(FILLED).u0.tolist() == [0.0, 0.0]


def orifice(up, down):
    """Flow of a gas by the square root of the fall of pressure, a little rounded where there is none."""
    return up * ca.sqrt(ca.fmax(1e-12, 1 - (down / up) ** 2))


def chamber_balances(x, u, p):
    # Above 5 V the chamber fills from the supply of 4 bar, below it empties to the surroundings; at 5 V it holds any pressure.
    s = u.valve - 5 * p.one
    flow = p.c * ca.if_else(s > 0, s * orifice(4e5 * p.bar, x.p), s * orifice(x.p, 1e5 * p.bar))
    return [
        Balance("pressure", "Pa/s", 1, "p", valve=flow),
        Balance("angle", "1/s", 1, "th", pressure=p.k * (x.p - 1e5 * p.bar), spring=-p.r * x.th),
    ]


CHAMBER = Model(
    "chamber",
    [State("p", "Pa", 1e5, bounds=(1.0, 1e7)), State("th", "1")],
    [Input("valve", "V")],
    [Output("p", "Pa"), Output("th", "1")],
    [
        Parameter("c", "1/(s*V)", 1.0, (0.01, 100.0)),
        Parameter("k", "1/(s*Pa)", 2e-5, (1e-7, 1e-3)),
        Parameter("r", "1/s", 5.0, (0.1, 100.0)),
        Parameter("one", "V", 1.0, fixed=True),
        Parameter("bar", "Pa", 1.0, fixed=True),
    ],
    chamber_balances,
)


@pytest.fixture(scope="module")
def filled_and_emptied():
    """A fit of the chamber to a record that begins at rest at 5 V, whose mean input holds no pressure."""
    valve = np.repeat([5.0, 7.0, 5.0, 4.0, 5.0, 6.5, 5.0, 4.5], 40)
    record = simulate_twin(CHAMBER, {"valve": valve}, 0.01, {"p": 100.0, "th": 1e-3}, 1)
    return gb.fit(CHAMBER, record, noise={"p": 100.0, "th": 1e-3})


def test_a_plant_that_rests_only_where_its_record_begins_is_linearised_there(filled_and_emptied):
    fitted = filled_and_emptied
    linear = gb.linearise(fitted)
    assert linear.u0.tolist() == [5.0] and linear.x0 == pytest.approx([1e5, 0.0])
    assert find(linear.findings, Code.ABOUT_THE_BEGINNING).values["inputs"] == {"valve": 5.0}
    # Of one more volt the pressure rises by c q(4 bar, 1 bar), of the pressure the angle by k.
    c, k, r = (fitted.parameters[name].value for name in ("c", "k", "r"))
    assert linear.B[:, 0] == pytest.approx([c * 4e5 * np.sqrt(1 - 1 / 16), 0.0])
    np.testing.assert_allclose(linear.A, [[0.0, 0.0], [k, -r]], rtol=1e-9)


def test_a_point_out_of_bounds_or_without_a_finite_slope_is_refused_with_one_that_works(filled_and_emptied):
    with pytest.raises(ModelError, match=r"p = -5 lies outside the bounds of the state, 1 to 1e\+07"):
        gb.linearise(filled_and_emptied, {"p": -5.0, "th": 0.0, "valve": 5.0})
    # sqrt(th) has no slope at zero that a number holds.
    steep = Model(
        "steep",
        [State("th", "1", 1e-200)],
        [Input("valve", "1")],
        [Output("th", "1")],
        [Parameter("a", "1/s", 1.0, (0.1, 10.0))],
        lambda x, u, p: [Balance("angle", "1/s", 1, "th", drive=p.a * u.valve / (x.th * x.th), back=-p.a * x.th)],
    )
    with pytest.raises(
        ModelError, match=r"steep.* give a point near it: at=\{NAME: VALUE, \.\.\.\} \(shell: --at NAME=VALUE\)"
    ):
        gb.linearise(steep, {"valve": 1.0, "th": 1e-200})
