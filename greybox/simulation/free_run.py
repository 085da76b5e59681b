"""A free run of equations, its step halved until nothing visible changes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from greybox.model import Model
from greybox.simulation.integrators.discretisation import (
    ADAPTIVE,
    DiscretisationPolicy,
    choose_implicit_method,
    choose_substeps,
    discretise,
    follow_step,
)
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.interface import Kernel
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
    for _ in range(0 if substeps or step.per_interval else policy.max_halvings):
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
        if _has_settled(before, y, MAX_CHANGE):
            break
    # Explicit steps that were not enough where a mode became fast on the way, and implicit ones of one length that jumped out of the
    # equations (a root of what is used up), say nothing of the model; steps that follow the error do.
    is_lost = not (substeps or step.per_interval or step.adaptive or np.isfinite(y).all())
    stable = choose_implicit_method(model.system, record.lengths, alike=False) if is_lost else ""
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
