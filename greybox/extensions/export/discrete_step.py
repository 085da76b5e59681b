"""One sampling interval of the nonlinear model, as the library itself steps it: what generated code and control systems run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.base.numerics import TINY
from greybox.estimation.linear.exported_model import ExportedModel, check_sampling_time
from greybox.model import Input, Model, Output, Parameter, State
from greybox.simulation.integrators.discretisation import choose_implicit_method, discretise, run_step
from greybox.simulation.integrators.step import Step

NO_ROWS = np.empty(0, int)


class SteppedSignals(NamedTuple):
    """What code has to know of a thing that it steps and that is no model: what people and code call it, its signals and its constants."""

    title: str
    name: str
    description: str
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    all_states: tuple[State, ...]
    all_parameters: tuple[Parameter, ...] = ()


@dataclass(frozen=True, eq=False)
class DiscreteStep:
    """``dt`` seconds of ``model`` with its inputs held, as ``step`` takes them; ``p`` (np,) constants, ``x0`` (nx,) state at rest.

    ``signals`` are those that code is written for, and ``start`` gives the state at rest from the constants. With a delayed input earlier
    inputs belong to the state: ``past`` of them, the latest first. An observer's step has ``measurements`` among its inputs.
    """

    model: Model
    step: Step
    dt: float
    p: np.ndarray
    x0: np.ndarray
    signals: Model | SteppedSignals
    start: ca.Function
    measurements: tuple[str, ...] = ()
    deviation: float = math.nan
    """Largest change of a state with half the step, as a share of its movement; NaN where that is not known."""

    @property
    def past(self) -> int:
        """How many earlier values of the delayed input are kept."""
        return self.step.past.rows if self.step.past is not None else 0

    @property
    def late_input(self) -> int:
        """The number of the delayed input, 0 where there is none."""
        return self.step.past.column if self.step.past is not None else 0

    def coefficients(self, p: np.ndarray | None = None) -> np.ndarray:
        """What ``step.advance`` needs to know of the constants (nq,)."""
        return self.step.coefficients(self.p if p is None else p, np.array([self.dt]), NO_ROWS)[0][0]

    def row(self, u: np.ndarray, past: np.ndarray, share: float = 0.0) -> np.ndarray:
        """Inputs as the step reads them: with the past, and the share of the interval that has gone by."""
        return np.concatenate([u, past, [share, 0.0, self.dt]]) if self.past else u

    def advance(self, x: np.ndarray, past: np.ndarray, u: np.ndarray, p: np.ndarray | None = None) -> np.ndarray:
        """The state (nx,) ``dt`` seconds later."""
        n = self.step.substeps
        shares = np.arange(n + 1) / n
        # The flag of a delayed input runs from 0 to 1 over the interval, as the rows of a record do.
        rows = np.array([self.row(u, past, share) for share in shares]).T
        # The same coefficients for each substep.
        q = np.tile(self.coefficients(p)[:, None], n)
        return self._substeps(x, rows[:, :-1], rows[:, 1:], q, np.full((1, n), self.dt / n)).full()[:, -1]

    def outputs(self, x: np.ndarray, past: np.ndarray, u: np.ndarray, p: np.ndarray | None = None) -> np.ndarray:
        """The outputs (ny,) at the beginning of the interval."""
        return self.step.outputs(x, self.row(u, past), self.p if p is None else p).full().ravel()

    @cached_property
    def _substeps(self) -> ca.Function:
        return self.step.advance.mapaccum(self.step.substeps)


# The step is halved until that changes a run over the estimation record by less than this share of its movement.
DISCRETE_STEP_PRECISION = 1e-07
# Rows of that record.
DISCRETE_STEP_ROWS = 2000


def make_discrete_step(
    plant: ExportedModel, dt: float | None = None, *, substeps: int = 0, method: str = "automatic"
) -> DiscreteStep:
    """The sampling interval of ``plant``: ``dt`` seconds, or that of the fitted records.

    ``substeps`` 0: as many as it takes that halving them changes nothing visible over the fitted record (for a model without a fit:
    over a step of every input).

    Raises ModelError for a sampling time that is not above zero or not known.
    """
    from greybox.simulation.simulate import declared_initial_state

    # Of the fitted records where none is given: the model was judged at that one.
    period = plant.sampling_time if dt is None else dt
    if period is None:
        raise ModelError(f"{plant.model.title}: no sampling time is known; give dt in seconds")
    check_sampling_time(period)
    # With every constant known a delay is as long as it is, not as long as its bounds allow.
    known = plant.model.fix(*plant.model.values)
    system, p, x0 = known.system, plant.p, declared_initial_state(known)
    chosen: dict[str, Any] = {"substeps": substeps}
    record = plant.record
    if not substeps and record is not None and plant.model.inputs:
        # Inputs of the first fitted record, held at every ``dt``. The one at each time is taken a little later, so that a time equal to
        # a sample but for rounding takes that sample.
        elapsed = record.time - record.time[0]
        count = min(int((record.time[-1] - record.time[0]) / period) + 1, DISCRETE_STEP_ROWS)
        rows = np.searchsorted(elapsed, np.arange(count) * period * (1 + 1e-12), side="right") - 1
        inputs = np.column_stack([record.inputs[i.name][rows] for i in plant.model.inputs])
        chosen = {"target": DISCRETE_STEP_PRECISION, "inputs": inputs}
    make = partial(discretise, system, p, x0[None, :], np.array([float(period)]), method=method, written_out=True)
    step = make(**chosen)
    if not (step.per_interval or substeps or "inputs" in chosen):
        # Stable, but a step of every input shows how short it must be to be right.
        chosen = {"target": DISCRETE_STEP_PRECISION, "inputs": np.ones((TRIED_ROWS, system.u.numel()))}
        step = make(**chosen)
    start = ca.Function("start", [system.p], [ca.densify(system.start)])
    deviation = _try_out(known, step, p, x0, chosen.get("inputs"), float(period))
    return DiscreteStep(known, step, float(period), p, x0, known, start, deviation=deviation)


# Rows over which a model without a record is tried out, every input at one from the first on.
TRIED_ROWS = 100


def _try_out(model: Model, step: Step, p: np.ndarray, x0: np.ndarray, inputs: np.ndarray | None, dt: float) -> float:
    """Largest change of a state (rms, over its movement) with half the step, over ``inputs`` (N, nu) or a step of every input.

    Raises ModelError where the run overflows and that with shorter steps does not.
    """
    if step.per_interval:
        return 0.0
    given = np.ones((TRIED_ROWS, model.system.u.numel())) if inputs is None else inputs
    lengths = np.array([dt])

    def follow(method: str, substeps: int) -> np.ndarray:
        finer = discretise(model.system, p, x0[None, :], lengths, method=method, substeps=substeps, written_out=True)
        return run_step(finer, p, x0, given, dt)

    path = run_step(step, p, x0, given, dt)
    if not np.isfinite(path).all():
        method = choose_implicit_method(model.system, written_out=True)
        whole = np.isfinite(follow(method, IMPLICIT_SUBSTEPS)).all(axis=1) if method else np.zeros(len(path), bool)
        lost = np.flatnonzero(whole & ~np.isfinite(path).all(axis=1))
        if len(lost):
            raise ModelError(
                f"{model.title}: one step of {dt:g} s by {step.label} overflows after {lost[0] * dt:g} s, where shorter steps go on;"
                " give a smaller dt, without substeps"
            )
        return math.nan
    finer = run_step(replace(step, substeps=2 * step.substeps), p, x0, given, dt)
    change, movement = (np.sqrt(np.mean(v**2, axis=0)) for v in (finer - path, finer - finer[0]))
    return float(np.max(change / np.maximum(movement, TINY), initial=0.0, where=movement > 0))


# Substeps of the implicit run that a run which overflows is held against.
IMPLICIT_SUBSTEPS = 16


def refuse_discontinuous(model: Model) -> None:
    """Raise ModelError for effects that ordinary differential equations cannot hold, each with the reason."""
    s = model.system
    beyond = [
        *(f"{d.effect} (it sticks: the velocity stays at zero for a while)" for d in s.dry),
        *(f"{u.effect} (its state {s.state_names[u.state]!r} is set, it has no rate)" for u in s.updates),
        *(f"{d.effect} (it needs earlier values of the input)" for d in s.delays),
    ]
    if beyond:
        raise ModelError(
            f"{model.title} is not an ordinary differential equation: {', '.join(beyond)}; give dt for a sampled system that contains it"
        )


def find_delay_parameters(model: Model) -> list[str]:
    """Names of the constants on which a delay depends: how many earlier inputs are kept hangs on them."""
    symbols = ca.symvar(ca.vertcat(*[d.seconds for d in model.system.delays], ca.SX(0, 1)))
    return [symbol.name() for symbol in symbols]


def name_past_inputs(interval: DiscreteStep) -> list[str]:
    """Names of the earlier inputs: ``u_1``, ``u_2`` ... samples ago."""
    if not interval.past:
        return []
    name = interval.model.inputs[interval.late_input].name
    return [f"{name}_{k + 1}" for k in range(interval.past)]
