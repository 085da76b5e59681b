"""The pneumatic chain and its parts: limits, conservation laws, blocked and vented pistons, refusals."""

import re

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from greybox import Balance, Effect, State
from greybox.base.errors import DataError, ModelError
from greybox.model.effects.catalogue import effect
from greybox.model.validation import Rule
from greybox.simulation.simulate import simulate
from models.pneumatic_chambers import gas_chambers, linear_chambers
from models.pneumatic_cylinder import pneumatic_cylinder
from models.pneumatic_full import pneumatic_full
from models.pneumatic_parts import pneumatic_chain
from models.pneumatic_pistons import viscous_piston
from models.pneumatic_pva import pneumatic_pva
from models.pneumatic_valves import LAMINAR, iso6358_valve, linear_valve

VALVES = {
    "linear law": linear_valve(),
    "ISO 6358": iso6358_valve(),
    "power": iso6358_valve("power"),
    "dead zone": iso6358_valve("linear", dead_zone=True),
    "lag": iso6358_valve("power", dead_zone=True, lag=True, unequal=True),
}
CHAMBERS = {
    "linear": linear_chambers(),
    "fixed": gas_chambers("equal", moving=False),
    "equal": gas_chambers("equal", leakage=True),
    "rod": gas_chambers("rod", polytropic=True, leakage=True),
}
PISTONS = {"plain": viscous_piston(), "stopped": viscous_piston(end_stops=True)}


def chain(valve, chambers, piston=PISTONS["plain"]):
    return pneumatic_chain("chain", valve=valve, chambers=chambers, piston=piston)


def rates(model, x, u, **values):
    """Rates by state at the given states and voltage, the others as declared."""
    p = model.values | values
    start = dict(
        zip(model.system.state_names, np.array(model.system.start_function(list(p.values()))[0]).ravel(), strict=True)
    )
    full = np.array(model.system.rhs_function(list((start | x).values()), [u], list(p.values()))).ravel()
    return dict(zip(model.system.state_names, full, strict=True))


def iso(C, upstream, downstream, b, rho):
    """Equation 10.1 with its bracket put right, for downstream below upstream."""
    r = downstream / upstream
    return C * rho * upstream * (1.0 if r <= b else np.sqrt(1 - ((r - b) / (1 - b)) ** 2))


def held_piston(model):
    """The chain with its piston clamped, or moved on at the speed it starts with: only the chambers live."""

    def balances(x, u, p):
        kept = [b for b in model.balances(x, u, p) if b.name not in ("position", "force")]
        return [
            Balance("position", "m/s", 1, "s", velocity=x.v),
            Balance("force", "N", p.M_piston, "v", none=0 * p.M_piston * p.f_v * x.v),
            *kept,
        ]

    return type(model)("held", model.states, model.inputs, model.outputs, model.parameters, balances)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("piston", PISTONS)
@pytest.mark.parametrize("chambers", CHAMBERS)
@pytest.mark.parametrize("valve", VALVES)
def test_any_valve_goes_with_any_chambers_and_any_piston(valve, chambers, piston):
    model = chain(VALVES[valve], CHAMBERS[chambers], PISTONS[piston])
    found = rates(model, {"s": 0.05, "v": 0.1}, 2.0)
    assert np.isfinite(list(found.values())).all()
    assert found["p_a"] > -found["p_b"] - 1e9
    for q in model.parameters:
        assert q.source.strip()
        assert q.description.strip()
        assert q.bounds[0] <= q.value < q.bounds[1]
    slopes = ca.Function(
        "j",
        [model.system.x, model.system.u, model.system.p],
        [ca.jacobian(model.system.rhs, ca.vertcat(model.system.x, model.system.p))],
    )
    at_zero = np.array(
        slopes(model.system.start_function(list(model.values.values()))[0], [0.0], list(model.values.values()))
    )
    assert np.isfinite(at_zero).all()


