"""An FMU as a model with equations: its own run, its slopes with respect to parameters, and its linear answer to changed inputs.

Exact where the FMU is run, of first order around it. Effects at inputs and outputs are added to it as to any other model, so it can be
checked, compared and searched like one. The run itself comes in through inputs that are added to the records.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from greybox.base.texts import to_identifiers
from greybox.data.experiment import Experiment
from greybox.extensions.fmu.description import FmuPlant
from greybox.extensions.fmu.linear_response import LinearResponse
from greybox.extensions.fmu.search import FmuObjective
from greybox.model.balance import Balance
from greybox.model.effect import Effect
from greybox.model.effects.catalogue import all_effects
from greybox.model.effects.placement import find_placements
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State

PREFIX = "fmu_"
RATE = "one_per_second"


@dataclass(frozen=True, eq=False)
class LocalModel:
    """An FMU about its fitted parameters.

    Parameters
    ----------
    plant
        The FMU.
    model
        The model; its free parameters are the fitted ones, in the FMU's names.
    response
        The linear answer to the inputs; None where effects at inputs cannot be seen through one.
    z
        Unknowns about which it is exact.
    """

    plant: FmuPlant
    model: Model
    response: LinearResponse | None
    z: np.ndarray

    @property
    def candidates(self) -> list[Effect]:
        """The effects of the catalogue at the inputs, as far as their response is known, and at the outputs of the FMU."""
        sites = {o.label for o in self.plant.outputs}
        if self.response is not None:
            sites |= {i.label for i in self.plant.inputs}
        places = find_placements(self.model, tuple(e for e in all_effects() if not e.hold))
        return [p.effect for p in places if p.effect is not None and p.site in sites]


def build_local_model(
    objective: FmuObjective, z: np.ndarray, response: LinearResponse | None, *, show_inputs: bool = False
) -> LocalModel:
    """The model about ``z``.

    Parameters
    ----------
    objective
        Records, unknowns and noise of the fit.
    z
        The unknowns (n,).
    response
        The answer to the inputs.
    show_inputs
        Whether the inputs as they arrive behind their effects are outputs, too.

    Returns
    -------
    LocalModel
        To be used with records from `extend_record`.
    """
    plant = objective.simulator.plant
    held = objective.records[0].hold == "zero"
    values = dict(zip([v.label for v in objective.unknowns], objective.values(z).tolist(), strict=True))
    inputs = [Input(i.label, i.unit) for i in plant.inputs]
    for o in plant.outputs:
        inputs += [Input(f"{PREFIX}{o.label}", o.unit)]
        inputs += [Input(f"{PREFIX}{o.label}_rate", f"({o.unit})/s")] if held else []
        inputs += [Input(_slope_name(o.label, v.label), f"({o.unit})/({v.unit})") for v in objective.unknowns]
    order = 0 if response is None else len(response.A)
    units = (*plant.inputs, *plant.outputs) if response is not None else ()
    hidden = to_identifiers([f"response_{k + 1}" for k in range(order)])
    states = [State(name, "1") for name in hidden]
    states += [State(f"{PREFIX}{o.label}_moved", o.unit) for o in plant.outputs] if held else []

    def balances(x: Any, u: Any, p: Any) -> list[Balance]:
        drive = [u[i.label] for i in plant.inputs]
        result = []
        for k, name in enumerate(hidden):
            terms = {h: p[RATE] * response.A[k, j] * x[h] for j, h in enumerate(hidden) if response.A[k, j]}  # type: ignore[union-attr]
            terms |= {
                i.label: p[RATE] * response.B[k, j] * drive[j] / p[_unit_name(i.label)]  # type: ignore[union-attr]
                for j, i in enumerate(plant.inputs)
            }
            result.append(Balance(name, "1/s", 1.0, name, **{f"by_{n}": t for n, t in terms.items()}))
        for o in plant.outputs if held else ():
            name = f"{PREFIX}{o.label}_moved"
            result.append(Balance(name, f"({o.unit})/s", 1.0, name, rate=u[f"{PREFIX}{o.label}_rate"]))
        return result

    def read(number: int) -> Any:
        o = plant.outputs[number]

        def equation(x: Any, u: Any, p: Any) -> Any:
            value = u[f"{PREFIX}{o.label}"] + (x[f"{PREFIX}{o.label}_moved"] if held else 0.0)
            for name in values:
                # y = y_run + (dy/dp) (p - p_run): exact at the run, of first order around it.
                value = value + u[_slope_name(o.label, name)] * (p[name] - p[_start_name(name)])
            if response is not None:
                one = p[_unit_name(o.label)]
                for k, name in enumerate(hidden):
                    value = value + one * response.C[number, k] * x[name]
                for j, i in enumerate(plant.inputs):
                    value = value + one * response.D[number, j] * u[i.label] / p[_unit_name(i.label)]
            return value

        return equation

    def arrive(label: str) -> Any:
        return lambda x, u, p: u[label]

    shown = [Output(name_arriving(i.label), i.unit, arrive(i.label)) for i in plant.inputs] if show_inputs else []
    model = Model(
        to_identifiers([plant.title])[0],
        states=states,
        inputs=inputs,
        outputs=[*(Output(o.label, o.unit, read(k)) for k, o in enumerate(plant.outputs)), *shown],
        parameters=[
            *(
                Parameter(v.label, v.unit, values[v.label], v.bounds, source=plant.path.name)
                for v in objective.unknowns
            ),
            *(Parameter(_start_name(v.label), v.unit, values[v.label], fixed=True) for v in objective.unknowns),
            # Numbers of the response have no unit; these give them one.
            *(Parameter(_unit_name(s.label), s.unit, 1.0, fixed=True) for s in units),
            *([Parameter(RATE, "1/s", 1.0, fixed=True)] if order else []),
        ],
        balances=balances,
    )
    return LocalModel(plant, model, response, z)


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
    u = np.column_stack([record.inputs[i.label] for i in plant.inputs]) if applied is None and plant.inputs else applied
    known = response.run(record.time, u, record.hold) if response is not None and u is not None else None
    inputs = {i.label: record.inputs[i.label] for i in plant.inputs}
    free = [q.name for q in local.model.free_parameters]
    for j, o in enumerate(plant.outputs):
        # The linear answer to the inputs is in the model: what comes through the record is the rest, so that the sum
        # is the run.
        base = run[o.label] - (0.0 if known is None else known[:, j])
        if record.hold == "zero":
            # Between samples an output moves on: its rate is held, and a state adds it up.
            steps = np.diff(base) / np.diff(record.time)
            inputs[f"{PREFIX}{o.label}"] = np.full(record.rows, base[0])
            inputs[f"{PREFIX}{o.label}_rate"] = np.append(steps, steps[-1:])
        else:
            inputs[f"{PREFIX}{o.label}"] = base
        inputs |= {_slope_name(o.label, name): slopes[:, j, k] for k, name in enumerate(free)}
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


def collect_runs(objective: FmuObjective, z: np.ndarray) -> tuple[list[dict[str, np.ndarray]], list[np.ndarray]]:
    """The run over each record of ``objective``, and the slopes (N, ny, n) of its outputs in their units. Raises FmuRunError."""
    objective.run(z)
    slopes = objective.slopes(z)
    std = np.array([objective.std[o.label] for o in objective.simulator.plant.outputs])
    runs = [objective.simulated[record.name] for record in objective.records]
    # A residual is the measurement less the run, over the noise; what is not measured needs no slope.
    return runs, [np.nan_to_num(-s * std[None, :, None] / objective.sizes) for s in slopes]
