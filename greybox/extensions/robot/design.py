"""The next motion: a Fourier series of each axis, inside its limits, that tells most of the base parameters.

Positions are ``q(t) = c + sum a_h sin(h w t) + b_h cos(h w t)``, which repeat and begin at rest (Swevers et al., IEEE Trans. Robotics and
Automation 13, 1997). What is maximised is the determinant of the information on base parameters and friction together, the logs at hand
included: what they leave open counts most. Slopes are exact; limits are kept by a penalty and, in the end, by amplitudes that are made
smaller until a fine sampling stays inside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import fill
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import null_space
from scipy.optimize import minimize

from greybox.base import DataError, write_file
from greybox.base.values import ReadOnly
from greybox.data.experiment import Experiment
from greybox.extensions.robot.base_parameters import BaseParameters, find_base_parameters
from greybox.extensions.robot.description import Robot
from greybox.extensions.robot.motion import reconstruct_motion
from greybox.extensions.robot.rigid_body import evaluate_rows

# Samples of the shortest period in a search, and how many times finer the limits are checked.
SAMPLES_A_PERIOD, FINER = 12, 10
# Speed below which friction is viscous in a search, as a share of a joint's largest: a sign has no slope.
WIDTH = 0.05
# Weight of the squares beyond a limit, in limits; searches, each from another random motion; steps of each.
PENALTY, STARTS, STEPS = 1e4, 4, 150
# A limit is aimed at from inside by this share.
MARGIN = 0.02
# Limits of an axis of which the description states none: rad or m either way, per s, per s^2, and any torque.
USUAL_LIMITS = {"lower": -np.pi, "upper": np.pi, "speed": 2.0, "acceleration": 10.0, "effort": np.inf}
# Information that is there without any log, as a share of what a motion gives: the determinant of less is zero.
NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class MotionDesign(ReadOnly):
    """A motion to record next.

    Parameters
    ----------
    time
        Times (N,) in s of one period; it may be repeated.
    q, dq, ddq, tau
        Positions, velocities, accelerations and the torques to expect (N, n).
    units
        Of the positions (n,).
    names
        The base parameters (B,).
    before, after
        Standard errors (B,) with the logs at hand, infinite where they tell nothing, and with one period of this motion beside them; for
        white noise. Without logs ``before`` is that of a random motion inside the same limits.
    beside
        Which of these ``before`` is.
    """

    time: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray
    units: tuple[str, ...]
    names: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray
    beside: str

    @property
    def shrinking(self) -> np.ndarray:
        """By which factor (B,) each interval becomes narrower."""
        return np.asarray(self.before / self.after)

    def __str__(self) -> str:
        gains, worst = self.shrinking, int(np.argmax(self.before / np.abs(self.after)))
        first = (
            f"{self.time[-1]:.3g} s of this motion make the intervals of {len(gains)} base parameters {np.median(gains):.3g} times narrower"
            f" than {self.beside} (median; {self.names[worst]}: {gains[worst]:.3g} times)"
        )
        rows = [f"  {n:8} {b:.3g} -> {a:.3g}" for n, b, a in zip(self.names, self.before, self.after, strict=True)]
        return "\n".join([fill(first, 80), "  standard errors", *rows])

    def to_data(self) -> dict[str, Any]:
        """What a program wants of it."""
        errors = {n: {"before": b, "after": a} for n, b, a in zip(self.names, self.before, self.after, strict=True)}
        return {"seconds": self.time[-1], "beside": self.beside, "standard_errors": errors}

    def write_csv(self, path: str | Path) -> Path:
        """Write time, positions, velocities and accelerations as a CSV file."""
        rates = (("q", ""), ("dq", "/s"), ("ddq", "/s^2"))
        columns = [f"{s}{k} [{unit}{per}]" for s, per in rates for k, unit in enumerate(self.units, 1)]
        rows = np.column_stack([self.time, self.q, self.dq, self.ddq])
        lines = [",".join(["time [s]", *columns]), *(",".join(f"{v:.9g}" for v in row) for row in rows)]
        return write_file(Path(path), "\n".join([*lines, ""]))


def design_motion(
    robot: Robot,
    logs: Sequence[Experiment] = (),
    *,
    noise: Mapping[str, float] | float = 1.0,
    seconds: float = 10.0,
    harmonics: int = 5,
    rate: float = 100.0,
    limits: Mapping[str, Mapping[str, float]] | None = None,
    seed: int = 0,
) -> MotionDesign:
    """Find the motion that tells most of the base parameters beside what the logs tell already.

    Parameters
    ----------
    robot
        The robot; its limits of position, speed and torque are kept.
    logs
        Records at hand.
    noise
        Standard deviation of what is left of the torques, in N m or N: of all axes, or by the name of the joint.
    seconds, harmonics
        Period of the motion, and how many multiples of its frequency it has.
    rate
        Rows a second of the record to come.
    limits
        Joint -> ``lower``, ``upper`` (rad or m), ``speed``, ``acceleration``, ``effort`` (N m or N) in the place of the description's.
    seed
        Of the motions that searches begin from.

    Returns
    -------
    MotionDesign
        The motion, inside its limits on a sampling ten times finer than that of the search.

    Raises
    ------
    DataError
        Where holding still in the middle of its limits breaks one.
    """
    search = MotionSearch(find_base_parameters(robot), noise, (seconds, harmonics, rate), limits or {}, logs)
    generator = np.random.default_rng(seed)
    starts = [search.shrink(search.random(generator)) for _ in range(STARTS)]
    ends = [minimize(search.evaluate, x, jac=True, method="L-BFGS-B", options={"maxiter": STEPS}).x for x in starts]
    best = max((search.shrink(x) for x in ends), key=lambda x: float(np.linalg.slogdet(search.inform(x))[1]))
    return search.conclude(best, starts[0])


class MotionSearch:
    """Information and limits of motions; ``x`` (m n,) are the series' coefficients of all axes, the constants first, that begin at rest."""

    def __init__(
        self,
        base: BaseParameters,
        noise: Mapping[str, float] | float,
        course: tuple[float, int, float],
        limits: Mapping[str, Mapping[str, float]],
        logs: Sequence[Experiment],
    ) -> None:
        self.base, self.axes, self.count = base, base.robot.axes, len(base.robot.axes)
        self.period, self.harmonics, self.rate = course
        stated = {n: np.array([getattr(j, n, np.inf) for j in self.axes]) for n in USUAL_LIMITS}
        self.limits = {n: np.where(np.isfinite(v), v, USUAL_LIMITS[n]) for n, v in stated.items()}
        for k, joint in enumerate(self.axes):
            for name, value in limits.get(joint.name, {}).items():
                self.limits[name][k] = value
        sizes = [noise if isinstance(noise, int | float) else noise[j.name] for j in self.axes]
        self.weights = 1 / np.array(sizes, float) ** 2
        # What friction the description states is in the torques; the rest of it is not known.
        joints = [[j.damping for j in self.axes], [j.friction for j in self.axes], [0.0] * self.count]
        self.constants = np.concatenate([base.values, *joints])
        self.middle = (self.limits["lower"] + self.limits["upper"]) / 2
        self.reach = (self.limits["upper"] - self.limits["lower"]) / 2
        self.width = WIDTH * self.limits["speed"]
        coarse = SAMPLES_A_PERIOD * self.harmonics
        self.coarse, self.fine = (self.series(np.arange(k) * self.period / k) for k in (coarse, FINER * coarse))
        self.known = sum((self.inform_log(log) for log in logs), np.zeros((len(self.constants),) * 2))
        self.floor = np.zeros_like(self.known)
        diagonal = np.diag(self.inform(self.random(np.random.default_rng(0))))
        self.floor = NOTHING * np.diag(diagonal)

    def series(self, time: np.ndarray) -> np.ndarray:
        """Positions, velocities and accelerations (3, N, m) of unit coefficients."""
        w = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        sin, cos, zero = np.sin(np.outer(time, w)), np.cos(np.outer(time, w)), np.zeros((len(time), 1))
        # It begins at rest: sum h a_h = 0 and sum h^2 b_h = 0.
        rest = [null_space(w[None]), null_space(w[None] ** 2)]
        rows = ((sin, cos, 1.0), (w * cos, -w * sin, 0.0), (-(w**2) * sin, -(w**2) * cos, 0.0))
        return np.array([np.hstack([zero + one, a @ rest[0], b @ rest[1]]) for a, b, one in rows])

    def move(self, x: np.ndarray, series: np.ndarray) -> np.ndarray:
        """Positions, velocities and accelerations (3, N, n)."""
        motion = series @ (x.reshape(-1, self.count) * self.reach)
        motion[0] += self.middle
        return np.asarray(motion)

    def random(self, generator: np.random.Generator) -> np.ndarray:
        """A motion that the search begins from: beyond its limits, so that it is made as large as they allow."""
        return generator.normal(size=(self.coarse.shape[2], self.count)).ravel()

    def columns(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """What each constant adds to each torque (N, n, P): base parameters, viscous and dry friction and offset of each axis."""
        n, each = self.count, np.arange(self.count)
        joints = np.zeros((len(q), n, 3 * n))
        joints[:, each, each], joints[:, each, n + each] = dq, np.tanh(dq / self.width)
        joints[:, each, 2 * n + each] = 1.0
        return np.concatenate([evaluate_rows(self.base.regressor, q, dq, ddq), joints], axis=2)

    def inform(self, x: np.ndarray) -> np.ndarray:
        """Information (P, P) of the logs and one period."""
        return self.weigh(self.columns(*self.move(x, self.coarse)))

    def weigh(self, Y: np.ndarray) -> np.ndarray:
        """Information (P, P) of the logs and one period of a motion with columns (N, n, P)."""
        return self.known + self.floor + self.period * self.rate / len(Y) * self.multiply(Y)

    def multiply(self, Y: np.ndarray) -> np.ndarray:
        """Weighed products (P, P) of columns (N, n, P), summed over rows and axes."""
        weighed = (np.sqrt(self.weights)[:, None] * Y).reshape(-1, Y.shape[2])
        return np.asarray(weighed.T @ weighed)

    def inform_log(self, log: Experiment) -> np.ndarray:
        """Information (P, P) of a log."""
        motion = reconstruct_motion(log, range(1, self.count + 1))
        Y = self.columns(motion.q, motion.dq, motion.ddq) * (motion.is_moving & np.isfinite(motion.tau))[:, :, None]
        return self.multiply(Y)

    @cached_property
    def slopes(self) -> ca.Function:
        """``(q, dq, ddq, G) -> d sum(G * Y) / d (q, dq, ddq)``, Y the regressor of the base parameters."""
        motion = [ca.SX.sym(name, self.count) for name in ("q", "dq", "ddq")]
        G = ca.SX.sym("G", self.count * len(self.base.names))
        total = ca.dot(G, ca.vec(self.base.regressor(*motion).T))
        return ca.Function("slopes", [*motion, G], [ca.densify(ca.gradient(total, ca.vertcat(*motion)))])

    def evaluate(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """What is minimised, and its slopes: ``-log det M`` and the squares of what is beyond a limit."""
        motion = self.move(x, self.coarse)
        Y, count, B = self.columns(*motion), len(motion[0]), len(self.base.names)
        M = self.weigh(Y)
        scale = 1 / np.sqrt(np.diag(M))
        inverse = scale[:, None] * np.linalg.inv(scale[:, None] * M * scale) * scale
        # d(-log det M) = -2 sum tr(M^-1 Y' W dY)
        G = -2 * self.period * self.rate / count * self.weights[:, None] * (Y @ inverse)
        cost, slope = -float(np.linalg.slogdet(M)[1]), np.zeros_like(motion)
        for k, (center, most) in enumerate(self.bounds()):
            over, side = _beyond((motion[k] - center) / most)
            cost += PENALTY / count * float((over**2).sum())
            slope[k] += 2 * PENALTY / count * over * side / most
        over, side = _beyond((Y @ self.constants) / self.limits["effort"])
        cost += PENALTY / count * float((over**2).sum())
        G += (2 * PENALTY / count * over * side / self.limits["effort"])[:, :, None] * self.constants
        of_rigid = evaluate_rows(self.slopes, *motion, G[:, :, :B].reshape(count, -1))
        slope += of_rigid.reshape(count, 3, -1).transpose(1, 0, 2)
        each = np.arange(self.count)
        # d tanh(v / v0) / dv
        dry = (1 - Y[:, each, B + self.count + each] ** 2) / self.width
        slope[1] += G[:, each, B + each] + G[:, each, B + self.count + each] * dry
        return cost, (np.einsum("kjm,kji->mi", self.coarse, slope) * self.reach).ravel()

    def bounds(self) -> tuple[tuple[np.ndarray | float, np.ndarray], ...]:
        """Middle and largest deviation of positions, velocities and accelerations."""
        return (self.middle, self.reach), (0.0, self.limits["speed"]), (0.0, self.limits["acceleration"])

    def shrink(self, x: np.ndarray) -> np.ndarray:
        """The motion with amplitudes as large as the limits allow on the fine sampling. Raises DataError where none are."""
        x = x.reshape(-1, self.count).copy()
        still = np.zeros_like(x)
        still[0] = np.clip(x[0], MARGIN - 1, 1 - MARGIN)
        if self.worst(0 * still) > 1:
            raise DataError(f"robot {self.base.robot.name!r}: holding still in the middle of its limits takes more than its efforts; give"
                            " limits of position about a pose that it can hold")  # fmt: skip
        # Where the middle of the motion cannot be held, it comes nearer to that of the limits.
        still = self.reach_for(0 * still, still)
        moving = x.copy()
        moving[0] = still[0]
        return self.reach_for(still, moving).ravel()

    def reach_for(self, inside: np.ndarray, x: np.ndarray) -> np.ndarray:
        """As far from a motion that is ``inside`` its limits towards ``x`` as they allow."""
        if self.worst(x) <= 1:
            return x
        low, high = 0.0, 1.0
        for _ in range(20):
            share = (low + high) / 2
            low, high = (share, high) if self.worst(inside + share * (x - inside)) <= 1 else (low, share)
        return np.asarray(inside + low * (x - inside))

    def worst(self, x: np.ndarray) -> float:
        """The largest of all quantities over its limit, on the fine sampling."""
        motion = self.move(x.ravel(), self.fine)
        moved = [np.abs((motion[k] - center) / most).max() for k, (center, most) in enumerate(self.bounds())]
        return float(max(*moved, np.abs(self.columns(*motion) @ self.constants / self.limits["effort"]).max()))

    def conclude(self, x: np.ndarray, other: np.ndarray) -> MotionDesign:
        """The design, beside the logs, or beside an ``other`` motion where there are none."""
        time = np.arange(round(self.period * self.rate) + 1) / self.rate
        q, dq, ddq = motion = self.move(x, self.series(time))
        B, logged = len(self.base.names), bool(self.known.any())
        before = _errors(self.known if logged else self.inform(other))[:B]
        beside = "the logs alone" if logged else "a random motion inside the same limits"
        tau = self.columns(*motion) @ self.constants
        units = tuple(j.units["q"] for j in self.axes)
        return MotionDesign(time, q, dq, ddq, tau, units, self.base.names, before, _errors(self.inform(x))[:B], beside)


def _beyond(ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By how much ratios of a quantity and its limit are beyond what is aimed at, and on which side."""
    return np.maximum(np.abs(ratio) - (1 - MARGIN), 0.0), np.sign(ratio)


def _errors(information: np.ndarray) -> np.ndarray:
    """Standard errors (P,); infinite where the information says nothing."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(scale[:, None] * information * scale)
    seen = values > 1e-11 * values[-1]
    variances = (vectors[:, seen] ** 2 / values[seen]).sum(axis=1)
    variances[(vectors[:, ~seen] ** 2).sum(axis=1) > 1e-6] = np.inf
    return np.asarray(scale * np.sqrt(variances))