def test_the_plain_chain_is_the_linear_model():
    assert pneumatic_cylinder.system.linear
    assert [q.name for q in pneumatic_cylinder.parameters] == [
        "K2",
        "f_v",
        "M_piston",
        "A_piston",
        "V_total",
        "P_S",
        "P_a",
        "rho_a",
    ]
    assert pneumatic_cylinder.system.state_names == ("s", "v", "p_a", "p_b")
    assert not chain(iso6358_valve(), linear_chambers()).system.linear


def test_flow_is_equation_10_1_where_it_is_not_laminar():
    model = chain(iso6358_valve(), gas_chambers("equal", moving=False))
    c = model.values
    per_flow = c["P_a"] / c["rho_a"] / (c["V_total"] / 2)
    for u, p_a, p_b in ((2.0, 3e5, 6e5), (0.5, 7.5e5, 1.5e5), (3.0, 1.2e5, 2.2e5)):
        found = rates(model, {"p_a": p_a, "p_b": p_b}, u)
        assert found["p_a"] == pytest.approx(per_flow * iso(c["C"] * u, c["P_S"], p_a, c["b"], c["rho_a"]), rel=1e-12)
        assert found["p_b"] == pytest.approx(-per_flow * iso(c["C"] * u, p_b, c["P_a"], c["b"], c["rho_a"]), rel=1e-12)
    assert rates(model, {"p_a": 8e5}, 1.0)["p_a"] == 0
    back = rates(model, {"p_a": 1.1e6}, 1.0)["p_a"]  # back into the supply, which is downstream then
    assert back == pytest.approx(-per_flow * iso(c["C"], 1.1e6, c["P_S"], c["b"], c["rho_a"]), rel=1e-12)
    choked = rates(model, {"p_b": 0.2 * c["P_a"]}, 1.0)["p_b"]  # air drawn in from outside
    assert choked == pytest.approx(per_flow * c["C"] * c["rho_a"] * c["P_a"], rel=1e-12)
    edge = np.sqrt(1 - LAMINAR) * (1 - c["b"]) + c["b"]
    below, above = (rates(model, {"p_a": (edge + d) * c["P_S"]}, 1.0)["p_a"] for d in (-1e-9, 1e-9))
    assert below == pytest.approx(above, rel=1e-5)


def test_opening_follows_a_power_beyond_the_dead_zone():
    model = chain(iso6358_valve("power", dead_zone=True), gas_chambers("equal", moving=False))
    choked = {"p_a": 2e5, "p_b": 6e5}
    one = rates(model, choked, 2.0, d=1.0, q=2.0)["p_a"]
    assert rates(model, choked, 3.0, d=1.0, q=2.0)["p_a"] == pytest.approx(4 * one)
    assert rates(model, choked, 0.9, d=1.0, q=2.0)["p_a"] == pytest.approx(0, abs=1e-12 * one)
    assert rates(model, choked, -0.9, d=1.0, q=2.0)["p_b"] == pytest.approx(0, abs=1e-12 * one)


def test_the_spool_follows_the_voltage_with_its_lag():
    model = chain(VALVES["lag"], CHAMBERS["rod"])
    assert rates(model, {"w": 1.0}, 3.0, tau_v=0.01)["w"] == pytest.approx(200.0)
    assert rates(model, {"w": 1.0}, -3.0)["p_a"] == pytest.approx(rates(model, {"w": 1.0}, 3.0)["p_a"])


def small_signal_error(amplitude):
    """Full chain against the linear one that the docstring of `pneumatic_full` says it becomes."""
    full = chain(iso6358_valve(), gas_chambers("equal"))
    c = full.values
    p0 = resting_pressure(c)
    K2 = c["C"] * c["rho_a"] * np.clip(iso(1, p0, c["P_a"], c["b"], 1) / p0, 0, 1)
    linear = pneumatic_cylinder.start(K2=K2, P_S=2 * p0)
    t = np.arange(300) * 0.01
    u = amplitude * np.sin(2 * np.pi * 1.3 * t)
    at = {"p_a": p0, "p_b": p0}
    a = simulate(full, {"time": t, "u": u}, initial=at)
    b = simulate(linear, {"time": t, "u": u}, initial=at)
    worst = [
        np.abs(a.states[n] - b.states[n]).max() / np.abs(b.states[n] - b.states[n][0]).max()
        for n in ("s", "p_a", "p_b")
    ]
    return max(worst)


