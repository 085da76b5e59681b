"""What the structure determines agrees with what is known by hand; open directions leave simulations as they are."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, effect, fit
from greybox.base.errors import DataError, ModelError
from greybox.data.signals import multisine
from greybox.estimation.identifiability.excitation import analyse_excitation, excitation_order
from greybox.estimation.identifiability.practical import (
    PracticalIdentifiability,
    analyse_practical_identifiability,
    recommend_after_fit,
)
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode as Code
from greybox.estimation.identifiability.sensitivity import fastest_and_slowest_rate
from greybox.estimation.identifiability.structural import IdentifiabilityVerdict as Verdict
from greybox.estimation.identifiability.structural import analyse_structural_identifiability
from greybox.simulation.simulate import simulate
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator, micro_actuator_no_inductance
from models.pneumatic_cylinder import pneumatic_cylinder
from models.pneumatic_full import pneumatic_full
from models.pneumatic_pva import pneumatic_pva
from models.silverbox import silverbox

CHAIN = ("K2", "f_v", "M_piston", "A_piston", "V_total", "P_S")
CLEAR = 1e8  # of the gap between the last singular value that counts and the first that does not


def tied(model: Model) -> Model:
    """The actuator with one constant in the place of `Kf` and `Kv`."""

    def balances(x, u, p):
        return model.balances(x, u, p.replaced({"Kv": p.Kf}))

    parameters = [q for q in model.parameters if q.name != "Kv"]
    return replace(model, parameters=parameters, balances=balances, outputs=[Output("x", "m"), Output("i", "A")])


def two_modes(damping):
    """Oscillators of 1 and 10 rad/s, or lags at these rates."""

    def balances(x, u, p):
        if damping:
            return [Balance(n, "1/s", 1, n, decay=-p[f"w{n}"] * x[n]) for n in "ab"]
        pairs = [(n, other, sign) for n, other, sign in (("a", "c", 1), ("c", "a", -1), ("b", "d", 1), ("d", "b", -1))]
        return [Balance(n, "1/s", 1, n, turn=sign * p["wa" if n in "ac" else "wb"] * x[o]) for n, o, sign in pairs]

    names = "ab" if damping else "acbd"
    rates = [Parameter("wa", "1/s", 1.0), Parameter("wb", "1/s", 10.0)]
    return Model("modes", [State(n, "1") for n in names], [], [Output(n, "1") for n in names], rates, balances)


@pytest.mark.parametrize("damping", [True, False], ids=["lags", "oscillators"])
def test_the_slowest_motion_is_the_one_that_takes_longest(damping):
    assert fastest_and_slowest_rate(two_modes(damping)) == pytest.approx((10.0, 1.0))


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    ("model", "outputs", "rank", "count"),
    [
        (micro_actuator_no_inductance, ["x"], 3, 6),
        (micro_actuator, ["x"], 4, 7),
        (micro_actuator, ["x", "i"], 6, 7),
        (micro_actuator.fix("M"), None, 6, 6),
        (tied(micro_actuator), None, 6, 6),
        # eq. 10.8: f_v, 2 P_S A^2/(M V) and 2 P_a K2 P_S A/(rho M V)
        (pneumatic_cylinder.free(*CHAIN), ["s"], 3, 6),
        (pneumatic_pva.free(*CHAIN), None, 3, 6),
        # with a pressure also A/M and P_S A/V apart; the start at P_S/2 is known only where the record begins at rest
        (pneumatic_cylinder.free(*CHAIN), None, 4, 6),
        (silverbox, None, 3, 3),
        (emps, None, 2, 2),
        (emps.free("g"), None, 2, 3),
        (cascaded_tanks, None, 3, 3),
        (cascaded_tanks.free("k2"), None, 3, 4),
        (pneumatic_full, ["s"], 3, 3),
    ],
    ids=lambda v: getattr(v, "name", None),
)
def test_known_ranks(model: Model, outputs: list[str] | None, rank: int, count: int) -> None:
    found = analyse_structural_identifiability(model, outputs)
    assert (found.rank, found.count) == (rank, count)
    assert found.certain
    assert found.gap > CLEAR
    assert len(found.directions) == count - rank
    assert found.complete == (rank == count)


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_random_points_say_the_same(seed: int) -> None:
    assert analyse_structural_identifiability(micro_actuator, ["x"], seed).rank == 4
    assert analyse_structural_identifiability(cascaded_tanks.free("k2"), seed=seed).rank == 3


def test_a_start_at_rest_tells_more() -> None:
    chain = pneumatic_cylinder.free(*CHAIN)
    found = analyse_structural_identifiability(chain, at_rest=True)
    assert found.rank == 5
    assert "P_S" in found.determined
    assert [d.names for d in found.directions] == [("K2", "M_piston", "A_piston", "V_total")]


@pytest.mark.parametrize("radiates", [False, True], ids=["transfer functions", "free runs"])
def test_a_plant_that_begins_where_it_stays_shows_no_rate(radiates) -> None:
    # T = Ta for all time, whatever the rate: d/dk of 1/(s + k) (Ta + k Ta/s) = Ta/s is zero.
    room = Model(
        "room",
        states=[State("T", "K", lambda p: p.Ta)],
        inputs=[],
        outputs=[Output("T", "K")],
        parameters=[Parameter("k", "1/s", 0.3), Parameter("Ta", "K", 290.0)],
        balances=lambda x, u, p: [
            Balance("heat", "K/s", 1, "T", loss=-p.k * (x.T**2 / p.Ta - p.Ta if radiates else x.T - p.Ta))
        ],
    )
    found = analyse_structural_identifiability(room, at_rest=True)
    assert found.determined == ("Ta",)
    assert [d.names for d in found.directions] == [("k",)]


def test_the_combinations_of_equation_16_2() -> None:
    found = analyse_structural_identifiability(micro_actuator_no_inductance, ["x"])
    assert set(found.determined) == {"K/M", "Kf/(M Ra)", "(Kf Kv/Ra + B)/M"}
    assert {(d.names, d.scaling) for d in found.directions} == {
        (("Kf", "Ra"), True),
        (("M", "B", "K", "Kf"), True),
        (("B", "Kv"), False),
    }


def test_the_combinations_of_equation_10_8() -> None:
    found = analyse_structural_identifiability(pneumatic_cylinder.free(*CHAIN), ["s"])
    assert set(found.determined) == {"f_v", "K2/A_piston", "A_piston^2 P_S/(M_piston V_total)"}


def test_the_scale_of_the_coil_is_seen_by_the_current() -> None:
    found = analyse_structural_identifiability(micro_actuator, ["x"])
    coil = next(d for d in found.directions if set(d.names) == {"Kf", "Ra", "La"})
    assert coil.scaling
    assert coil.seen_by == ("i",)
    mechanism = next(d for d in found.directions if set(d.names) == {"M", "B", "K", "Kf"})
    assert mechanism.seen_by == ()
    first = found.recommendations[0]
    assert first.code == Code.MEASURE_OUTPUT
    assert (first.values["signals"], first.values["rank"], first.values["count"]) == (["i"], 6, 7)
    assert first.values["then"] == {
        "missing": 1,
        "constants": ["M", "B", "K", "Kf"],
        "relations": [{"constants": ["Kf", "Kv"], "equal": True}],
    }


@pytest.mark.parametrize("name", ["M", "B", "K", "Kf"])
def test_each_constant_that_is_proposed_closes_the_gap(name: str) -> None:
    assert analyse_structural_identifiability(micro_actuator.fix(name)).complete


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(
    ("model", "outputs"),
    [(micro_actuator, ["x"]), (pneumatic_cylinder.free(*CHAIN), ["s"]), (cascaded_tanks.free("k2"), ["y"])],
    ids=lambda v: getattr(v, "name", ""),
)
def test_a_scaling_leaves_the_outputs_as_they_are(model: Model, outputs: list[str]) -> None:
    scalings = [d for d in analyse_structural_identifiability(model, outputs).directions if d.scaling]
    assert scalings
    step = {"micro_actuator": 2e-5, "pneumatic_cylinder": 1e-3, "cascaded_tanks": 1.0}[model.name]
    time = step * np.arange(400)
    drive = {"time": time, "u": 1.5 + np.sin(40 * time / time[-1])}
    before = simulate(model, drive)
    for direction in scalings:
        changed = model.start(**{n: model.values[n] * 1.2**w for n, w in direction.weights.items()})
        initial = {}
        if model is not micro_actuator and "k2" in direction.names:  # the upper level in its new unit
            initial = {"x1": 15.0 * 1.2 ** (-2 * direction.weights["k2"])}
        after = simulate(changed, drive, initial=initial)
        for name in outputs:
            movement = np.ptp(before.outputs[name])
            assert np.abs(after.outputs[name] - before.outputs[name]).max() < 1e-6 * movement, str(direction)


def plant(balances, parameters: list[Parameter], *, states: list[State], outputs: list[Output]) -> Model:
    return Model("plant", states, [Input("u", "N*m")], outputs, parameters, balances)


def positive(name: str, unit: str, value: float) -> Parameter:
    return Parameter(name, unit, value, (1e-3 * value, 1e3 * value))


def test_a_pendulum_with_a_sine() -> None:
    def balances(x, u, p):
        inertia = p.m * p.l**2
        gravity = -p.m * p.g * p.l * ca.sin(x.a)
        return [
            Balance("angle", "rad/s", 1, "a", rate=x.w),
            Balance("torque", "N*m", inertia, "w", drive=u.u, gravity=gravity, friction=-p.c * x.w),
        ]

    pendulum = plant(
        balances,
        [
            positive("m", "kg", 0.4),
            positive("l", "m", 0.5),
            positive("g", "m/s**2", 9.81),
            positive("c", "N*m*s", 0.05),
        ],
        states=[State("a", "rad"), State("w", "rad/s")],
        outputs=[Output("a", "rad")],
    )
    found = analyse_structural_identifiability(pendulum)
    # g/l, m l^2 and c
    assert (found.rank, found.count) == (3, 4)
    assert "c" in found.determined
    assert [set(d.names) for d in found.directions] == [{"m", "l", "g"}]
    assert found.directions[0].weights == {"m": 2.0, "l": -1.0, "g": -1.0}
    assert analyse_structural_identifiability(pendulum.fix("g")).complete


def test_a_smooth_friction_with_a_hyperbolic_tangent() -> None:
    def balances(x, u, p):
        return [
            Balance("angle", "rad/s", 1, "a", rate=x.w),
            Balance("torque", "N*m", p.J, "w", drive=p.k * u.u, dry=-p.F * ca.tanh(x.w / p.ws)),
        ]

    parameters = [positive("J", "kg*m**2", 0.1), positive("k", "1", 1.0), positive("F", "N*m", 0.3)]
    model = plant(
        balances,
        [*parameters, positive("ws", "rad/s", 0.5)],
        states=[State("a", "rad"), State("w", "rad/s")],
        outputs=[Output("a", "rad")],
    )
    found = analyse_structural_identifiability(model)
    assert (found.rank, found.count) == (3, 4)
    assert [d.weights for d in found.directions] == [{"J": 1.0, "k": 1.0, "F": 1.0}]
    assert analyse_structural_identifiability(model.fix("k")).complete


def test_a_constant_without_influence_is_named() -> None:
    model = plant(
        lambda x, u, p: [Balance("rate", "rad/s", p.T / p.T, "a", drive=u.u / p.c)],
        [positive("T", "s", 1.0), positive("c", "N*m*s", 2.0)],
        states=[State("a", "rad")],
        outputs=[Output("a", "rad")],
    )
    found = analyse_structural_identifiability(model)
    assert [d.names for d in found.directions] == [("T",)]
    assert found.determined == ("c",)


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(
    ("name", "count"), [("bouc_wen_hysteresis", 5), ("input_saturation", 3), ("coulomb_friction", 3), ("backlash", 3)]
)
def test_an_effect_that_is_off_is_switched_on(name: str, count: int) -> None:
    found = analyse_structural_identifiability(emps + effect(name))
    assert (found.rank, found.count) == (count, count)


def test_two_springs_side_by_side_are_one() -> None:
    found = analyse_structural_identifiability(micro_actuator.fix("M") + effect("return_spring"))
    assert (found.rank, found.count) == (6, 7)
    assert "K + Ks" in found.determined
    assert [set(d.names) for d in found.directions] == [{"K", "Ks"}]
    assert not found.directions[0].scaling


def test_a_dead_time_is_determined() -> None:
    found = analyse_structural_identifiability(emps + effect("transport_delay"))
    assert found.complete
    assert found.count == 3


def test_wrong_questions() -> None:
    with pytest.raises(ModelError, match="no output 'y'"):
        analyse_structural_identifiability(micro_actuator, ["y"])
    with pytest.raises(ModelError, match="no output is measured"):
        analyse_structural_identifiability(micro_actuator, [])
    assert analyse_structural_identifiability(silverbox.fix(*silverbox.values)).verdict is Verdict.NOTHING_FREE


TONES = {
    "u1": ((0.5, 0.05), (1.5, 0.2), (2.5, 0.8)),
    "u2": ((1.25, 0.05), (1.25, 0.2), (2.0, 0.8)),
    "u3": ((0.75, 0.05), (0.75, 0.2), (2.0, 0.8)),
}  # V, Hz
SENSOR = 4e-4  # m: 8 mV at 0.05 m/V


def tones(name: str, time: np.ndarray) -> np.ndarray:
    return sum(a * np.sin(2 * np.pi * f * time) for a, f in TONES[name])


def position_record(model: Model, u: np.ndarray, time: np.ndarray) -> Experiment:
    record = simulate(model, {"time": time, "u": u}).record({"s": SENSOR}, np.random.default_rng(0))
    return replace(record, outputs={"s": record.outputs["s"]})


@pytest.mark.parametrize("name", TONES)
def test_the_three_tones_show_the_gain_and_one_lag(name: str) -> None:
    chain = pneumatic_cylinder.free(*CHAIN)
    time = 0.01 * np.arange(10001)
    found = analyse_practical_identifiability(
        chain, position_record(chain, tones(name, time), time), noise={"s": SENSOR}
    )
    assert set(found.combinations) == {"K2/A_piston", "f_v M_piston V_total/(A_piston^2 P_S)"}
    assert found.rank == 2
    # The third that the structure allows stands a hundredth of the noise high: averaging alone finds it.
    assert found.averaged == 1
    assert set(found.undetermined) == set(CHAIN) - {"f_v"}
    assert found.constants["f_v"].averaged
    (band,) = [f for f in found.findings if f.code == Code.EXCITATION_BAND_NARROW]
    assert band.values["band"] == pytest.approx(5.09, rel=1e-2)


def test_what_is_seen_by_averaging_is_what_a_change_hides_in_the_noise() -> None:
    """Gain and lag kept, the gas spring changed by half: less than the noise; the lag changed by half: more."""
    chain = pneumatic_cylinder.free(*CHAIN)
    time = 0.01 * np.arange(10001)
    drive = {"time": time, "u": tones("u1", time)}
    before, p = simulate(chain, drive).outputs["s"], chain.values

    def moved(**values: float) -> float:
        difference = simulate(chain.start(**values), drive).outputs["s"] - before
        # An initial position and velocity make up for an offset and a slope.
        rest = difference - np.polyval(np.polyfit(time, difference, 1), time)
        return float(np.std(rest))

    assert moved(f_v=1.5 * p["f_v"], V_total=p["V_total"] / 1.5) < SENSOR
    assert moved(f_v=1.5 * p["f_v"]) > SENSOR


def test_an_input_that_is_rich_shows_what_the_structure_allows() -> None:
    chain = pneumatic_cylinder.free(*CHAIN)
    time = 0.01 * np.arange(6001)
    u = np.repeat(np.random.default_rng(0).choice([-4.0, 4.0], 6001), 4)[:6001]
    record = position_record(chain, u, time)
    found = analyse_practical_identifiability(chain, record, noise={"s": SENSOR / 4})
    assert found.rank == 3
    assert found.findings == ()
    assert not found.constants["f_v"].averaged


def test_a_wide_interval_is_not_determined() -> None:
    model = micro_actuator.fix("M")
    time = 2.5e-4 * np.arange(400)
    slow = {"time": time, "u": np.sin(20 * time)}
    record = simulate(model, slow).record({"x": 2e-6, "i": 5e-2}, np.random.default_rng(0))
    found = analyse_practical_identifiability(model, record, noise={"x": 2e-6, "i": 5e-2})
    assert "La" in found.undetermined
    assert found.constants["La"].std is not None
    assert 1.96 * found.constants["La"].std > 0.5 * found.constants["La"].value
    (fewer,) = [f for f in found.findings if f.code == Code.RECORDS_SHOW_FEWER]
    assert fewer.values["structure"] == 6


def test_a_sensor_that_is_named_shows_more_of_the_same_run() -> None:
    blind = replace(micro_actuator.fix("M"), outputs=micro_actuator.outputs[:1])
    time, level = 2.5e-4 * np.arange(400), {"x": 2e-6, "i": 5e-2}
    slow = {"time": time, "u": np.sin(20 * time)}

    def shown(model: Model) -> PracticalIdentifiability:
        noise = {o.name: level[o.name] for o in model.outputs}
        record = simulate(model, slow).record(noise, np.random.default_rng(0))
        return analyse_practical_identifiability(model, record, noise=noise)

    found = shown(blind)
    (fewer,) = [f for f in found.findings if f.code == Code.RECORDS_SHOW_FEWER]
    assert "i" in fewer.values["sensors"]
    both = shown(micro_actuator.fix("M"))
    assert both.rank + both.averaged > found.rank + found.averaged


def driven(u: np.ndarray, step: float = 0.01) -> Experiment:
    return Experiment("drive", step * np.arange(len(u)), {"u": u}, {})


def test_the_order_of_excitation() -> None:
    time = 0.01 * np.arange(10001)
    generator = np.random.default_rng(0)
    assert excitation_order(np.zeros(500)) == 0
    assert excitation_order(np.ones(500)) == 1
    assert excitation_order((time > 50) * 1.0) == 1
    assert excitation_order(np.sin(time)) == 2
    assert excitation_order(1 + np.sin(time)) == 3
    assert [excitation_order(tones(name, time)) for name in TONES] == [6, 6, 6]
    assert excitation_order(tones("u1", time) + 1e-4 * generator.normal(size=len(time))) == 6
    assert excitation_order(generator.normal(size=4000)) == 40
    fine = 2.5e-4 * np.arange(6000)
    assert excitation_order(multisine(fine, 5, 800, 2, generator)) == 40


def test_a_step_is_too_little_for_the_actuator() -> None:
    step = driven(np.ones(1150), 2.5e-4)
    found = analyse_excitation(step, micro_actuator)
    assert found.orders == {"u": 1}
    assert found.needed == 3
    assert found.findings[0].code == Code.EXCITATION_ORDER_LOW
    assert (found.findings[0].values["order"], found.findings[0].values["needed"]) == (1, 3)
    rich = driven(np.random.default_rng(0).normal(size=4000), 2.5e-5)
    assert analyse_excitation(rich, micro_actuator).findings == ()


def test_an_input_that_steps_now_and_then_moves() -> None:
    """Most segments see it at zero: its order is 0, and yet it carries what there is to know."""
    u = np.zeros(2000)
    u[300:340], u[1200:1240] = 7.0, 11.0
    found = analyse_excitation(driven(u, 2.5e-4), micro_actuator)
    assert found.orders == {"u": 0}
    assert [f.code for f in found.findings if f.code == Code.NO_INPUT_MOVES] == []
    assert [f.code for f in analyse_excitation(driven(np.zeros(2000), 2.5e-4), micro_actuator).findings] == [
        Code.NO_INPUT_MOVES
    ]


def test_excitation_without_a_model_and_without_the_input() -> None:
    found = analyse_excitation(driven(np.sin(np.arange(3000.0))))
    assert found.orders == {"u": 2}
    assert found.needed is None
    assert found.bands["u"] == pytest.approx(100, rel=0.02)
    with pytest.raises(DataError, match="no input 'u'"):
        analyse_excitation(Experiment("drive", np.arange(9.0), {"w": np.ones(9)}, {}), silverbox)


@pytest.mark.parametrize(
    ("outputs", "fixed", "expected"),
    [
        (("x", "i"), (), [Code.FIX_CONSTANTS]),
        (("x",), ("Ra",), [Code.MEASURE_OUTPUT, Code.FIX_CONSTANTS]),
        (("x", "i"), ("M",), []),
    ],
)
def test_a_fit_that_leaves_constants_open_recommends_what_would_determine_them(outputs, fixed, expected) -> None:
    record = actuator_record(600)
    record = replace(record, outputs={n: record.outputs[n] for n in outputs})
    found = recommend_after_fit(fit(micro_actuator.fix(*fixed), record, noise={n: ACTUATOR_NOISE[n] for n in outputs}))
    assert [finding.code for finding in found] == expected
    if expected:
        closing = found[0].values if len(expected) == 1 else found[0].values["then"]
        assert closing["constants"] == ["M", "B", "K", "Kf"]


def test_a_record_that_is_not_rich_enough_is_told_from_a_model_that_hides_something() -> None:
    """At rest nothing tells a damping."""
    record = actuator_record(600)
    resting = replace(record, inputs={"u": np.zeros(600)}, outputs={"i": record.outputs["i"]})
    still = fit(
        micro_actuator.fix("M", "B", "Kf", "Ra", "La", "Kv"),
        resting,
        noise={"i": 5e-3},
        options=FitOptions(at_rest=True),
    )
    (finding,) = recommend_after_fit(still)
    assert (finding.code, finding.values["inputs"]) == (Code.RICHER_RECORD, ["u"])


def actuator_record(rows):
    time = 2.5e-4 * np.arange(rows)
    run = simulate(micro_actuator, {"time": time, "u": multisine(time, 5, 800, 2, np.random.default_rng(0))})
    return run.record(ACTUATOR_NOISE, np.random.default_rng(1))


ACTUATOR_NOISE = {"x": 2e-7, "i": 5e-3}


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(("capacity", "at_rest"), [(3600.0, False), (50.0, False), (50.0, True)])
def test_a_curve_over_a_state_that_moves_slowly_is_seen_where_the_state_goes(capacity, at_rest):
    """The open-circuit voltage of a cell at six charges: a record that moves the charge by a percent shows two of them."""
    knots = [f"v{k}" for k in range(6)]

    def voltage(x, u, p):
        hats = [ca.fmax(0, 1 - ca.fabs(5 * x.charge - k)) for k in range(6)]
        return sum(getattr(p, name) * hat for name, hat in zip(knots, hats, strict=True)) - p.R * u.i

    cell = Model(
        "cell",
        [State("charge", "1", 0.5, bounds=(0.0, 1.0))],
        [Input("i", "A")],
        [Output("v", "V", voltage)],
        [
            *(positive(name, "V", 3.0 + 0.1 * k + 0.05 * k**2) for k, name in enumerate(knots)),
            positive("R", "ohm", 0.05),
            Parameter("Q", "A*s", capacity, fixed=True),
        ],
        lambda x, u, p: [Balance("charge", "A", p.Q, "charge", drawn=-u.i)],
    )
    found = analyse_structural_identifiability(cell, at_rest=at_rest)
    assert (found.rank, found.count) == (7, 7)
