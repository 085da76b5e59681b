"""What a fit says of the course of an input between rows: where the records contradict it, and where they leave it open."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.estimation import findings
from greybox.estimation.findings import EstimationCode
from greybox.estimation.optimum import EARLIER_GAINS, SimulationOptimum

STEP, ROWS = 0.05, 1000
TIME = STEP * np.arange(ROWS)
CODES = (EstimationCode.INPUT_COURSE_CONTRADICTED, EstimationCode.INPUT_COURSE_OPEN)

lag = Model(
    "lag",
    states=[State("y", "V")],
    inputs=[Input("u", "V")],
    outputs=[Output("y", "V")],
    parameters=[Parameter("K", "1", 1.0, (1e-3, 1e3)), Parameter("tau", "s", 1.0, (1e-3, 1e3))],
    balances=lambda x, u, p: [Balance("lag", "V", p.tau, "y", drive=p.K * u.u, decay=-x.y)],
)


def sines(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.sum([np.sin(2 * np.pi * f * TIME + rng.uniform(0, 6)) for f in (0.05, 0.17, 0.4, 0.9)], axis=0)


SMOOTH = {"sines": sines(0), "chirp": np.sin(0.6 * TIME**1.4), "other sines": 3 + sines(5)}


def measure(u: np.ndarray, straight: bool, level: float, seed: int = 0) -> np.ndarray:
    y = lsim(([[-2.0]], [[4.0]], [[1.0]], [[0.0]]), u, TIME, interp=straight, X0=[2 * u[0]])[1]
    return y + level * y.std() * np.random.default_rng(seed).normal(size=ROWS)


def find(fit: gb.Fit) -> list:
    return [f for f in fit.findings if f.code in CODES]


@pytest.mark.crossed(3)
@pytest.mark.parametrize("straight", [True, False], ids=["straight", "held"])
@pytest.mark.parametrize("name", SMOOTH)
def test_the_records_contradict_a_wrong_course_and_confirm_a_right_one(name: str, straight: bool) -> None:
    u = SMOOTH[name]
    y = measure(u, straight, 0.02)
    right, wrong = ("first", "zero") if straight else ("zero", "first")
    record = Experiment.from_arrays(TIME, {"u": u}, {"y": y}, hold=right)
    fit, mistaken = gb.fit(lag, record), gb.fit(lag, record.with_hold(wrong))
    assert not find(fit)
    (finding,) = find(mistaken)
    assert (finding.code, finding.subject, finding.values["courses"]) == (CODES[0], "u", {"u": right})
    # One step to the other course ends where a fit with it does, within a fifth of what was wrong.
    for constant, (before, after, deviations) in finding.values["changes"].items():
        assert before == pytest.approx(mistaken.parameters[constant].value)
        assert after == pytest.approx(fit.parameters[constant].value, abs=0.2 * abs(after - before))
        assert deviations > 1


def test_a_smooth_input_that_bows_between_its_rows_contradicts_straight_pieces() -> None:
    """An oscillator under sines of 20 rows to a period, by an independent solver: straight pieces take up to 0.8 % of the force away."""
    mass = Model(
        "mass",
        states=[State("q", "m"), State("v", "m/s")],
        inputs=[Input("F", "N")],
        outputs=[Output("q", "m")],
        parameters=[Parameter("M", "kg", 1.5), Parameter("d", "N*s/m", 1.0), Parameter("k", "N/m", 20.0)],
        balances=lambda x, u, p: [
            Balance("motion", "m/s", 1, "q", v=x.v),
            Balance("force", "N", p.M, "v", drive=u.F, damper=-p.d * x.v, spring=-p.k * x.q),
        ],
    )
    truth, noise = {"M": 2.0, "d": 0.8, "k": 30.0}, np.random.default_rng(3)

    def force(t: np.ndarray | float) -> np.ndarray:
        return np.sum([np.sin(2 * np.pi * f * np.asarray(t) + 1.3 * f) for f in (0.37, 0.63, 0.97)], axis=0)

    def move(t: float, x: np.ndarray) -> list[float]:
        return [x[1], float(force(t) - truth["d"] * x[1] - truth["k"] * x[0]) / truth["M"]]

    q = solve_ivp(move, (0, TIME[-1]), [0.0, 0.0], t_eval=TIME, rtol=1e-9, atol=1e-12, max_step=STEP).y[0]
    read = {"F": force(TIME) + 3e-3 * noise.normal(size=ROWS)}, {"q": q + 0.003 * q.std() * noise.normal(size=ROWS)}
    fit = gb.fit(mass, Experiment.from_arrays(TIME, *read, hold="auto"))
    (finding,) = find(fit)
    assert finding.values["courses"] == {"F": "band-limited"}
    again = gb.fit(mass, Experiment.from_arrays(TIME, *read, hold="band-limited"))
    assert not find(again)
    for name, (before, after, _) in finding.values["changes"].items():
        low, high = again.parameters[name].interval
        assert low <= truth[name] <= high and not low <= before <= high
        assert after == pytest.approx(again.parameters[name].value, abs=0.3 * abs(after - before))
    # Who says that it is straight is believed.
    assert not find(gb.fit(mass, Experiment.from_arrays(TIME, *read, hold="first")))


def test_steps_that_were_said_to_be_straight_are_contradicted() -> None:
    u = np.repeat(np.random.default_rng(2).normal(size=ROWS // 10), 10)
    y = measure(u, False, 0.02)
    (finding,) = find(gb.fit(lag, Experiment.from_arrays(TIME, {"u": u}, {"y": y}, hold="first")))
    assert (finding.code, finding.values["courses"]) == (CODES[0], {"u": "zero"})
    assert not find(gb.fit(lag, Experiment.from_arrays(TIME, {"u": u}, {"y": y})))


def test_where_noise_hides_the_course_a_fit_says_what_rests_on_it() -> None:
    u, seen = SMOOTH["sines"], []
    for seed in range(8):
        found = find(gb.fit(lag, Experiment.from_arrays(TIME, {"u": u}, {"y": measure(u, True, 0.3, seed)})))
        # Never silent where tau depends on it by more than its deviation.
        assert [f.subject for f in found] == ["u"] and "tau" in found[0].values["changes"]
        seen.append(found[0].code)
    assert CODES[1] in seen


def test_the_filter_tells_the_course_too() -> None:
    u = SMOOTH["sines"]
    y = measure(u, True, 0.01)
    pushed = lag.with_process_noise(y=0.01)
    record = Experiment.from_arrays(TIME, {"u": u}, {"y": y}, hold="zero")
    (finding,) = find(gb.fit(pushed, record))
    assert (finding.code, finding.values["courses"]) == (CODES[0], {"u": "first"})
    assert not find(gb.fit(pushed, record.with_hold("first")))


# Between rows an input moves on in so many parts.
PARTS = 40


def measure_means(name: str, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means (N,) over the intervals that end at the rows, of an input and of what it drives, and the output at the rows."""
    rng, count = np.random.default_rng(seed), ROWS // 4 * PARTS
    u = {
        "steps": np.repeat(rng.normal(size=ROWS // 20), count // (ROWS // 20)),
        "duty": (rng.random(count) < np.repeat(rng.random(ROWS // 20), count // (ROWS // 20))) + 0.0,
        "clouds": np.interp(np.arange(count), np.arange(0, count + 300, 300), rng.random(count // 300 + 2)),
        "one step": (np.arange(count) > count / 7) + 0.0,
    }[name]
    y = lsim(
        ([[-0.5]], [[1.0]], [[1.0]], [[0.0]]), u, 5 * STEP / PARTS * np.arange(count), interp=False, X0=[2 * u[0]]
    )[1]
    return u.reshape(-1, PARTS).mean(axis=1), y.reshape(-1, PARTS).mean(axis=1), y[PARTS - 1 :: PARTS]


@pytest.mark.crossed(3)
@pytest.mark.parametrize("name", ["steps", "duty", "clouds", "one step"])
@pytest.mark.parametrize("all_are", [True, False], ids=["all means", "inputs alone"])
def test_means_over_the_past_interval_are_recognised(name: str, all_are: bool) -> None:
    u, averaged, read = measure_means(name, 3)
    y, time = (averaged if all_are else read), 5 * STEP * np.arange(1, len(u) + 1)
    record = Experiment.from_arrays(
        time, {"u": u}, {"y": y + 0.01 * y.std() * np.random.default_rng(1).normal(size=len(y))}
    )
    mistaken = gb.fit(lag, record)
    (finding,) = find(mistaken)
    told = "mean" if all_are else {"u": "mean"}
    # A smooth mean beside smooth means is, in their middles, a straight line.
    straight = name == "clouds" and all_are
    assert finding.code == CODES[0]
    assert finding.values["courses"] == ({"u": "first"} if straight else {} if all_are else told)
    right = gb.fit(lag, record.with_hold(told))
    assert not find(right)
    # An eighth of the time constant lies between rows: of it a mean does not tell in which part the input came.
    assert right.parameters["tau"].value == pytest.approx(2.0, rel=0.015)
    tau = mistaken.parameters["tau"]
    assert abs(tau.value - 2.0) > max(0.04 * 2.0, 2 * tau.std)


def test_of_two_inputs_the_mistaken_one_is_named() -> None:
    room = Model(
        "room",
        states=[State("T", "K", 290.0)],
        inputs=[Input("P", "W"), Input("Ta", "K")],
        outputs=[Output("T", "K")],
        parameters=[Parameter("C", "J/K", 1e6, (1e4, 1e9)), Parameter("R", "K/W", 0.05, (1e-4, 10.0))],
        balances=lambda x, u, p: [Balance("air", "W", p.C, "T", heater=u.P, loss=(u.Ta - x.T) / p.R)],
    )
    rng, time = np.random.default_rng(0), 900.0 * np.arange(300)
    power, outside = 1000.0 * (rng.random(300) < 0.4), 278 + 8 * np.sin(2 * np.pi * time / 7200)
    A, B = [[-1 / (2e6 * 0.02)]], [[1 / 2e6, 1 / (2e6 * 0.02)]]
    zero = np.zeros(300)
    # The answers to a held heater and to a straight temperature add up.
    parts = [
        lsim((A, B, [[1.0]], [[0.0, 0.0]]), np.column_stack(pair), time, interp=straight, X0=[start])[1]
        for pair, straight, start in (((power, zero), False, 290.0), ((zero, outside), True, 0.0))
    ]
    record = Experiment.from_arrays(time, {"P": power, "Ta": outside}, {"T": sum(parts) + 0.01 * rng.normal(size=300)})
    for hold, wrong in (("zero", "Ta"), ("first", "P")):
        assert [f.subject for f in find(gb.fit(room, record.with_hold(hold)))] == [wrong]
    right = gb.fit(room, record.with_hold({"Ta": "first", "P": "zero"}))
    assert not find(right) and right.misfit["T"].rmse == pytest.approx(0.01, rel=0.1)
    placed = gb.fit(room + gb.effect("linear_input_at_Ta"), record)
    assert [q.value for q in placed.parameters.values()] == pytest.approx([q.value for q in right.parameters.values()])


@pytest.mark.crossed(3)
@pytest.mark.parametrize("kind", ["held", "means", "inputs alone", "gaps", "at rest"])
def test_what_means_would_gain_is_foretold_without_a_run(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gain along the run's own way from row to row bounds what the steps with means find, and is small where inputs are held."""
    seen: list[SimulationOptimum] = []
    monkeypatch.setattr(findings, "_find_other_courses", lambda optimum: seen.append(optimum) or [])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u, averaged, read = measure_means("steps", seed)
        time = 5 * STEP * np.arange(1, len(u) + 1)
        y = averaged if kind == "means" else read
        if kind == "held":
            u = rng.normal(size=len(time) // 5 + 1).repeat(5)[: len(time)]
            y = lsim(([[-0.5]], [[1.0]], [[1.0]], [[0.0]]), u, time - time[0], interp=False, X0=[2 * u[0]])[1]
        y = y + 0.02 * y.std() * rng.normal(size=len(y))
        if kind == "gaps":
            y[30:60] = np.nan
        options = gb.FitOptions(at_rest=kind == "at rest")
        gb.fit(lag, Experiment.from_arrays(time, {"u": u}, {"y": y}), options=options)
    foretold = [optimum._gain_by_acting_earlier for optimum in seen]
    if kind == "held":
        assert max(foretold) < 1 < EARLIER_GAINS
    monkeypatch.setattr("greybox.estimation.optimum.EARLIER_GAINS", -np.inf)
    for optimum, bound in zip(seen, foretold, strict=True):
        means = [c.gain for c in optimum.other_courses if isinstance(c.courses, str) or "mean" in c.courses.values()]
        assert len(means) == 2
        assert max(means) <= bound * 1.05 + 0.5
        if kind != "held":
            assert max(means) > 100 > EARLIER_GAINS
        # A run that begins at rest, though the record did not, cannot move on along its way from there.
        if kind not in ("held", "at rest"):
            assert max(means) > 0.5 * bound


def test_a_course_under_which_the_plant_falls_over_is_not_taken_for_refuted() -> None:
    """A pendulum near its top: under the true course, at the constants of the wrong one, it goes round, and that loss says nothing."""
    rng, truth = np.random.default_rng([10, 320]), {"J": 0.08, "b": 0.15, "mgl": 2.0}
    f = np.exp(rng.uniform(np.log(0.1), np.log(3.0), 6))
    a, phase = rng.uniform(0.3, 1, 6) * (0.1 / f) ** 0.3, rng.uniform(0, 2 * np.pi, 6)
    time = 0.02 * np.arange(800)

    def push(t: np.ndarray | float) -> np.ndarray:
        return (
            0.8 * np.sum(a * np.sin(2 * np.pi * f * np.asarray(t)[..., None] + phase), -1) / np.sqrt(np.sum(a**2) / 2)
        )

    def fall(t: float, x: np.ndarray) -> list[float]:
        return [x[1], (push(t) - truth["b"] * x[1] - truth["mgl"] * np.sin(x[0])) / truth["J"]]

    angle = solve_ivp(fall, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.02).y[0]
    rng.normal(size=(800, 1))  # the noise of the input, of which there is none
    angle = angle + 0.02 * angle.std() * rng.normal(size=800)
    pendulum = Model(
        "arm",
        [State("q", "rad"), State("w", "rad/s")],
        [Input("M", "N*m")],
        [Output("q", "rad")],
        [
            Parameter("J", "kg*m^2", 0.1, (1e-4, 1e2)),
            Parameter("b", "N*m*s", 0.1, (1e-4, 1e2)),
            Parameter("mgl", "N*m", 3.0, (1e-2, 1e3)),
        ],
        lambda x, u, p: [
            Balance("turn", "rad/s", 1, "q", w=x.w),
            Balance("torque", "N*m", p.J, "w", drive=u.M, drag=-p.b * x.w, weight=-p.mgl * ca.sin(x.q)),
        ],
    )
    mistaken = gb.fit(pendulum, Experiment.from_arrays(time, {"M": push(time)}, {"q": angle}))
    low, high = mistaken.parameters["b"].interval
    assert not low <= truth["b"] <= high
    (finding,) = find(mistaken)
    assert (finding.code, finding.values["courses"]) == (CODES[1], {"M": "first"})
