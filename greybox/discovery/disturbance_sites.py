"""Where something may be missing in a model, and how an unknown signal there reaches the sensors.

The fitted model is linearised along its own run: ``d x_{k+1} = Phi_k d x_k + Gamma_k w_k``, ``d y_k = C_k d x_k``, with ``w`` held between
samples. Dry friction has no slope and is left out, and so is a delay. What an effect sets after each step (play) slides: held, it would
hide from its sensor all that drives it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import casadi as ca
import numpy as np
from scipy.linalg import expm

from greybox.discovery.problem import CandidateFit
from greybox.model import Model, System
from greybox.numerics import SAME_DIRECTION
from greybox.transcription import SingleShooting


class SiteKind(StrEnum):
    """What a disturbance may be added to."""

    BALANCE = "balance"
    INPUT = "input"
    SENSOR = "sensor"


def site_label(kind: str, name: str) -> str:
    """The name by which a site is known: ``balance force``, ``input u``, ``sensor of x``."""
    return f"{kind} {name}" if kind != SiteKind.SENSOR else f"sensor of {name}"


@dataclass(frozen=True)
class DisturbanceSite:
    """A balance, an input or a sensor of a model: its ``name``, ``kind`` and the ``unit`` of what may be missing there.

    ``column``: position of the balance's state, of the input or of the output.
    """

    name: str
    kind: SiteKind
    unit: str
    column: int

    @property
    def label(self) -> str:
        """The name by which the site is known in results."""
        return site_label(self.kind, self.name)


@dataclass(frozen=True, eq=False)
class LinearisedRun:
    """The model along rows ``first`` to ``first + R`` of one record.

    ``phi`` (R-1, nx, nx), ``c`` (R, ny, nx), and for each site ``gamma`` (R-1, nx), zero for sensors; ``x`` (R, nx) and ``u`` (R, nu)
    are the run and its inputs, ``time`` (R,) in seconds. A time-invariant model has one entry of ``phi``, ``c`` and ``gamma``, not R.
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
    sites = [
        DisturbanceSite(b.name, SiteKind.BALANCE, b.unit, system.state_names.index(b.state))
        for b in system.balances
        if b.state in plant and not _is_definition(system, b.state)
    ]
    sites += [DisturbanceSite(i.name, SiteKind.INPUT, i.unit, k) for k, i in enumerate(model.inputs)]
    return sites + [
        DisturbanceSite(o.name, SiteKind.SENSOR, o.unit, k) for k, o in enumerate(model.outputs) if o.name in measured
    ]


def linearise_run(candidate: CandidateFit, record: int, first: int, rows: int) -> LinearisedRun:
    """The candidate's model along a stretch of one of its records."""
    problem, model, variables = candidate.problem, candidate.model, candidate.variables
    system, measured = model.system, problem.records[record]
    run = unwhitened_shooting(candidate).simulate(variables.here)[record]
    # A delayed input widens the kernel's record; the linearisation is about the input as it is now.
    stretch = slice(first, first + rows)
    x, u = measured.samples(run[1])[stretch], measured.samples(measured.u)[stretch]
    time = problem.experiments[record].time[stretch]
    p = variables.parameters(variables.here, record)
    sites = list_disturbance_sites(model, [o.name for o in model.outputs])
    a, b, c, storage = _slopes(system, x, u, p)
    steps = np.diff(time)
    if len(a) == 1 and np.allclose(steps, steps[0], rtol=1e-6):
        steps = steps[:1]
    count = max(len(steps), 1)
    directions = {site: _direction(site, b, storage) for site in sites if site.kind != SiteKind.SENSOR}
    nx = x.shape[1]
    block = np.zeros((count, nx + len(directions), nx + len(directions)))
    block[:, :nx, :nx] = (a[:-1] if len(a) > 1 else a) * steps[:, None, None]
    for k, direction in enumerate(directions.values()):
        block[:, :nx, nx + k] = (direction[:-1] if len(direction) > 1 else direction) * steps[:, None]
    exponential = expm(block)
    gamma = {site: exponential[:, :nx, nx + k] for k, site in enumerate(directions)}
    gamma |= {site: np.zeros((1, nx)) for site in sites if site.kind == SiteKind.SENSOR}
    return LinearisedRun(record, first, time, x, u, exponential[:, :nx, :nx], c, gamma)


def unwhitened_shooting(candidate: CandidateFit) -> SingleShooting:
    """The candidate's residuals in units of the noise, not whitened."""
    return candidate.problem.with_plain_squares().shooting(candidate.variables)


def are_indistinguishable(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two input directions (R, nx) differ by a factor only: then no sensor can tell them apart."""
    if one.shape != other.shape or not (one.any() and other.any()):
        return False
    a, b = one / np.linalg.norm(one), other / np.linalg.norm(other)
    return bool(min(np.abs(a - b).max(), np.abs(a + b).max()) < SAME_DIRECTION)


def _let_slide(system: System, expression: ca.SX) -> ca.SX:
    """``expression`` with every state that is set after each step where that puts one from far away: at the end of its play."""
    for update in system.updates:
        state = system.x[update.state]
        expression = ca.substitute(expression, state, ca.substitute(update.value, state, ca.inf))
    return expression


def _slopes(
    system: System, x: np.ndarray, u: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``d rhs/dx`` (R, nx, nx), ``d rhs/du``, ``d y/dx`` and the storages (R, nx); one entry each for an affine model."""
    smooth = _let_slide(system, ca.substitute(system.rhs, system.direction, ca.SX.zeros(len(system.dry))))
    matrices = [
        ca.jacobian(smooth, system.x),
        ca.jacobian(smooth, system.u),
        ca.jacobian(_let_slide(system, system.outputs), system.x),
        system.storages,
    ]
    signals = ca.vertcat(system.x, system.u)
    rows = slice(0, 1) if not any(ca.depends_on(m, signals) for m in matrices) else slice(None)
    slopes = []
    for m in matrices:
        values = ca.Function("m", [system.x, system.u, system.p], [ca.vec(m.T)])(x[rows].T, u[rows].T, p).full().T
        slopes.append(np.nan_to_num(values).reshape(len(values), *m.shape))
    return slopes[0], slopes[1], slopes[2], slopes[3][:, :, 0]


def _direction(site: DisturbanceSite, b: np.ndarray, storage: np.ndarray) -> np.ndarray:
    """What a unit at ``site`` does to the rates (R, nx)."""
    if site.kind == SiteKind.INPUT:
        return b[:, :, site.column]
    direction = np.zeros_like(storage)
    direction[:, site.column] = 1 / storage[:, site.column]
    return direction


def _is_definition(system: System, state: str) -> bool:
    """Whether a balance only says what a rate is (``dx/dt = v``): nothing can be missing there."""
    return bool(system.rhs[system.state_names.index(state)].is_symbolic())