def resting_pressure(c):
    """Where filling and venting pass the same mass: bisection on equation 10.1."""
    low, high = c["P_a"], c["P_S"]
    for _ in range(80):
        middle = (low + high) / 2
        fills = iso(1, c["P_S"], middle, c["b"], 1) > iso(1, middle, c["P_a"], c["b"], 1)
        low, high = (middle, high) if fills else (low, middle)
    return low


def test_for_small_motions_the_full_chain_becomes_the_linear_one():
    coarse, fine = small_signal_error(0.02), small_signal_error(0.002)
    assert fine < 2e-3
    assert fine < 0.12 * coarse  # in proportion to the amplitude


def test_position_velocity_acceleration_gives_the_same_position():
    t = np.arange(400) * 0.01
    u = 2 * np.sin(2 * np.pi * 0.9 * t) + 1.0 * (t > 2)
    values = {"K2": 9e-10, "f_v": 20.0}
    a = simulate(pneumatic_cylinder.start(**values), {"time": t, "u": u})
    b = simulate(pneumatic_pva.start(**values), {"time": t, "u": u})
    np.testing.assert_allclose(b.outputs["s"], a.outputs["s"], atol=1e-11)
    acceleration = np.gradient(a.states["v"], t)
    assert np.corrcoef(acceleration[2:-2], b.states["a"][2:-2])[0, 1] > 0.98


def metered(model, flows):
    """The chain with states that add up mass flows [kg], exergy flows and work [J]; they act on nothing."""

    def balances(x, u, p):
        a, b = flows(x, u, p)
        rt = p.P_a / p.rho_a
        force = p.A_A * x.p_a - p.A_B * x.p_b - (p.A_A - p.A_B) * p.P_a
        into = a["filling"] + a["venting"], b["filling"] + b["venting"]
        return [
            Balance("mass_a", "kg/s", 1, "m_a", flow=into[0]),
            Balance("mass_b", "kg/s", 1, "m_b", flow=into[1]),
            Balance("supplied", "W", 1, "supplied", flow=rt * (a["filling"] + b["filling"]) * ca.log(p.P_S / p.P_a)),
            Balance(
                "arrived",
                "W",
                1,
                "arrived",
                a=rt * into[0] * ca.log(x.p_a / p.P_a),
                b=rt * into[1] * ca.log(x.p_b / p.P_a),
            ),
            Balance("work", "W", 1, "work", gas=force * x.v),
            Balance("rubbed", "W", 1, "rubbed", viscous=p.M_piston * p.f_v * x.v**2),
        ]

    states = [
        State("m_a", "kg"),
        State("m_b", "kg"),
        *(State(n, "J") for n in ("supplied", "arrived", "work", "rubbed")),
    ]
    return model + Effect("meters", site="force", parameters=[], states=states, balances=balances)


@pytest.fixture(scope="module")
def stroke():
    """Two seconds of the isothermal chain with its rod, moving by decimetres."""
    valve = iso6358_valve()
    model = metered(chain(valve, gas_chambers("rod"), PISTONS["stopped"]), valve.flows)
    t = np.arange(201) * 0.01
    u = 4 * np.sin(2 * np.pi * 0.8 * t) + 1.0
    runs = {
        k: simulate(model, {"time": t, "u": u}, initial={"s": -0.1}, method="rk4", substeps=k).states
        for k in (4, 8, 32)
    }
    return model.values, runs


def masses(c, x):
    rt = c["P_a"] / c["rho_a"]
    v_a = c["V_dA"] + c["A_A"] * (c["stroke"] / 2 + x["s"])
    v_b = c["V_dB"] + c["A_B"] * (c["stroke"] / 2 - x["s"])
    return x["p_a"] * v_a / rt, x["p_b"] * v_b / rt, v_a, v_b


