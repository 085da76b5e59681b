"""Where something may be missing in a model, and how an unknown signal there reaches the sensors.

The fitted model is linearised along its own run: ``d x_{k+1} = Phi_k d x_k + Gamma_k w_k``, ``d y_k = C_k d x_k``, with ``w`` held between
samples. Dry friction has no slope and is left out, and so is what an effect sets after each step (play) or delays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.discovery.problem import CandidateFit
from greybox.model import Model, System
from greybox.transcription import SingleShooting

BALANCE, INPUT, SENSOR = "balance", "input", "sensor"
# Two ways into a model count as one where their directions agree to this.
SAME = 1e-9


@dataclass(frozen=True)
class DisturbanceSite:
    """A balance, an input or a sensor of a model: its ``name``, ``kind`` and the ``unit`` of what may be missing there.

    ``column``: position of the balance's state, of the input or of the output.
    """

    name: str
    kind: str
    unit: str
    column: int

    def __str__(self) -> str:
        return f"{self.kind} {self.name}" if self.kind != SENSOR else f"sensor of {self.name}"


@dataclass(frozen=True, eq=False)
class LinearisedRun:
    """The model along rows ``first`` to ``first + R`` of one record.

    ``phi`` (R-1, nx, nx), ``c`` (R, ny, nx), and for each place ``gamma`` (R-1, nx), zero for sensors; ``x`` (R, nx) and ``u`` (R, nu)
    are the run and its inputs, ``time`` (R,) in seconds. A time-invariant model has one entry instead of R of ``phi``, ``c`` and ``gamma``.
    """

    record: int
    first: int
    time: np.ndarray
    x: np.ndarray
    u: np.ndarray
    phi: np.ndarray
    c: np.ndarray
    gamma: dict[DisturbanceSite, np.ndarray]

    @property
    def rows(self) -> int:
        """Samples in the stretch."""
        return len(self.time)


def list_disturbance_sites(model: Model, measured: Sequence[str]) -> list[DisturbanceSite]:
    """Every balance of the plant in which something can be missing, every input, and the sensor of every output in ``measured``."""
    system, plant = model.system, {s.name for s in model.states}
    found = [
        DisturbanceSite(b.name, BALANCE, b.unit, system.state_names.index(b.state))
        for b in system.balances
        if b.state in plant and not _is_definition(system, b.state)
    ]
    found += [DisturbanceSite(i.name, INPUT, i.unit, k) for k, i in enumerate(model.inputs)]
    return found + [
        DisturbanceSite(o.name, SENSOR, o.unit, k) for k, o in enumerate(model.outputs) if o.name in measured
    ]


def linearise_run(trial: CandidateFit, record: int, first: int, rows: int) -> LinearisedRun:
    """``trial``'s model along a stretch of one of its records."""
    problem, model = trial.problem, trial.model
    system, seen = model.system, problem.records[record]
    run = unwhitened_shooting(trial).simulate(np.zeros(trial.variables.size))[record]
    # A delayed input widens the kernel's record; the linearisation speaks of the input at hand.
    stretch = slice(first, first + rows)
    x, u = seen.samples(run[1])[stretch], seen.samples(seen.u)[stretch]
    time = problem.experiments[record].time[stretch]
    p = trial.variables.parameters(np.zeros(trial.variables.size), record)
    ways = list_disturbance_sites(model, [o.name for o in model.outputs])
    a, b, c, storage = _slopes(system, x, u, p)
    steps = np.diff(time)
    if len(a) == 1 and np.allclose(steps, steps[0], rtol=1e-6):
        steps = steps[:1]
    count = max(len(steps), 1)
    entering = {w: _direction(w, b, storage) for w in ways if w.kind != SENSOR}
    block = np.zeros((count, x.shape[1] + len(entering), x.shape[1] + len(entering)))
    block[:, : x.shape[1], : x.shape[1]] = (a[:-1] if len(a) > 1 else a) * steps[:, None, None]
    for k, way in enumerate(entering.values()):
        block[:, : x.shape[1], x.shape[1] + k] = (way[:-1] if len(way) > 1 else way) * steps[:, None]
    moved = expm(block)
    gamma = {w: moved[:, : x.shape[1], x.shape[1] + k] for k, w in enumerate(entering)}
    gamma |= {w: np.zeros((1, x.shape[1])) for w in ways if w.kind == SENSOR}
    return LinearisedRun(record, first, time, x, u, moved[:, : x.shape[1], : x.shape[1]], c, gamma)


def unwhitened_shooting(trial: CandidateFit) -> SingleShooting:
    """The trial's residuals in units of the noise, not whitened."""
    problem = trial.problem
    return SingleShooting(trial.variables, problem.step, problem.kernel, problem.records, 1 / problem.noise.std)


def are_indistinguishable(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two ways in (R, nx) differ by a factor only: then no sensor can tell them apart."""
    if one.shape != other.shape or not (one.any() and other.any()):
        return False
    a, b = one / np.linalg.norm(one), other / np.linalg.norm(other)
    return bool(min(np.abs(a - b).max(), np.abs(a + b).max()) < SAME)


def _slopes(
    system: System, x: np.ndarray, u: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``d rhs/dx`` (R, nx, nx), ``d rhs/du``, ``d y/dx`` and the storages (R, nx); one entry each for an affine model."""
    smooth = ca.substitute(system.rhs, system.direction, ca.SX.zeros(len(system.dry)))
    pieces = [
        ca.jacobian(smooth, system.x), ca.jacobian(smooth, system.u), ca.jacobian(system.outputs, system.x),
        system.storages,
    ]  # fmt: skip
    every = ca.vertcat(system.x, system.u)
    rows = slice(0, 1) if not any(ca.depends_on(m, every) for m in pieces) else slice(None)
    found = []
    for m in pieces:
        values = ca.Function("m", [system.x, system.u, system.p], [ca.vec(m.T)])(x[rows].T, u[rows].T, p).full().T
        found.append(np.nan_to_num(values).reshape(-1, *m.shape))
    return found[0], found[1], found[2], found[3][:, :, 0]


def _direction(place: DisturbanceSite, b: np.ndarray, storage: np.ndarray) -> np.ndarray:
    """What a unit at ``place`` does to the rates (R, nx)."""
    if place.kind == INPUT:
        return b[:, :, place.column]
    way = np.zeros_like(storage)
    way[:, place.column] = 1 / storage[:, place.column]
    return way


def _is_definition(system: System, state: str) -> bool:
    """Whether a balance only says what a rate is (``dx/dt = v``): nothing can be missing there."""
    return bool(system.rhs[system.state_names.index(state)].is_symbolic())
