"""A plant that is run from outside, as a model with equations: its own run, its slopes, and its linear answer to changed inputs.

Exact where the plant is run, of first order around it. Effects at inputs and outputs are added to it as to any other model, so it is
searched for them like one. The run itself comes in through inputs that are added to the records.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from greybox.base import to_identifiers
from greybox.data.experiment import Experiment, stack_signals
from greybox.model import Balance, Input, Model, Output, Parameter, State
from greybox.simulation.plant import LinearResponse, PlantModel, find_straight

# What comes in from a run of the plant is called so before the name of the output.
PREFIX = "run_"
RATE = "one_per_second"


@dataclass(frozen=True, eq=False)
class LocalEquations(Model):
    """The equations about a run, in which the plant's own signals are those that a record has."""

    @property
    def auxiliary(self) -> frozenset[str]:
        """What carries the run and the answer to the inputs."""
        inputs = {i.name for i in self.inputs if i.name.startswith(PREFIX)}
        return frozenset(inputs | {s.name for s in self.states})


@dataclass(frozen=True, eq=False)
class LocalModel:
    """A plant about the present values of its constants.

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


def build_local_model(plant: PlantModel, response: LinearResponse | None, *, show_inputs: bool = False) -> LocalModel:
    """The model about the present values of a plant.

    Parameters
    ----------
    plant
        The plant; its free constants are those of the model, and where a record begins is estimated as of any model.
    response
        The answer to the inputs.
    show_inputs
        Whether the inputs as they arrive behind their effects are outputs, too.

    Returns
    -------
    LocalModel
        To be used with records from `extend_record`.
    """
    unknowns = plant.free_parameters
    values = {q.name: q.value for q in unknowns}
    inputs = [Input(i.name, i.unit) for i in plant.inputs]
    for o in plant.outputs:
        inputs += [Input(f"{PREFIX}{o.name}", o.unit)]
        of_unknowns = [(v.name, v.unit) for v in unknowns] + [(s.name, s.unit) for s in plant.states]
        inputs += [Input(_slope_name(o.name, name), f"({o.unit})/({unit})") for name, unit in of_unknowns]
    order = 0 if response is None else len(response.A)
    units: tuple[Input | Output, ...] = (*plant.inputs, *plant.outputs) if response is not None else ()
    hidden = to_identifiers([f"response_{k + 1}" for k in range(order)])
    states = [State(name, "1") for name in hidden]
    # A model has a state, if one that rests.
    states += [] if states or plant.states else [State(f"{PREFIX}rest", "1")]
    # How far a record begins from where the run did.
    states += [State(f"{PREFIX}{s.name}_apart", s.unit, free_start=True) for s in plant.states]

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
        for s in states[len(hidden) :]:
            result.append(Balance(s.name, f"({s.unit})/s", 1.0, s.name, rest=0.0))
        return result

    def read(number: int) -> Any:
        o = plant.outputs[number]

        def equation(x: Any, u: Any, p: Any) -> Any:
            value = u[f"{PREFIX}{o.name}"]
            for name in values:
                # y = y_run + (dy/dp) (p - p_run): exact at the run, of first order around it.
                value = value + u[_slope_name(o.name, name)] * (p[name] - p[_start_name(name)])
            for s in plant.states:
                value = value + u[_slope_name(o.name, s.name)] * x[f"{PREFIX}{s.name}_apart"]
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
    model = LocalEquations(
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
    known: np.ndarray | None = None,
) -> Experiment:
    """A record with what the model needs of a run of the plant over it.

    Parameters
    ----------
    record
        The record.
    local
        The model.
    run
        Output -> run (N,) at the parameters of the model.
    slopes
        Slopes (N, ny, n) of the outputs along the free constants and the initial states of the plant.
    known
        The linear answer (N, ny) to the inputs that the run had; None for that to those of the record.
    """
    plant, response = local.plant, local.response
    if known is None and response is not None:
        applied = stack_signals([record.inputs[i.name] for i in plant.inputs], record.rows)
        known = response.run(record.time, applied, find_straight(record, plant.inputs))
    inputs = {i.name: record.inputs[i.name] for i in plant.inputs}
    free = [*(q.name for q in plant.free_parameters), *(s.name for s in plant.states)]
    for j, o in enumerate(plant.outputs):
        # The linear answer to the inputs is in the model: what comes through the record is the rest, so that the sum
        # is the run.
        inputs[f"{PREFIX}{o.name}"] = run[o.name] - (0.0 if known is None else known[:, j])
        inputs |= {_slope_name(o.name, name): slopes[:, j, k] for k, name in enumerate(free)}
    # Between samples an output moves on, straight, whatever the inputs do.
    return replace(record, inputs=inputs, hold={**dict.fromkeys(inputs, "first"), **record.courses})


def name_arriving(label: str) -> str:
    """What an input is called behind its effects."""
    return f"{label}_arriving"


def _unit_name(signal: str) -> str:
    return f"one_{signal}"


def _start_name(parameter: str) -> str:
    return f"{PREFIX}{parameter}"


def _slope_name(output: str, parameter: str) -> str:
    return f"{PREFIX}{output}_per_{parameter}"
