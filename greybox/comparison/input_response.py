"""What a plant that is run from outside answers to a small change of its inputs, as a linear system: two runs and a subspace projection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import logm

from greybox.base.errors import DataError
from greybox.comparison.blackbox.subspace import StateSpaceModel, subspace
from greybox.data.experiment import Experiment
from greybox.simulation.plant import LinearResponse, PlantRunError
from greybox.simulation.plant_kernel import PlantKernel

# Movement of an output, over that of its run, below which it does not answer to the inputs.
LEAST_ANSWER = 1e-06
# Orders that are tried beside the one that the singular values show.
RESPONSE_ORDERS: tuple[int, ...] = (1, 2, 3, 4, 6)
# Share of the answer that the linear system must follow in each output; effects at inputs are not looked for below.
LEAST_EXPLAINED = 0.5


def estimate_linear_response(kernel: PlantKernel, record: Experiment) -> LinearResponse | None:
    """The answer to a small random change of every input about a record, by two runs.

    Parameters
    ----------
    kernel
        Runs the plant, at the present values of its model.
    record
        Whose inputs are changed.

    Returns
    -------
    LinearResponse or None
        None for a plant without inputs, one that does not answer or fails, and one that no linear system follows.
    """
    plant = kernel.model
    if not plant.inputs:
        return None
    change = _draw_change(record, [i.name for i in plant.inputs])
    names = [o.name for o in plant.outputs]
    try:
        plus, minus = (
            kernel.run_experiment(
                replace(record, inputs={n: record.inputs[n] + sign * change[n] for n in change}, hold="zero")
            )
            for sign in (1.0, -1.0)
        )
    except PlantRunError:
        return None
    # (y(u + d) - y(u - d)) / 2: even terms of the plant's nonlinearity cancel.
    answer = np.column_stack([(plus[n] - minus[n]) / 2 for n in names])
    size = answer.std(axis=0)
    moving = size > LEAST_ANSWER * np.array([max(float(np.std(plus[n])), np.finfo(float).tiny) for n in names])
    if not moving.any():
        return None
    scale = np.where(moving, size, 1.0)
    signals = {n: change[n] / np.abs(change[n]).max() for n in change}
    outputs = {n: answer[:, j] / scale[j] for j, n in enumerate(names) if moving[j]}
    data = Experiment("answer", record.time, signals, outputs)
    candidates = [r for order in (None, *RESPONSE_ORDERS) if (r := _identify(data, order)) is not None]
    if not candidates:
        return None
    best = max(candidates, key=lambda r: min(r.explained.values()))
    if min(best.explained.values()) < LEAST_EXPLAINED:
        return None
    gains = np.array([1 / np.abs(change[i.name]).max() for i in plant.inputs])
    C, D = np.zeros((len(names), len(best.A))), np.zeros((len(names), len(gains)))
    # Rounding of a subspace estimate is not taken for a feed-through.
    direct = np.where(np.abs(best.D) > LEAST_ANSWER, best.D, 0.0)
    C[moving], D[moving] = best.C * scale[moving, None], direct * scale[moving, None] * gains
    explained = dict(zip(names, np.ones(len(names)), strict=True)) | dict(best.explained)
    return LinearResponse(best.A, best.B * gains, C, D, explained)


# Change of an input, over its movement: small beside what bends, large beside what solvers scatter.
RESPONSE_CHANGE = 0.05
# Longest times between two changes of sign, as the rows of a record over this.
RESPONSE_SLOWEST = 10.0
# Seed of the change, so that it can be repeated.
RESPONSE_SEED = 1


def _draw_change(record: Experiment, inputs: list[str]) -> dict[str, np.ndarray]:
    """Random telegraph signals of many speeds, small beside the movement of the inputs."""
    rng = np.random.default_rng(RESPONSE_SEED)
    change = {}
    for name in inputs:
        u = record.inputs[name]
        size = RESPONSE_CHANGE * (float(np.std(u)) or float(np.abs(u).max(initial=0.0)) or 1.0)
        # Lengths uniform in the logarithm: every decade of frequency gets a like share.
        lengths = np.exp(rng.uniform(0.0, np.log(max(record.rows / RESPONSE_SLOWEST, 2.0)), record.rows)).astype(int)
        signs = rng.choice([-1.0, 1.0], record.rows)
        change[name] = size * np.repeat(signs, lengths)[: record.rows]
    return change


# Distance of a pole from the unit circle outside of which an answer counts as unstable.
RESPONSE_UNSTABLE = 0.001
# Largest imaginary part of a continuous system, over its size, that is rounding.
RESPONSE_IMAGINARY = 1e-06


def _identify(data: Experiment, order: int | None) -> LinearResponse | None:
    """The response of this order, continuous in time; None where there is none, or no continuous system samples to it."""
    try:
        model = subspace(data, order)
    except (DataError, np.linalg.LinAlgError):
        return None
    # [[A B], [0 I]] = exp([[Ac Bc], [0 0]] h)
    whole = np.block([[model.A, model.B], [np.zeros((model.D.shape[1], model.order)), np.eye(model.D.shape[1])]])
    if not model.stable and np.abs(model.poles).max(initial=0.0) > 1 + RESPONSE_UNSTABLE:
        return None
    with np.errstate(all="ignore"):
        continuous = logm(whole) / model.sampling_time
    if (
        not np.isfinite(continuous).all()
        or np.abs(np.imag(continuous)).max() > RESPONSE_IMAGINARY * np.abs(continuous).max()
    ):
        return None
    n = model.order
    rates = np.real(continuous)
    response = LinearResponse(*_balance(rates[:n, :n], rates[:n, n:], model), model.D, {})
    u = np.column_stack([data.inputs[name] for name in model.inputs])
    with np.errstate(all="ignore"):
        run = response.run(data.time, u, np.zeros(u.shape[1], bool))
    y = np.column_stack([data.outputs[name] for name in model.outputs])
    error = np.mean((run - y) ** 2, axis=0) / np.mean(y**2, axis=0)
    if not np.isfinite(error).all():
        return None
    return replace(response, explained=dict(zip(model.outputs, (1 - error).tolist(), strict=True)))


def _balance(A: np.ndarray, B: np.ndarray, model: StateSpaceModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Modal blocks: each state is of the size of an output, and real poles stand alone."""
    values, vectors = np.linalg.eig(A)
    columns = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag > 0:
            # A conjugate pair as a real block; the other of the pair spans the same.
            columns += [vector.real, vector.imag]
        elif value.imag == 0:
            columns.append(vector.real)
    T = np.column_stack(columns) if columns else np.zeros((0, 0))
    if T.shape != A.shape or np.linalg.cond(T) > 1 / np.sqrt(np.finfo(float).eps):
        return A, B, model.C
    size = np.abs(model.C @ T).sum(axis=0)
    T = T / np.where(size > 0, size, 1.0)
    return np.linalg.solve(T, A @ T), np.linalg.solve(T, B), model.C @ T