def test_mass_in_the_chambers_is_the_mass_that_flowed_in(stroke):
    c, runs = stroke
    error = {}
    for k, x in runs.items():
        m_a, m_b, *_ = masses(c, x)
        error[k] = max(np.abs(m_a - m_a[0] - x["m_a"]).max(), np.abs(m_b - m_b[0] - x["m_b"]).max())
    assert np.ptp(runs[32]["s"]) > 0.1
    assert np.ptp(runs[32]["m_a"]) > 1e-4
    assert error[32] < 1e-7 * np.ptp(runs[32]["m_a"])
    assert error[8] < error[4] / 6


def test_no_energy_from_nowhere(stroke):
    c, runs = stroke
    x = runs[32]
    _, _, v_a, v_b = masses(c, x)
    stored = sum(v * (p * np.log(p / c["P_a"]) - p + c["P_a"]) for v, p in ((v_a, x["p_a"]), (v_b, x["p_b"])))
    kinetic = c["M_piston"] * x["v"] ** 2 / 2
    scale = np.ptp(stored)
    # Isothermal exergy: what is stored changes by what flows over the edges less the work on the piston.
    np.testing.assert_allclose(stored - stored[0] + x["work"], x["arrived"], atol=2e-6 * scale)
    np.testing.assert_allclose(kinetic - kinetic[0] + x["rubbed"], x["work"], atol=2e-6 * scale)
    lost = x["supplied"] - x["arrived"]
    assert (np.diff(lost) > -1e-9 * scale).all()  # throttling only loses
    assert x["work"][-1] <= x["supplied"][-1] + stored[0]


def test_a_closed_chamber_keeps_its_polytropic_constant():
    model = chain(iso6358_valve("power"), gas_chambers("rod", polytropic=True)).start(n=1.3)
    t = np.arange(101) * 0.01
    x = simulate(model, {"time": t, "u": 0 * t}, initial={"v": 0.8}).states
    _, _, v_a, v_b = masses(model.values, x)
    assert np.ptp(x["p_a"]) > 1e4
    np.testing.assert_allclose(x["p_a"] * v_a**1.3, x["p_a"][0] * v_a[0] ** 1.3, rtol=1e-6)
    np.testing.assert_allclose(x["p_b"] * v_b**1.3, x["p_b"][0] * v_b[0] ** 1.3, rtol=1e-6)


def test_a_blocked_piston_fills_at_the_choked_rate_and_ends_at_supply_and_ambient():
    model = held_piston(chain(iso6358_valve(), gas_chambers("rod")))
    c = model.values
    t, u = np.arange(1001) * 0.01, 5.0
    start = {"p_a": c["P_a"], "p_b": 7e5}
    x = simulate(model, {"time": t, "u": u + 0 * t}, initial=start).states
    v_a, v_b = (c["V_dA"] + c["A_A"] * c["stroke"] / 2, c["V_dB"] + c["A_B"] * c["stroke"] / 2)

    choked = x["p_a"] < c["b"] * c["P_S"]
    fill = c["P_a"] * c["C"] * u * c["P_S"] / v_a  # Pa/s
    np.testing.assert_allclose(x["p_a"][choked], c["P_a"] + fill * t[choked], rtol=1e-7)
    choked = x["p_b"] > c["P_a"] / c["b"]
    assert choked.sum() > 10
    np.testing.assert_allclose(x["p_b"][choked], 7e5 * np.exp(-c["P_a"] * c["C"] * u / v_b * t[choked]), rtol=1e-7)

    assert x["p_a"][-1] == pytest.approx(c["P_S"], rel=1e-4)
    assert x["p_b"][-1] == pytest.approx(c["P_a"], rel=1e-4)
    assert (np.diff(x["p_a"]) > -1e-6).all()
    assert (np.diff(x["p_b"]) < 1e-6).all()

    def vented(_, p):  # subsonic venting, on its own
        return -c["P_a"] / c["rho_a"] * iso(c["C"] * u, p[0], c["P_a"], c["b"], c["rho_a"]) / v_b

    upper = x["p_b"] > 1.02 * c["P_a"]
    exact = solve_ivp(vented, (0, t[upper][-1]), [7e5], t_eval=t[upper], rtol=1e-10, atol=1e-3).y[0]
    np.testing.assert_allclose(x["p_b"][upper], exact, rtol=2e-6)


