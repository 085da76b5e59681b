"""A free run of equations, its step halved until nothing visible changes; the slopes along it, and where it comes to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from greybox.base.errors import ModelError
from greybox.model import Model, System
from greybox.simulation.integrators.discretisation import (
    ADAPTIVE,
    DiscretisationPolicy,
    choose_implicit_method,
    choose_substeps,
    discretise,
    follow_step,
)
from greybox.simulation.integrators.esdirk import esdirk
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.adaptive import AdaptiveKernel
from greybox.simulation.kernel.interface import Kernel, check_arguments
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record


@dataclass(frozen=True)
class SimulationPolicy:
    """How fine a model is integrated."""

    max_halvings: int = 6
    """Most halvings; a run that still changes is returned as it is."""
    discretisation: DiscretisationPolicy = field(default_factory=DiscretisationPolicy)
    """How the first step is chosen; that of `EstimationPolicy` simulates as a fit does."""


SIMULATION_POLICY = SimulationPolicy()


# The step is halved until that changes no output by more than this share of its movement (rms).
MAX_CHANGE = 1e-06


def run_freely(
    model: Model,
    record: Record,
    p: np.ndarray,
    x0: np.ndarray,
    *,
    method: str = "automatic",
    substeps: int = 0,
    policy: SimulationPolicy = SIMULATION_POLICY,
) -> tuple[np.ndarray, np.ndarray, Step]:
    """Outputs (N, ny) and states (N, nx) of a model with equations from the state ``x0`` on, and how it was integrated."""
    step = discretise(
        model.system, p, x0[None, :], record.lengths, method=method, substeps=substeps, policy=policy.discretisation
    )
    kernel = make_kernel(step, ())
    y, x = _run(kernel, step, record, p, x0)
    is_settled = bool(substeps or step.per_interval)
    for _ in range(0 if is_settled else policy.max_halvings):
        # Some ten states along the run: the first guess saw the start alone, and a mode may become fast on the way.
        visited = x[np.isfinite(x).all(axis=1)][:: max(1, len(x) // 10)]
        longest = float(record.lengths.max(initial=0.0))
        # An implicit step is stable at any length.
        rules = follow_step(policy.discretisation, step)
        needed = 1 if step.implicit else choose_substeps(model.system, p, visited, longest, policy=rules)
        # At least halved, so that the difference of the two runs shows the error of the coarser one.
        more = max(2 * step.substeps, needed)
        before = y
        if step.past is None and method != "mixed":
            step, kernel = replace(step, substeps=more), kernel.with_substeps(more)
        else:  # a delayed input is cut differently, and more states may have become fast
            step = discretise(
                model.system, p, visited, record.lengths, method=method, substeps=more, policy=policy.discretisation
            )
            kernel = make_kernel(step, ())
        y, x = _run(kernel, step, record, p, x0)
        if is_settled := _has_settled(before, y, MAX_CHANGE):
            break
    # Explicit steps that were not enough where a mode became fast on the way, whether their run ended there or went astray, and implicit
    # ones of one length that jumped out of the equations (a root of what is used up), say nothing of the model; steps that follow the
    # error do.
    is_lost = not (substeps or step.per_interval or step.adaptive or (is_settled and np.isfinite(y).all()))
    stable = choose_implicit_method(model.system) if is_lost else ""
    if method == "automatic" and stable == ADAPTIVE:
        followed = run_freely(model, record, p, x0, method=stable, policy=policy)
        return followed if np.isfinite(followed[0]).all() else (y, x, step)
    return y, x, step


def _run(kernel: Kernel, step: Step, record: Record, p: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (N, ny) and states (N, nx)."""
    q, _ = step.coefficients(p, record.lengths, np.empty(0, int))
    record = record.read_by(step)
    y, x = kernel.simulate(record, q, p, x0)
    return record.samples(y), record.samples(x)


def _has_settled(before: np.ndarray, after: np.ndarray, max_change: float) -> bool:
    """Whether halving the step changed nothing visible: no output (N, ny), and not where the run overflows."""
    rows = np.isfinite(before).all(axis=1)
    if not np.array_equal(rows, np.isfinite(after).all(axis=1)):
        return False
    # Movement about the first row: an offset must not hide a change.
    change, movement = after[rows] - before[rows], after[rows] - after[0]
    return bool(np.all(np.sum(change**2, axis=0) <= max_change**2 * np.sum(movement**2, axis=0)))


# Where a model comes to rest under inputs that stay as they are, with its slopes: a rig under a load, a culture before its experiment.


# The run towards rest is first as long as a record, then each time so many times longer, ...
LONGER = 100.0
# ... so often at most: after 1e8 records what still moves has no rest.
TIMES = 5
# Change of a state, over the largest of its unit, from one of these times to the next at which it rests.
SETTLED = 1e-8
# Runs that are kept: those of an evaluation are asked for once for each record.
KEPT = 64


