"""The next motion: exact slopes, limits on a finer sampling, no random motion that tells more, intervals as MuJoCo's torques have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError
from greybox.extensions.robot import MotionDesign, RigidBody, Robot, design_motion, find_base_parameters, read_robot
from greybox.extensions.robot.design import MotionSearch
from tests.support.robots import DOUBLE_PENDULUM, write

LIMITS = {
    "shoulder": {"lower": -1.0, "upper": 1.5, "speed": 3.0, "acceleration": 12.0, "effort": 14.0},
    "elbow": {"lower": -2.0, "upper": 2.0, "speed": 4.0, "acceleration": 20.0, "effort": 3.0},
}


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return read_robot(write(tmp_path_factory.mktemp("robot") / "arm.urdf", DOUBLE_PENDULUM))


@pytest.fixture(scope="module")
def designed(arm: Robot) -> MotionDesign:
    return design_motion(arm, noise=0.1, limits=LIMITS)


def make_search(arm: Robot) -> MotionSearch:
    return MotionSearch(find_base_parameters(arm), 0.1, (10.0, 5, 100.0), LIMITS, [])


def test_slopes_are_exact(arm: Robot) -> None:
    search = make_search(arm)
    x = np.random.default_rng(1).normal(size=search.coarse.shape[2] * 2)
    _, slopes = search.evaluate(x)
    for k in range(len(x)):
        beside = 1e-6 * np.eye(len(x))[k]
        difference = (search.evaluate(x + beside)[0] - search.evaluate(x - beside)[0]) / 2e-6
        assert slopes[k] == pytest.approx(difference, rel=1e-4, abs=1e-6 * np.abs(slopes).max())


def test_it_stays_inside_its_limits_and_begins_at_rest(arm: Robot, designed: MotionDesign) -> None:
    """By splines through its samples, a hundred times finer, and torques by the textbook's equations of the robot."""
    from scipy.interpolate import CubicSpline

    fine = np.linspace(0, 10, 100_001)
    spline = CubicSpline(designed.time, designed.q, bc_type="periodic")
    q, dq, ddq = (spline(fine, order) for order in (0, 1, 2))
    tau = RigidBody(arm).compute_torques(q, dq, ddq) + [0.1, 0.0] * dq + [0.2, 0.0] * np.sign(dq)
    for k, known in enumerate(LIMITS.values()):
        for values, low, high in (
            (q, known["lower"], known["upper"]),
            (dq, -known["speed"], known["speed"]),
            (ddq, -known["acceleration"], known["acceleration"]),
            (tau, -known["effort"], known["effort"]),
        ):
            # The spline's second derivative is good to a thousandth.
            assert values[:, k].min() >= low - 2e-3 * abs(low) and values[:, k].max() <= high + 2e-3 * high
    assert designed.dq[0] == pytest.approx(0, abs=1e-9) and designed.ddq[0] == pytest.approx(0, abs=1e-9)
    assert designed.q[0] == pytest.approx(designed.q[-1])
    assert spline(designed.time, 1) == pytest.approx(designed.dq, abs=1e-3)


def test_no_random_motion_tells_more(arm: Robot, designed: MotionDesign) -> None:
    search, rng = make_search(arm), np.random.default_rng(7)
    best = max(
        float(np.linalg.slogdet(search.inform(search.shrink(search.random(rng) * rng.uniform(0.05, 1))))[1])
        for _ in range(12)
    )
    information = search.weigh(search.columns(designed.q, designed.dq, designed.ddq))
    assert float(np.linalg.slogdet(information)[1]) > best + 1.0


def test_intervals_are_those_of_torques_by_mujoco(arm: Robot, designed: MotionDesign) -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    model = mujoco.MjModel.from_xml_string(DOUBLE_PENDULUM)
    model.dof_damping[:], model.dof_frictionloss[:] = 0, 0
    data, rows = mujoco.MjData(model), []
    for q, dq, ddq in zip(designed.q[:-1], designed.dq[:-1], designed.ddq[:-1], strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        rows.append(data.qfrc_inverse.copy())
    search, rng = make_search(arm), np.random.default_rng(0)
    columns = search.columns(designed.q[:-1], designed.dq[:-1], designed.ddq[:-1]).reshape(2 * len(rows), -1)
    tau = np.array(rows).ravel()
    base = find_base_parameters(arm)
    estimates = [np.linalg.lstsq(columns, tau + 0.1 * rng.normal(size=len(tau)), rcond=None)[0][:6] for _ in range(200)]
    assert np.mean(estimates, axis=0) == pytest.approx(base.values, abs=float(designed.after.max()))
    # The standard deviation of 200 draws is known to 5 %.
    assert np.std(estimates, axis=0) == pytest.approx(designed.after, rel=0.2)


def test_what_a_log_leaves_open_is_what_shrinks(arm: Robot, tmp_path: Path) -> None:
    time = 0.01 * np.arange(2000)
    # The elbow hardly moves: its constants are open.
    q = np.column_stack([np.sin(time) + 0.3 * np.sin(2.3 * time), 0.02 * np.sin(1.7 * time)])
    dq, ddq = np.gradient(q, time, axis=0), np.gradient(np.gradient(q, time, axis=0), time, axis=0)
    tau = RigidBody(arm).compute_torques(q, dq, ddq)
    columns = {f"{s}{k + 1}": values[:, k] for s, values in (("q", q), ("tau", tau)) for k in range(2)}
    log = gb.Experiment("log", time, {}, columns)
    designed = design_motion(arm, [log], noise=0.1, limits=LIMITS)
    gains = dict(zip(designed.names, designed.shrinking, strict=True))
    assert designed.beside == "the logs alone" and min(gains.values()) >= 1
    assert min(gains["mx2"], gains["Iyy2"]) > 2 * gains["mz1"]
    assert " ".join(str(designed).split()).startswith("10 s of this motion make the intervals of 6 base parameters")
    errors = designed.to_data()["standard_errors"]
    assert all(e["after"] < e["before"] for e in errors.values())
    written = designed.write_csv(tmp_path / "next.csv").read_text().splitlines()
    assert written[0] == "time [s],q1 [rad],q2 [rad],dq1 [rad/s],dq2 [rad/s],ddq1 [rad/s^2],ddq2 [rad/s^2]"
    assert len(written) == 1002


def test_limits_that_hold_nothing_are_refused(arm: Robot) -> None:
    with pytest.raises(DataError, match="holding still in the middle of its limits takes more than its efforts"):
        design_motion(arm, limits={"shoulder": {"lower": 1.2, "upper": 1.8, "effort": 2.0}})
