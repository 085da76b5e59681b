"""An FMU as a model with equations: its own run, its slopes with respect to parameters, and its linear answer to changed inputs.

Exact where the FMU is run, of first order around it. Effects at inputs and outputs are added to it as to any other model, so it can be
checked, compared and searched like one. The run itself comes in through inputs that are added to the records.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import logm

from greybox.base.errors import DataError
from greybox.base.texts import to_identifiers
from greybox.comparison.blackbox.subspace import StateSpaceModel, subspace
from greybox.data.experiment import Experiment
from greybox.model.balance import Balance
from greybox.model.effect import Effect
from greybox.model.effects.catalogue import all_effects
from greybox.model.effects.placement import find_placements
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.plant import LinearResponse, PlantKernel, PlantModel, PlantRunError

# What an FMU answers to a small change of its inputs, as a linear system: what an effect at an input is seen through.


# Movement of an output, over that of its run, below which it does not answer to the inputs.
LEAST_ANSWER = 1e-06
# Orders that are tried beside the one that the singular values show.
FMU_RESPONSE_ORDERS: tuple[int, ...] = (1, 2, 3, 4, 6)
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
        None for an FMU without inputs, one that does not answer or fails, and one that no linear system follows.
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
    candidates = [r for order in (None, *FMU_RESPONSE_ORDERS) if (r := _identify(data, order)) is not None]
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
FMU_RESPONSE_CHANGE = 0.05
# Longest times between two changes of sign, as the rows of a record over this.
FMU_RESPONSE_SLOWEST = 10.0
# Seed of the change, so that it can be repeated.
FMU_RESPONSE_SEED = 1


def _draw_change(record: Experiment, inputs: list[str]) -> dict[str, np.ndarray]:
    """Random telegraph signals of many speeds, small beside the movement of the inputs."""
    rng = np.random.default_rng(FMU_RESPONSE_SEED)
    change = {}
    for name in inputs:
        u = record.inputs[name]
        size = FMU_RESPONSE_CHANGE * (float(np.std(u)) or float(np.abs(u).max(initial=0.0)) or 1.0)
        # Lengths uniform in the logarithm: every decade of frequency gets a like share.
        lengths = np.exp(rng.uniform(0.0, np.log(max(record.rows / FMU_RESPONSE_SLOWEST, 2.0)), record.rows)).astype(
            int
        )
        signs = rng.choice([-1.0, 1.0], record.rows)
        change[name] = size * np.repeat(signs, lengths)[: record.rows]
    return change


# Distance of a pole from the unit circle outside of which an answer counts as unstable.
FMU_RESPONSE_UNSTABLE = 0.001
# Largest imaginary part of a continuous system, over its size, that is rounding.
FMU_RESPONSE_IMAGINARY = 1e-06


def _identify(data: Experiment, order: int | None) -> LinearResponse | None:
    """The response of this order, continuous in time; None where there is none, or no continuous system samples to it."""
    try:
        model = subspace(data, order)
    except (DataError, np.linalg.LinAlgError):
        return None
    # [[A B], [0 I]] = exp([[Ac Bc], [0 0]] h)
    whole = np.block([[model.A, model.B], [np.zeros((model.D.shape[1], model.order)), np.eye(model.D.shape[1])]])
    if not model.stable and np.abs(model.poles).max(initial=0.0) > 1 + FMU_RESPONSE_UNSTABLE:
        return None
    with np.errstate(all="ignore"):
        continuous = logm(whole) / model.sampling_time
    if (
        not np.isfinite(continuous).all()
        or np.abs(np.imag(continuous)).max() > FMU_RESPONSE_IMAGINARY * np.abs(continuous).max()
    ):
        return None
    n = model.order
    rates = np.real(continuous)
    response = LinearResponse(*_balance(rates[:n, :n], rates[:n, n:], model), model.D, {})
    u = np.column_stack([data.inputs[name] for name in model.inputs])
    with np.errstate(all="ignore"):
        run = response.run(data.time, u, "zero")
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


PREFIX = "fmu_"
RATE = "one_per_second"


@dataclass(frozen=True, eq=False)
class LocalModel:
    """An FMU about its fitted parameters.

    Parameters
    ----------
    plant
        The plant, at the values about which the model is exact.
    model
        The model; its free parameters are the plant's.
    response
        The linear answer to the inputs; None where effects at inputs cannot be seen through one.
    """

    plant: PlantModel
    model: Model
    response: LinearResponse | None

    @property
    def candidates(self) -> list[Effect]:
        """The effects of the catalogue at the inputs, as far as their response is known, and at the outputs of the FMU."""
        sites = {o.name for o in self.plant.outputs}
        if self.response is not None:
            sites |= {i.name for i in self.plant.inputs}
        places = find_placements(self.model, tuple(e for e in all_effects() if not e.hold))
        return [p.effect for p in places if p.effect is not None and p.site in sites]


def build_local_model(
    plant: PlantModel, hold: str, response: LinearResponse | None, *, show_inputs: bool = False
) -> LocalModel:
    """The model about the present values of a plant.

    Parameters
    ----------
    plant
        The plant; its free constants are those of the model.
    hold
        How the inputs of the records move between samples.
    response
        The answer to the inputs.
    show_inputs
        Whether the inputs as they arrive behind their effects are outputs, too.

    Returns
    -------
    LocalModel
        To be used with records from `extend_record`.
    """
    held, unknowns = hold == "zero", plant.free_parameters
    values = {q.name: q.value for q in unknowns}
    inputs = [Input(i.name, i.unit) for i in plant.inputs]
    for o in plant.outputs:
        inputs += [Input(f"{PREFIX}{o.name}", o.unit)]
        inputs += [Input(f"{PREFIX}{o.name}_rate", f"({o.unit})/s")] if held else []
        inputs += [Input(_slope_name(o.name, v.name), f"({o.unit})/({v.unit})") for v in unknowns]
    order = 0 if response is None else len(response.A)
    units: tuple[Input | Output, ...] = (*plant.inputs, *plant.outputs) if response is not None else ()
    hidden = to_identifiers([f"response_{k + 1}" for k in range(order)])
    states = [State(name, "1") for name in hidden]
    states += [State(f"{PREFIX}{o.name}_moved", o.unit) for o in plant.outputs] if held else []

    def balances(x: Any, u: Any, p: Any) -> list[Balance]:
        drive = [u[i.name] for i in plant.inputs]
        result = []
        for k, name in enumerate(hidden):
            terms = {h: p[RATE] * response.A[k, j] * x[h] for j, h in enumerate(hidden) if response.A[k, j]}  # type: ignore[union-attr]
            terms |= {
                i.name: p[RATE] * response.B[k, j] * drive[j] / p[_unit_name(i.name)]  # type: ignore[union-attr]
                for j, i in enumerate(plant.inputs)
            }
            result.append(Balance(name, "1/s", 1.0, name, **{f"by_{n}": t for n, t in terms.items()}))
        for o in plant.outputs if held else ():
            name = f"{PREFIX}{o.name}_moved"
            result.append(Balance(name, f"({o.unit})/s", 1.0, name, rate=u[f"{PREFIX}{o.name}_rate"]))
        return result

    def read(number: int) -> Any:
        o = plant.outputs[number]

        def equation(x: Any, u: Any, p: Any) -> Any:
            value = u[f"{PREFIX}{o.name}"] + (x[f"{PREFIX}{o.name}_moved"] if held else 0.0)
            for name in values:
                # y = y_run + (dy/dp) (p - p_run): exact at the run, of first order around it.
                value = value + u[_slope_name(o.name, name)] * (p[name] - p[_start_name(name)])
            if response is not None:
                one = p[_unit_name(o.name)]
                for k, name in enumerate(hidden):
                    value = value + one * response.C[number, k] * x[name]
                for j, i in enumerate(plant.inputs):
                    value = value + one * response.D[number, j] * u[i.name] / p[_unit_name(i.name)]
            return value

        return equation

    def arrive(label: str) -> Any:
        return lambda x, u, p: u[label]

    shown = [Output(name_arriving(i.name), i.unit, arrive(i.name)) for i in plant.inputs] if show_inputs else []
    model = Model(
        plant.name,
        states=states,
        inputs=inputs,
        outputs=[*(Output(o.name, o.unit, read(k)) for k, o in enumerate(plant.outputs)), *shown],
        parameters=[
            *(Parameter(v.name, v.unit, v.value, v.bounds, source=v.source) for v in unknowns),
            *(Parameter(_start_name(v.name), v.unit, values[v.name], fixed=True) for v in unknowns),
            # Numbers of the response have no unit; these give them one.
            *(Parameter(_unit_name(s.name), s.unit, 1.0, fixed=True) for s in units),
            *([Parameter(RATE, "1/s", 1.0, fixed=True)] if order else []),
        ],
        balances=balances,
    )
    return LocalModel(plant, model, response)


def extend_record(
    record: Experiment,
    local: LocalModel,
    run: Mapping[str, np.ndarray],
    slopes: np.ndarray,
    applied: np.ndarray | None = None,
) -> Experiment:
    """A record with what the model needs of a run of the FMU over it.

    Parameters
    ----------
    record
        The record.
    local
        The model.
    run
        Output -> run (N,) at the parameters of the model.
    slopes
        Slopes (N, ny, n) of the outputs with respect to the parameters.
    applied
        Inputs (N, nu) that the run had; None for those of the record.
    """
    plant, response = local.plant, local.response
    u = np.column_stack([record.inputs[i.name] for i in plant.inputs]) if applied is None and plant.inputs else applied
    known = response.run(record.time, u, record.hold) if response is not None and u is not None else None
    inputs = {i.name: record.inputs[i.name] for i in plant.inputs}
    free = [q.name for q in local.model.free_parameters]
    for j, o in enumerate(plant.outputs):
        # The linear answer to the inputs is in the model: what comes through the record is the rest, so that the sum
        # is the run.
        base = run[o.name] - (0.0 if known is None else known[:, j])
        if record.hold == "zero":
            # Between samples an output moves on: its rate is held, and a state adds it up.
            steps = np.diff(base) / np.diff(record.time)
            inputs[f"{PREFIX}{o.name}"] = np.full(record.rows, base[0])
            inputs[f"{PREFIX}{o.name}_rate"] = np.append(steps, steps[-1:])
        else:
            inputs[f"{PREFIX}{o.name}"] = base
        inputs |= {_slope_name(o.name, name): slopes[:, j, k] for k, name in enumerate(free)}
    return replace(record, inputs=inputs)


def name_arriving(label: str) -> str:
    """What an input is called behind its effects."""
    return f"{label}_arriving"


def _unit_name(signal: str) -> str:
    return f"one_{signal}"


def _start_name(parameter: str) -> str:
    return f"{PREFIX}{parameter}"


def _slope_name(output: str, parameter: str) -> str:
    return f"{PREFIX}{output}_per_{parameter}"