class SettledStart:
    """The states at which each record begins: where the model comes to rest from its declared start, under the inputs before the record.

    A long run finds it, whose steps follow the error and grow without end where nothing moves: of several resting places it is the one
    that the rig comes to, and what the equations conserve (the sum of two species) stays as it was declared. The slopes are those of that
    run.

    Parameters
    ----------
    system
        The equations. Raises ModelError for those with dry friction or play, which rest in many places.
    inputs
        What the inputs of each record are before it (experiments, nu).
    duration
        Of the records, in seconds.
    """

    def __init__(self, system: System, inputs: np.ndarray, duration: float) -> None:
        held = [*(d.effect for d in system.dry), *(u.effect for u in system.updates)]
        if held:
            raise ModelError(
                f"settled: with {', '.join(held)}, which is dry friction or play, a model rests where its past has left it; leave settled"
                " out: begin at rest, or fit the first states"
            )
        # An input that stays as it is arrives as it is, however late.
        self.system, self.inputs, self.duration = replace(system, delays=()), inputs, duration
        self._kernel = AdaptiveKernel(esdirk(self.system))
        self._known: dict[tuple[bytes, bytes, bytes], tuple[np.ndarray, np.ndarray]] = {}

    def at(self, p: np.ndarray, experiment: int, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The state (nx,) at the parameters ``p`` (np,), and its slopes (nx, L) along those numbered ``which``; NaN where nothing rests."""
        key = p.tobytes(), self.inputs[experiment].tobytes(), which.tobytes()
        if key not in self._known:
            if len(self._known) >= KEPT:
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._find(p, self.inputs[experiment], which)
        return self._known[key]

    def _find(self, p: np.ndarray, u: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, slope = (np.asarray(value) for value in self.system.start_function(p))
        x, dx, dp = x.ravel(), slope[:, which], np.eye(len(p))[:, which]
        times = self.duration * LONGER ** np.arange(TIMES + 1)
        record = Record(
            np.tile(u, (len(times) + 1, 1)),
            np.full((len(times) + 1, self._kernel.sizes.ny), np.nan),
            np.diff(times, prepend=0.0),
            np.arange(len(times)),
            np.diff(times, prepend=0.0),
        )
        nothing = np.zeros((1, self._kernel.sizes.nq)), np.zeros((1, self._kernel.sizes.nq, len(which)))
        arguments = check_arguments(self._kernel.sizes, record.read_by(self._kernel.step), *nothing, p, dp, x, dx)
        (part,) = self._kernel.run_parts(record, len(times) + 1, arguments)
        size = self._measure_sizes(part.x)
        for k in range(1, len(times)):
            if np.all(np.abs(part.x[k + 1] - part.x[k]) <= SETTLED * size):
                return part.x[k + 1], part.tangents[k + 1]
        return np.full(len(x), np.nan), np.full(dx.shape, np.nan)

    def _measure_sizes(self, x: np.ndarray) -> np.ndarray:
        """The largest size so far of the states in the unit of each (nx,)."""
        largest = np.nanmax(np.abs(x), axis=0)
        units = np.array([state.unit for state in self.system.states])
        return np.array([largest[units == unit].max() for unit in units])


def find_inputs_before(record: Record, inputs: int) -> np.ndarray:
    """What the inputs (nu,) were before a record: as it tells, else as in its first row."""
    return record.u[0, :inputs] if record.before is None else record.before[-1, :inputs]


# The slopes of a model's equations: as expressions, and as numbers along a run.


def differentiate_equations(system: System, *, slide: bool = False) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """``A, B, C, D`` of ``dx/dt = A x + B u, y = C x + D u`` as expressions of states, inputs and constants.

    Dry friction is left out: it has no slope. With ``slide`` every state that is set after each step stands where that puts one from
    far away, at the end of its play.
    """
    rates, outputs = ca.substitute(system.rhs, system.direction, ca.SX.zeros(len(system.dry))), system.outputs
    for update in system.updates if slide else ():
        state = system.x[update.state]
        reached = ca.substitute(update.value, state, ca.inf)
        rates, outputs = (ca.substitute(e, state, reached) for e in (rates, outputs))
    a, b, c, d = (ca.jacobian(e, along) for e in (rates, outputs) for along in (system.x, system.u))
    return a, b, c, d


def linearise_along(
    system: System, x: np.ndarray, u: np.ndarray, p: np.ndarray, *, slide: bool = False, others: Sequence[ca.SX] = ()
) -> list[np.ndarray]:
    """``A`` (R, nx, nx), ``B``, ``C``, ``D`` along a run, and ``others``; one entry each (R = 1) where they are the same all along.

    Parameters
    ----------
    system
        The equations.
    x, u, p
        States (R, nx), inputs (R, nu) and constants (np,).
    slide
        As of `differentiate_equations`.
    others
        Further matrices of states, inputs and constants to evaluate.
    """
    matrices = [*differentiate_equations(system, slide=slide), *others]
    signals = ca.vertcat(system.x, system.u)
    rows = slice(None) if any(ca.depends_on(m, signals) for m in matrices) else slice(0, 1)
    evaluate = ca.Function("slopes", [system.x, system.u, system.p], [ca.densify(ca.vec(m.T)) for m in matrices])
    values = evaluate(x[rows].T, u[rows].T, p)
    return [v.full().T.reshape(len(x[rows]), *m.shape) for v, m in zip(values, matrices, strict=True)]