def test_a_piston_pushed_back_presses_its_chamber_beyond_the_supply_and_the_flow_turns_round():
    """Pushed at 0.8 m/s against the supply through a small opening, against the same mass balances solved by scipy."""
    model = held_piston(chain(iso6358_valve(), gas_chambers("rod")))
    c, u, v = model.values, 0.5, -0.8
    t = np.arange(51) * 0.01
    x = simulate(model, {"time": t, "u": u + 0 * t}, initial={"s": 0.2, "v": v, "p_a": 6e5, "p_b": 3e5}).states

    def through(one, other):
        flow = iso(c["C"] * u, max(one, other), min(one, other), c["b"], c["rho_a"])
        return np.sign(one - other) * flow

    def balances(t, y):
        _, _, v_a, v_b = masses(c, {"s": 0.2 + v * t, "p_a": y[0], "p_b": y[1]})
        rt = c["P_a"] / c["rho_a"]
        into = through(c["P_S"], y[0]), -through(y[1], c["P_a"])
        return [(rt * into[0] - y[0] * c["A_A"] * v) / v_a, (rt * into[1] + y[1] * c["A_B"] * v) / v_b]

    exact = solve_ivp(balances, (0, 0.5), [6e5, 3e5], t_eval=t, method="LSODA", rtol=1e-9, atol=1e-3).y
    assert x["p_a"].max() > 1.5 * c["P_S"]  # more than the supply gives, and more of it is pressed back every moment
    assert x["p_b"].min() < 0.9 * c["P_a"]  # the other side draws air in from outside
    # 2e-4: within 0.4 % of equal pressures the model's flow is laminar
    np.testing.assert_allclose(x["p_a"], exact[0], rtol=2e-4)
    np.testing.assert_allclose(x["p_b"], exact[1], rtol=2e-4)


def test_leakage_empties_a_blocked_cylinder_exponentially():
    model = held_piston(chain(iso6358_valve(), gas_chambers("equal", moving=False, leakage=True))).start(
        k_o=1e-9, k_i=2e-9
    )
    c = model.values
    t = np.arange(301) * 0.01
    x = simulate(model, {"time": t, "u": 0 * t}, initial={"p_a": 6e5, "p_b": 3e5}).states
    rt_over_v = c["P_a"] / c["rho_a"] / (c["V_total"] / 2)
    excess, difference = (x["p_a"] + x["p_b"]) / 2 - c["P_a"], x["p_a"] - x["p_b"]
    np.testing.assert_allclose(excess, excess[0] * np.exp(-rt_over_v * 1e-9 * t), rtol=1e-6)
    np.testing.assert_allclose(difference, 3e5 * np.exp(-rt_over_v * 5e-9 * t), rtol=1e-6)


def test_a_reversed_voltage_mirrors_the_chambers_for_equal_areas():
    model = chain(iso6358_valve("power", dead_zone=True, lag=True), gas_chambers("equal", leakage=True)).start(
        k_i=1e-10, d=0.3
    )
    t = np.arange(200) * 0.01
    u = 2 * np.sin(2 * np.pi * t) + 1.0
    a, b = (simulate(model, {"time": t, "u": sign * u}, initial={"s": sign * 0.02}).states for sign in (1, -1))
    np.testing.assert_array_equal(a["p_a"], b["p_b"])
    np.testing.assert_array_equal(a["p_b"], b["p_a"])
    np.testing.assert_array_equal(a["s"], -b["s"])


def test_the_piston_stops_at_its_end_caps_without_being_pulled():
    t = np.arange(300) * 0.01
    x = simulate(pneumatic_full, {"time": t, "u": 4.5 + 0 * t}).states
    c = pneumatic_full.values
    force = c["A_A"] * c["P_S"] - c["A_B"] * c["P_a"] - (c["A_A"] - c["A_B"]) * c["P_a"]
    assert x["s"][-1] == pytest.approx(c["stroke"] / 2 + force / c["k_stop"], rel=2e-3)
    assert abs(x["v"][-1]) < 1e-3
    leaving = rates(pneumatic_full, {"s": 0.252, "v": -5.0}, 0.0)["v"]
    assert leaving == pytest.approx(rates(pneumatic_full, {"s": 0.2499, "v": -5.0}, 0.0)["v"], rel=1e-9)


