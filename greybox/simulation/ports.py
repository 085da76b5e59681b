"""Effects at the inputs and outputs of a plant that is run from outside: what reaches it of a record, and what is read of its run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greybox.data.experiment import Experiment
from greybox.model.balance import ClosedBalances
from greybox.simulation.free_run import run_freely
from greybox.simulation.local_model import build_local_model, extend_record, name_arriving
from greybox.simulation.plant import PlantModel, PlantRunError
from greybox.simulation.records import to_record

# Finer rows in each interval over which an effect with memory moves a signal: what is held, or straight, between them instead errs by the
# square of their length.
STEPS_A_ROW = 4


class PlantPorts:
    """What lies between the records and a plant: its effects, in equations of their own.

    Constants ``p`` and initial states ``x0`` are those of the effects, in the order of the model.
    """

    def __init__(self, model: PlantModel, hold: str) -> None:
        constants = tuple(replace(q, fixed=True) for q in model.parameters)
        bare = replace(model, effects=(), ties=(), parameters=constants, states=(), balances=ClosedBalances())
        self._title, self._labels = model.title, [i.name for i in model.inputs]
        self._outputs = [o.name for o in model.outputs]
        self._local = build_local_model(bare, hold, None, show_inputs=True)
        self._model = replace(self._local.model, effects=model.effects)
        changes_input = [b.site in self._labels for b in self._model.bound_effects]
        self._drives, self._reads = any(changes_input), not all(changes_input)
        has_memory = any(b.states or b.effect.delay for b in self._model.bound_effects)
        # What steps from row to row takes its inputs there alone.
        self._parts = STEPS_A_ROW if has_memory and not getattr(model.plant, "discrete", False) else 1

    def drive(self, experiment: Experiment, p: np.ndarray, x0: np.ndarray) -> Experiment:
        """The record with its inputs as they arrive behind the effects: with finer rows where one of these moves them between rows."""
        parts = self._parts
        if not self._drives:
            return experiment if parts == 1 else _refine(experiment, parts)
        if parts == 1:
            seen = self._run(experiment, np.zeros((experiment.rows, len(self._outputs))), p, x0)
            return replace(experiment, inputs={**experiment.inputs, **self._arriving(seen)})
        finer, halves = _refine(experiment, parts), _refine(experiment, 2 * parts)
        seen = self._run(halves, np.zeros((halves.rows, len(self._outputs))), p, x0)
        # What is held over a finer interval is its value in the middle: a step at a row then belongs to the interval that begins there.
        middle = np.minimum(np.arange(finer.rows) * 2 + (finer.hold == "zero"), halves.rows - 1)
        arriving = {name: values[middle] for name, values in self._arriving(seen).items()}
        return replace(finer, inputs={**finer.inputs, **arriving})

    def _arriving(self, seen: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {name: seen[name_arriving(name)] for name in self._labels}

    def read(self, experiment: Experiment, run: np.ndarray, p: np.ndarray, x0: np.ndarray) -> np.ndarray:
        """Outputs (N, ny) as the sensors give them of a ``run`` (M, ny) of the plant over what drove it."""
        if not self._reads:
            return run[:: self._parts]
        seen = self._run(_refine(experiment, self._parts), run, p, x0)
        return np.column_stack([seen[name] for name in self._outputs])[:: self._parts]

    def _run(self, experiment: Experiment, run: np.ndarray, p: np.ndarray, x0: np.ndarray) -> dict[str, np.ndarray]:
        """Outputs (N,) of the effects' own equations where the plant gives ``run`` (N, ny). Raises PlantRunError."""
        by_name = {name: run[:, j] for j, name in enumerate(self._outputs)}
        nothing = np.zeros((experiment.rows, len(self._outputs), 0))
        record = to_record(self._model, extend_record(experiment.with_outputs({}), self._local, by_name, nothing))
        # What the run itself moves begins at zero, before the states of the effects.
        moved = np.zeros(len(self._model.states))
        y, _, _ = run_freely(self._model, record, p, np.concatenate([moved, x0]))
        if not np.isfinite(y).all():
            raise PlantRunError(f"{self._title}: an effect is not finite to the end of the record")
        return {o.name: y[:, j] for j, o in enumerate(self._model.outputs)}


def _refine(experiment: Experiment, parts: int) -> Experiment:
    """The record with so many rows for each of its own, without outputs."""
    if parts == 1:
        return experiment
    steps = np.append(experiment.intervals, experiment.intervals[-1:])
    rows = (experiment.rows - 1) * parts + 1
    time = (experiment.time[:, None] + steps[:, None] * np.arange(parts) / parts).ravel()[:rows]
    held = experiment.hold == "zero"
    inputs = {
        n: np.repeat(u, parts)[:rows] if held else np.interp(time, experiment.time, u)
        for n, u in experiment.inputs.items()
    }
    return Experiment(experiment.name, time, inputs, {}, experiment.hold, conditions=experiment.conditions)
