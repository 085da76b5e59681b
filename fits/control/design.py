"""One way to design a controller from any linear model: LQR with integral action, and an observer, through python-control.

The plant is one input `u` and one output `y`, sampled, as a `control.StateSpace`::

    x[k+1] = A x + B u,    y = C x + D u,    q[k+1] = q + T (y - y_m)

- The model is led from rest to the target `r` by its own linear-quadratic regulator, `u_m = u_1 r - K_m (x_m - x_1 r)`, with the
  steady state `x_1, u_1` per unit of the output: this is the motion that is wanted, `y_m = C x_m`.
- The plant is held to it by `u = u_m - K (xh - x_m) - k q` (linear-quadratic with an integral), with `xh` from a Kalman observer.
- Known dry friction is compensated: a force `f` against the motion is met by the state and input `x_f f, u_f f` in which the model
  stands still under it, in the direction in which the body moves or should move; the observer is told of it, too.

The weights are sizes of output and input, not of states, so that the same rule serves physical and black-box models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import control
import numpy as np

from greybox.estimation.linear.linearisation import Linearisation, minimal_realisation
from greybox.extensions.export.python_control import to_state_space

# Frequencies per decade, and decades below half the sampling rate, at which a margin over many plants is looked up.
GRID = np.geomspace(1e-4, 1.0, 400)


@dataclass(frozen=True)
class Weights:
    """What counts as equally bad: ``error`` of the output, ``integral`` of it (in its unit times seconds), ``effort`` in volt.

    ``shock``: standard deviation in volt of what disturbs the plant at its input in each sample, ``noise`` that of the sensor.
    """

    error: float
    integral: float
    effort: float
    shock: float
    noise: float


@dataclass(frozen=True)
class Compensation:
    """Dry friction ``level(speed)`` [N], against the motion; ``speed`` (nx,) picks the velocity out of the state.

    ``force`` (nx,): what a newton adds to the next state. The push against friction has its level and the direction
    ``tanh((v_m + rate * (y_m - yh)) / slow)``: that in which the model moves, and once it stands, that towards the target, ``yh``
    being the position as the observer has it. ``slow`` in the unit of the speed, ``rate`` in 1/s.
    """

    level: Callable[[float], float]
    speed: np.ndarray
    force: np.ndarray
    slow: float
    rate: float


@dataclass(frozen=True, eq=False)
class Design:
    """A controller: the model it stands on, gains ``K``, ``integral``, ``lead`` (K_m), ``observer`` (L), steady states per unit."""

    name: str
    plant: Any
    K: np.ndarray
    integral: float
    lead: np.ndarray
    observer: np.ndarray
    x1: np.ndarray
    u1: float
    limit: float
    compensation: Compensation | None = None
    xf: np.ndarray | None = None
    uf: float = 0.0

    def controller(self) -> Any:
        """What the loop is closed with, from `y` to `u`, as a sampled `control.StateSpace` (the wanted motion at rest)."""
        s, nx, T = self.plant, self.plant.nstates, self.plant.dt
        gain = np.append(self.K, self.integral)[None, :]
        L = self.observer[:, None]
        A = np.zeros((nx + 1, nx + 1))
        A[:nx, :nx], A[nx, nx] = s.A - L @ s.C, 1.0
        A -= np.vstack([s.B - L @ s.D, [[0.0]]]) @ gain
        return control.ss(A, np.vstack([L, [[T]]]), -gain, [[0.0]], T, inputs=["y"], outputs=["u"])

    def loop(self, plant: Any) -> Any:
        """The open loop at the plant's input, with the sign that margins are read with."""
        return -control.ss(plant) * self.controller()


