"""A controller in closed loop with a rig of `fits.studies.rig_twins`, which integrates by itself with friction
that sticks; what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fits.control.design import Design
from fits.studies.rig_twins import Rig

# The last part of each rest, over which its error is averaged.
END = 0.25


@dataclass(frozen=True)
class Moves:
    """Targets, one after the other, each for ``hold`` seconds, ``rise`` of them on the way; within ``band`` of it counts as there."""

    targets: tuple[float, ...]
    hold: float
    rise: float
    band: float

    def reference(self, period: float) -> np.ndarray:
        """The target at each sample (N,)."""
        return np.repeat(self.targets, round(self.hold / period))

    def path(self, period: float) -> np.ndarray:
        """The way there at each sample (N,): half a cosine over ``rise`` seconds."""
        rows, before, parts = round(self.hold / period), 0.0, []
        share = np.minimum(period * np.arange(rows) / self.rise, 1.0)
        for target in self.targets:
            parts.append(before + (target - before) * (1 - np.cos(np.pi * share)) / 2)
            before = target
        return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class Run:
    """Time (N,) in seconds; ``position`` (N,) of the rig itself, ``wanted`` (N,) by the design, ``voltage`` (N,); ``target`` (N,)."""

    time: np.ndarray
    position: np.ndarray
    wanted: np.ndarray
    voltage: np.ndarray
    target: np.ndarray


@dataclass(frozen=True)
class Verdict:
    """Of one run: ``settling`` [s] of each move (infinite where it does not), ``overshoot`` of the worst as a share of the move,
    ``steady``: root mean square error at the ends of the rests, in the unit of the position."""

    settling: tuple[float, ...]
    overshoot: float
    steady: float

    @property
    def slowest(self) -> float:
        """Settling time of the slowest move."""
        return max(self.settling)


def closed_loop(rig: Rig, made: Design, moves: Moves, noise: float, seed: int = 0, fine: int = 10) -> Run:
    """``made`` on ``rig`` from rest, whose first output the controller reads with white ``noise``; ``fine`` steps a sample."""
    period = float(made.plant.dt)
    target = moves.reference(period)
    shaken = noise * np.random.default_rng(seed).standard_normal(len(target))
    hand, path = Hand(made, moves.band), moves.path(period)
    state: list[float] = [*rig.start_values(), *([0.0] * (len(rig.names) - len(rig.native_states)))]
    rows, u = np.empty((len(target), 3)), 0.0
    for k, wanted in enumerate(path):
        position = rig.outputs(k * period, state, rig.acting(u))[0]
        u = hand.voltage(position + shaken[k], float(wanted))
        rows[k] = position, hand.wanted, u
        acting = rig.acting(u)
        for _ in range(fine):
            state = rig.step(state, acting, period / fine)
    return Run(period * np.arange(len(target)), rows[:, 0], rows[:, 1], rows[:, 2], target)


class Hand:
    """The controller as it runs: reads a position, gives a voltage, remembers the model, the observer and the integral.

    The integral rests while the position is within half the ``band`` of what is wanted and while the voltage is at its limit; with a
    compensation also while the model stands still, where it would only store what the next reversal has to undo.
    """

    def __init__(self, made: Design, band: float) -> None:
        s = made.plant
        self.made, self.band, self.period = made, band, float(s.dt)
        self.A, self.B, self.C, self.D = s.A, s.B[:, 0], s.C[0], float(s.D[0, 0])
        self.model, self.seen, self.integral, self.wanted = np.zeros(len(self.A)), np.zeros(len(self.A)), 0.0, 0.0

    def voltage(self, position: float, target: float) -> float:
        """The voltage for the next sample."""
        m = self.made
        lead = m.u1 * target - m.lead @ (self.model - m.x1 * target)
        self.wanted = float(self.C @ self.model + self.D * lead)
        push, behind = self._against_friction(), position - self.wanted
        away = self.seen - self.model - (0.0 if m.xf is None else m.xf * push)
        u = lead + m.uf * push - m.K @ away - m.integral * self.integral
        held = float(np.clip(u, -m.limit, m.limit))
        if held == u and abs(behind) > self.band / 2 and not self._stands():
            self.integral += self.period * behind
        error = position - self.C @ self.seen - self.D * held
        ahead = self.A @ self.seen + self.B * held
        self.seen = ahead - self._taken_by_friction(ahead) + m.observer * error
        self.model = self.A @ self.model + self.B * lead
        return held

    def _against_friction(self) -> float:
        """The force to push with, in newton: in the direction of the wanted motion, and at its end towards the target."""
        c = self.made.compensation
        if c is None:
            return 0.0
        wanted, seen = float(c.speed @ self.model), float(c.speed @ self.seen)
        behind = float(self.C @ self.seen) - self.wanted
        return c.level(max(abs(wanted), abs(seen))) * float(np.tanh((wanted - c.rate * behind) / c.slow))

    def _taken_by_friction(self, ahead: np.ndarray) -> np.ndarray | float:
        """What friction takes from the next state: as much as stops the body, at most its level (Moreau's time stepping)."""
        c = self.made.compensation
        if c is None:
            return 0.0
        most = c.level(abs(float(c.speed @ self.seen)))
        return c.force * float(np.clip(c.speed @ ahead / (c.speed @ c.force), -most, most))

    def _stands(self) -> bool:
        c = self.made.compensation
        return c is not None and abs(float(c.speed @ self.model)) < c.slow


def judged(run: Run, moves: Moves) -> Verdict:
    """Settling times, overshoot and steady error of a run."""
    length = len(run.target) // len(moves.targets)
    settling, over, ends, before = [], 0.0, [], 0.0
    for k, target in enumerate(moves.targets):
        rows = slice(k * length, (k + 1) * length)
        error = run.position[rows] - target
        settling.append(settled(error, moves.band, float(run.time[1])))
        over = max(over, overshoot(error, target - before))
        ends.append(error[-round(END * length) :])
        before = target
    return Verdict(tuple(settling), over, float(np.sqrt(np.mean(np.square(ends)))))


def settled(error: Sequence[float] | np.ndarray, band: float, period: float) -> float:
    """Seconds after which ``error`` (N,) stays within ``band`` to the end; infinite if it is outside at the end."""
    outside = np.flatnonzero(~(np.abs(error) <= band))
    if not len(outside):
        return 0.0
    return float(period * (outside[-1] + 1)) if outside[-1] + 1 < len(error) else float("inf")


def overshoot(error: Sequence[float] | np.ndarray, move: float) -> float:
    """How far ``error`` (N,), position less target, goes beyond the target of a ``move``, as a share of that."""
    return max(0.0, float(np.max(np.asarray(error) * np.sign(move)))) / abs(move)