def test_the_full_chain_rests_where_the_rod_lets_it():
    found = rates(pneumatic_full, {}, 0.0)
    assert found["v"] == pytest.approx(0, abs=1e-9)
    assert [q.name for q in pneumatic_full.free_parameters] == ["C", "q", "f_v"]


def test_frictions_are_effects_on_any_chain():
    for model in (pneumatic_cylinder, pneumatic_full):
        sliding = rates(model, {"v": 0.05}, 0.0)["v"]
        M, g = model.values["M_piston"], 25 + 10 * np.exp(-((0.05 / 0.02) ** 2))
        dry = rates(model + effect("stribeck_friction"), {"v": 0.05}, 0.0, Fc=25, Fs=35, vs=0.02)["v"]
        assert sliding - dry == pytest.approx(g / M, rel=1e-9)
        lugre = model + effect("lugre_friction")
        bent = rates(lugre, {"v": 0.05, "z": g / 3e4}, 0.0, Fc=25, Fs=35, vs=0.02, s0=3e4)
        assert bent["z"] == pytest.approx(0, abs=1e-12)
        assert sliding - bent["v"] == pytest.approx(g / M, rel=1e-9)
        assert rates(lugre, {"v": 0.05, "z": 1e-3}, 0.0)["v"] == sliding
    held = pneumatic_full + effect("coulomb_friction") + effect("constant_load")
    t = np.arange(50) * 0.01
    still = simulate(held.start(Fc=25.0, F0=20.0), {"time": t, "u": 0 * t}).states
    assert np.abs(still["s"]).max() == 0


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"P_S": 1.3e5, "P_a": 1.4e5}, "supply above ambient: P_S = 130000, P_a = 140000"),
        ({"A_B": 13e-4}, "no area below the rod's side"),
        ({"b": 1.2}, "'b': 1.2 lies outside its bounds [0.01, 0.9]; give"),
        ({"b": -0.1}, "'b': -0.1"),
        ({"P_a": -1e5}, "'P_a': -100000"),
    ],
)
def test_constants_against_physics_are_refused(values, words):
    with pytest.raises(ModelError, match=re.escape(words)):
        pneumatic_full.start(**values)
    with pytest.raises(ModelError, match=words.split(":")[0]):
        pneumatic_full.fix(**values)


@pytest.mark.parametrize("b", [1.2, -0.1])
def test_wider_bounds_do_not_let_a_critical_ratio_out_of_0_to_1(b):
    wide = pneumatic_full.bound(b=(-1.0, 2.0))
    with pytest.raises(ModelError, match=rf"breaks a rule: critical pressure ratio between 0 and 1: b = {b}"):
        wide.start(b=b)


def test_records_against_physics_are_refused_with_rows():
    fine = {"s": np.array([0.0, 0.2499, np.nan]), "p_a": np.array([2e5, np.nan, 3e5])}
    pneumatic_full.check_measured("record", fine)
    with pytest.raises(DataError, match=r"'s' breaks the rule 'piston within its stroke' at row 2 \(row 2: 0.3 m\)"):
        pneumatic_full.check_measured("record", fine | {"s": np.array([0.0, 0.3, 0.1])})
    with pytest.raises(DataError, match=r"'p_a' .*rows 1, 3 \(row 3: -20000 Pa\); give absolute"):
        pneumatic_full.check_measured("record", fine | {"p_a": np.array([0.0, 1e5, -2e4])})


def test_a_rule_about_an_unknown_output_and_an_unknown_part_are_refused():
    rule = Rule("positive", "m", lambda value, p: value, "measure it", "x")
    with pytest.raises(ModelError, match="unknown output"):
        type(pneumatic_pva)(
            **{f: getattr(pneumatic_pva, f) for f in ("name", "states", "inputs", "outputs", "parameters", "balances")},
            rules=[rule],
        )
    with pytest.raises(ModelError, match="did you mean 'power'"):
        iso6358_valve("powr")
    with pytest.raises(ModelError, match="areas 'both'"):
        gas_chambers("both")