def design(name: str, plant: Any, weights: Weights, limit: float, compensation: Compensation | None = None) -> Design:
    """The controller of ``plant`` (one input, one output, sampled) with these ``weights``; ``limit`` of the input in volt."""
    A, B, C, D, T = plant.A, plant.B, plant.C, plant.D, plant.dt
    nx = len(A)
    whole = np.block([[A, np.zeros((nx, 1))], [T * C, np.ones((1, 1))]])
    cost = np.zeros((nx + 1, nx + 1))
    cost[:nx, :nx], cost[nx, nx] = C.T @ C / weights.error**2, 1 / weights.integral**2
    effort = np.array([[1 / weights.effort**2]])
    K = control.dlqr(whole, np.vstack([B, T * D]), cost, effort)[0]
    lead = control.dlqr(A, B, cost[:nx, :nx], effort)[0]
    observer = control.dlqe(A, B, C, np.array([[weights.shock**2]]), np.array([[weights.noise**2]]))[0]
    x1, u1 = standstill(plant, np.zeros(nx), 1.0)
    made = Design(name, plant, K[0, :nx], K[0, nx], lead[0], observer[:, 0], x1, u1, limit)
    if compensation is None:
        return made
    xf, uf = standstill(plant, -compensation.force, 0.0)
    return replace(made, compensation=compensation, xf=xf, uf=uf)


def standstill(plant: Any, disturbance: np.ndarray, target: float) -> tuple[np.ndarray, float]:
    """State and input in which ``plant`` stands still with its output at ``target``, under a ``disturbance`` (nx,) of each step."""
    nx = plant.nstates
    matrix = np.block([[plant.A - np.eye(nx), plant.B], [plant.C, plant.D]])
    solution = np.linalg.solve(matrix, np.append(-disturbance, target))
    return solution[:nx], float(solution[nx])


def with_force(linear: Linearisation, body: str, mass: float) -> Linearisation:
    """A continuous ``linear`` model with a second input: a force in newton on the body whose velocity is the state ``body``."""
    push = np.zeros((len(linear.A), 1))
    push[linear.state_names.index(body)] = 1 / mass
    zero = np.zeros(1)
    return replace(
        linear,
        B=np.hstack([linear.B, push]),
        D=np.hstack([linear.D, np.zeros((len(linear.C), 1))]),
        input_names=(*linear.input_names, "force"),
        input_units=(*linear.input_units, "N"),
        u0=np.append(linear.u0, zero),
        delay=np.append(linear.delay, zero),
    )


def channel(linear: Linearisation, output: str) -> Linearisation:
    """From the first input to one output, without states that this input does not reach or this output does not show."""
    row = linear.output_names.index(output)
    single = replace(
        linear,
        B=linear.B[:, :1],
        C=linear.C[[row]],
        D=linear.D[[row], :1],
        input_names=linear.input_names[:1],
        input_units=linear.input_units[:1],
        output_names=(output,),
        output_units=(linear.output_units[row],),
        u0=linear.u0[:1],
        y0=linear.y0[[row]],
        delay=linear.delay[:1],
    )
    return minimal_realisation(single)


@dataclass(frozen=True)
class Margins:
    """Gain margin (a factor), phase margin in degrees, and the least distance of the loop from -1 (1 over the peak of sensitivity)."""

    gain: float
    phase: float
    distance: float
    stable: bool


def margins(made: Design, plant: Any) -> Margins:
    """Those of ``made`` on ``plant``, by `control.stability_margins`; none of them means anything unless ``stable``."""
    loop = made.loop(plant)
    stable = bool(np.all(np.abs(control.feedback(loop, 1).poles()) < 1))
    gain, phase, distance = control.stability_margins(loop.frequency_response(GRID * np.pi / loop.dt))[:3]
    return Margins(float(gain), float(phase), float(distance), stable)


def closest(made: Design, output: str, period: float) -> Callable[[Linearisation], float]:
    """Least distance of the loop from -1, as a function of the plant's linear model; negative where the loop is unstable."""
    omega = GRID * np.pi / period
    reply = made.controller()(np.exp(1j * omega * period))

    def near(linear: Linearisation) -> float:
        plant = channel(linear, output)
        size = float(np.abs(1 - plant.frequency_response(omega)[:, 0, 0] * reply).min())
        stable = np.all(np.abs(control.feedback(made.loop(to_state_space(plant)), 1).poles()) < 1)
        return size if stable else -size

    return near
