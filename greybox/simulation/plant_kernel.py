"""What runs a plant over records, as a kernel runs equations: costs, slopes, failures, and what was run before."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.data.experiment import Experiment
from greybox.model.balance import ClosedBalances
from greybox.simulation.free_run import run_freely
from greybox.simulation.kernel.interface import GaussNewtonSums, KernelPoint, check_sums
from greybox.simulation.kernel.record import Record
from greybox.simulation.local_model import build_local_model, extend_record, name_arriving
from greybox.simulation.plant import CanDifferentiate, PlantModel, PlantRecord, PlantRunError, to_plant_record
from greybox.simulation.plant_process import PlantProcess
from greybox.simulation.records import to_record

# Step of a constant for a slope, over its size: above what solvers with a tolerance of 1e-8 scatter, below what bends.
PLANT_DIFFERENCE = 0.0001
# Runs that are kept: those of a search are asked for again by its cost, its slopes and its end.
KEPT_RUNS = 256


class PlantKernel:
    """Runs a plant over records, with slopes: a `greybox.simulation.kernel.interface.Kernel`. What was run is not run again.

    Attributes
    ----------
    runs, failures, rows
        How many runs of a record or its beginning there were, how many of them failed, and the rows of all of them.
    central
        Whether a slope is a difference to both sides, for twice the runs.
    """

    name = "plant"
    description = "the plant's own runs"
    reason = "it has no equations"

    def __init__(self, model: PlantModel) -> None:
        self.model, self.plant = model, PlantProcess.of(model.plant) if model.may_end_process else model.plant
        self.runs = self.failures = self.rows = 0
        self.central, self._can_differentiate = False, isinstance(model.plant, CanDifferentiate)
        self._known: dict[tuple, np.ndarray | PlantRunError] = {}
        self._runs: dict[tuple, np.ndarray | PlantRunError] = {}
        self._slopes: dict[tuple, np.ndarray] = {}
        quantities = model.stated_parameters
        starts = {**model.values, **{n: float(v) for n, v in model.tied_values.items()}}
        values = np.array([*(starts[q.name] for q in quantities), *(0.0 for _ in model.all_states)])
        self._names = [*(q.name for q in quantities), *(s.name for s in model.all_states)]
        # Where the plant's own constants and initial states stand among all of them: those of its effects lie behind each.
        first, states = len(model.parameters), len(quantities)
        self._own = np.r_[:first, states : states + len(model.states)]
        self._of_effects = slice(first, states), slice(states + len(model.states), None)
        bounds = np.array([*(q.bounds for q in quantities), *(s.bounds for s in model.all_states)]).reshape(-1, 2)
        self._low, self._high = bounds.T
        self._sizes = choose_sizes(values, bounds)

    def with_substeps(self, substeps: int) -> PlantKernel:
        """Itself: a plant steps as it does."""
        return self

    def coefficients(self, record: Record, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """None: a plant takes its constants as they are."""
        return np.zeros((1, 0)), np.zeros((1, 0, dp.shape[1]))

    @cached_property
    def _ties(self) -> ca.Function | None:
        """``p -> (every stated constant, slopes)``; None where each stands for itself."""
        if not self.model.ties:
            return None
        p = ca.SX.sym("p", len(self.model.values))
        named = self.model.parameters_as_symbols(p)
        whole = ca.vertcat(*[ca.SX(named[q.name]) for q in self.model.stated_parameters])
        return ca.Function("ties", [p], [whole, ca.jacobian(whole, p)])

    def _settings(self, p: np.ndarray, x0: np.ndarray) -> np.ndarray:
        """Values of every constant and initial state that the plant knows."""
        if self._ties is None:
            return np.concatenate([p, x0])
        return np.concatenate([np.asarray(self._ties(p)[0]).ravel(), x0])

    def simulate(self, record: Record, q: np.ndarray, p: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny), NaN where the run fails; in the place of states where each began."""
        states = np.tile(x0, (len(record.y), 1))
        try:
            return self.run(record, p, x0), states
        except PlantRunError:
            return np.full(record.y.shape, np.nan), states

    def run_experiment(
        self, experiment: Experiment, initial: Mapping[str, float] | None = None
    ) -> dict[str, np.ndarray]:
        """Outputs (N,) by name over an experiment, at the model's present values and ``initial`` states. Raises PlantRunError."""
        y = self.run(*self._at_present(experiment, initial))
        return {o.name: y[:, j] for j, o in enumerate(self.model.outputs)}

    def differentiate_experiment(
        self, experiment: Experiment, initial: Mapping[str, float] | None = None
    ) -> np.ndarray:
        """Slopes (N, ny, nf + nx) of the outputs there along the free constants and the initial states. Raises PlantRunError."""
        record, p, x0 = self._at_present(experiment, initial)
        names, free = list(self.model.values), [q.name for q in self.model.free_parameters]
        dp = np.eye(len(names))[:, [names.index(name) for name in free]]
        dp, dx0 = np.hstack([dp, np.zeros((len(names), len(x0)))]), np.eye(len(x0), len(free) + len(x0), len(free))
        return self.differentiate(record, p, dp, x0, dx0)

    def drive_experiment(self, experiment: Experiment) -> Experiment:
        """An experiment as it reaches the plant behind the effects at its inputs, at the model's present values."""
        record, p, x0 = self._at_present(experiment)
        return self._drive(experiment, self._settings(p, x0)) if self.model.effects else record.experiment

    def _at_present(
        self, experiment: Experiment, initial: Mapping[str, float] | None = None
    ) -> tuple[PlantRecord, np.ndarray, np.ndarray]:
        p, given = np.array(list(self.model.values.values())), initial or {}
        x0 = np.asarray(self.model.system.start_function(p)[0]).ravel()
        started = [given.get(s.name, value) for s, value in zip(self.model.all_states, x0, strict=True)]
        return to_plant_record(self.model, experiment), p, np.array(started, float)

    def run(self, record: Record, p: np.ndarray, x0: np.ndarray) -> np.ndarray:
        """Outputs (N, ny) over a record. Raises PlantRunError where the run fails, or failed before."""
        return self._run_at(record, self._settings(p, x0))

    def find_failure(self, record: Record, p: np.ndarray, x0: np.ndarray) -> str:
        """Why the run over a record fails; "" where it does not."""
        try:
            self.run(record, p, x0)
        except PlantRunError as error:
            return f"{error.__cause__ or error}".removeprefix(f"{self.model.title}: ")
        return ""

    def _run_at(self, record: Record, settings: np.ndarray) -> np.ndarray:
        """Outputs (N, ny) behind the effects at inputs and outputs. Raises PlantRunError."""
        assert isinstance(record, PlantRecord)
        experiment = record.experiment
        if not self.model.effects:
            return self._run_plant(experiment, settings)

        def run() -> np.ndarray:
            driven = self._drive(experiment, settings)
            return self._read(experiment, self._run_plant(driven, settings[self._own]), settings)

        return _remember(self._known, (experiment.identity, settings.tobytes()), run)

    def _drive(self, experiment: Experiment, settings: np.ndarray) -> Experiment:
        """The record as it reaches the plant. Raises PlantRunError."""
        p, x0 = (settings[part] for part in self._of_effects)
        return self._ports.drive(experiment, p, x0)

    def _read(self, experiment: Experiment, run: np.ndarray, settings: np.ndarray) -> np.ndarray:
        """A run (N, ny) as it is measured. Raises PlantRunError."""
        p, x0 = (settings[part] for part in self._of_effects)
        return self._ports.read(experiment, run, p, x0)

    @cached_property
    def _ports(self) -> PlantPorts:
        return PlantPorts(self.model)

    def _run_plant(self, experiment: Experiment, settings: np.ndarray) -> np.ndarray:
        """Outputs (N, ny) of the plant alone, over inputs as they reach it. Raises PlantRunError."""
        key = experiment.identity, settings.tobytes()
        return _remember(self._runs, key, lambda: self._simulate(experiment, settings))

    def _simulate(self, experiment: Experiment, settings: np.ndarray) -> np.ndarray:
        self.runs += 1
        self.rows += experiment.rows
        title, names = self.model.title, [self._names[k] for k in self._own]
        try:
            run = self.plant.simulate(experiment, dict(zip(names, settings.tolist(), strict=True)))
        except PlantRunError:
            self.failures += 1
            raise
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            self.failures += 1
            raise PlantRunError(f"{title}: the run failed ({error})") from error
        outputs = np.column_stack([np.asarray(run[o.name], float) for o in self.model.outputs])
        if outputs.shape != (experiment.rows, len(self.model.outputs)):
            raise ModelError(
                f"{title}: a run has shape {outputs.shape}; give one value for each of {experiment.rows} rows"
            )
        if not np.isfinite(outputs).all():
            self.failures += 1
            raise PlantRunError(f"{title}: an output is not finite to the end of the record")
        return outputs

    def residuals(self, record: Record, point: KernelPoint, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) and their Jacobian (N, ny, L), NaN in gaps and where the run fails."""
        try:
            y = self.run(record, point.p, point.x0)
            slopes = self.differentiate(record, point.p, point.dp, point.x0, point.dx0)
        except PlantRunError:
            return np.full(record.y.shape, np.nan), np.full((*record.y.shape, point.dx0.shape[1]), np.nan)
        return (record.y - y) * weight, -slopes * weight[None, :, None]

    def sums(self, record: Record, point: KernelPoint, weight: np.ndarray, rows: int | None = None) -> GaussNewtonSums:
        """Cost, gradient and Gauss-Newton matrix over the first ``rows`` samples (None: all)."""
        part = record if rows is None else record.first(rows)
        r, jacobian = self.residuals(part, point, weight)
        measured = np.isfinite(part.y)
        error, slopes = r[measured], jacobian[measured]
        failed = None if np.isfinite(error).all() else 0
        squares = np.array([float(np.nansum(r[:, j] ** 2)) for j in range(r.shape[1])])
        return check_sums(squares, measured.sum(axis=0), slopes.T @ error, slopes.T @ slopes, failed, len(part.y))

    def differentiate(
        self, record: Record, p: np.ndarray, dp: np.ndarray, x0: np.ndarray, dx0: np.ndarray
    ) -> np.ndarray:
        """Slopes (N, ny, L) of the outputs along the directions of ``dp`` and ``dx0``: the plant's own, else differences within the
        bounds, to one side, the other where a run fails, both where ``central`` or cheap; zero where neither side runs."""
        along = dp if self._ties is None else np.asarray(self._ties(p)[1]) @ dp
        along = np.concatenate([along, dx0])
        # Constants that no direction moves cost no run.
        which = np.flatnonzero(along.any(axis=1))
        return self._differentiate_at(record, self._settings(p, x0), which) @ along[which]

    def _differentiate_at(self, record: Record, settings: np.ndarray, which: np.ndarray) -> np.ndarray:
        assert isinstance(record, PlantRecord)
        experiment = record.experiment
        key = experiment.identity, settings.tobytes(), which.tobytes(), self.central
        if key not in self._slopes:
            if len(self._slopes) >= KEPT_RUNS:
                self._slopes.pop(next(iter(self._slopes)))
            self._slopes[key] = self._find_slopes(record, settings, which)
        return self._slopes[key]

    def _find_slopes(self, record: PlantRecord, settings: np.ndarray, which: np.ndarray) -> np.ndarray:
        y = self._run_at(record, settings)
        result = np.zeros((*y.shape, len(which)))
        is_own = np.isin(which, self._own)
        left: np.ndarray = np.arange(len(which))
        if self._can_differentiate and not self.central and is_own.any():
            slopes = self._ask_for_slopes(record.experiment, settings, which[is_own])
            self._can_differentiate = slopes is not None
            if slopes is not None:
                result[:, :, is_own] = slopes
                left = np.flatnonzero(~is_own)
        for column in left:
            result[:, :, column] = self._find_difference(record, settings, which[column], y)
        return result

    def _ask_for_slopes(self, experiment: Experiment, settings: np.ndarray, which: np.ndarray) -> np.ndarray | None:
        """Slopes (N, ny, n) along the plant's own constants and states as it gives them itself; None where it does not."""
        driven = self._drive(experiment, settings) if self.model.effects else experiment
        run = self._run_plant(driven, settings[self._own])
        outputs = {o.name: run[:, j] for j, o in enumerate(self.model.outputs)}
        values = {self._names[k]: float(settings[k]) for k in self._own}
        given = self.plant.differentiate(driven, values, [self._names[k] for k in which], outputs)
        if given is None:
            return None
        slopes = np.array(given, float)
        self.runs += 1
        self.rows += driven.rows * (1 + len(which))
        if not self.model.effects:
            return slopes
        # Through the effects at the outputs by differences, for which the plant is not run: r(y + h dy/dp) - r(y) over h.
        read, result = self._read(experiment, run, settings), []
        for k, number in enumerate(which):
            width = PLANT_DIFFERENCE * max(abs(float(settings[number])), self._sizes[number])
            result.append((self._read(experiment, run + width * slopes[:, :, k], settings) - read) / width)
        return np.stack(result, axis=2)

    def _find_difference(self, record: PlantRecord, settings: np.ndarray, k: int, y: np.ndarray) -> np.ndarray:
        """Slope (N, ny) along one constant or state at ``settings``, where the outputs are ``y`` (N, ny); zero where neither side runs."""
        width = PLANT_DIFFERENCE * max(abs(float(settings[k])), self._sizes[k])
        each = []
        # Inwards first, where the upper bound is near.
        for sign in (1.0, -1.0) if settings[k] + width <= self._high[k] else (-1.0, 1.0):
            moved = settings.copy()
            moved[k] += sign * width
            if not self._low[k] <= moved[k] <= self._high[k]:
                continue
            try:
                each.append((self._run_at(record, moved) - y) / (sign * width))
            except PlantRunError:
                continue
            # A run that costs nothing is worth the slope without the error of first order.
            if not (self.central or self.model.is_cheap):
                break
        # Both sides cancel the second order: half the sum of the two one-sided slopes.
        return np.mean(each, axis=0) if each else np.zeros(y.shape)


def _remember(known: dict[tuple, np.ndarray | PlantRunError], key: tuple, run: Callable[[], np.ndarray]) -> np.ndarray:
    """What ``run`` gives, kept: also a failure, as an optimiser asks the same point for its cost and for its slopes."""
    if key not in known:
        if len(known) >= KEPT_RUNS:
            known.pop(next(iter(known)))
        try:
            known[key] = run()
        except PlantRunError as error:
            known[key] = error
    result = known[key]
    if isinstance(result, PlantRunError):
        raise result
    return result


def choose_sizes(values: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Sizes (n,) of constants with start ``values`` (n,) and ``bounds`` (n, 2): the values; the width of the bounds where that is zero."""
    widths = np.diff(bounds, axis=1).ravel()
    return np.where(values != 0, np.abs(values), np.where(np.isfinite(widths), widths, 1.0))


# Finer rows in each interval over which an effect with memory moves a signal: what is held, or straight, between them instead errs by the
# square of their length.
STEPS_A_ROW = 4


class PlantPorts:
    """What lies between the records and a plant: its effects, in equations of their own; what reaches it, and what is read of its run.

    Constants ``p`` and initial states ``x0`` are those of the effects, in the order of the model.
    """

    def __init__(self, model: PlantModel) -> None:
        constants = tuple(replace(q, fixed=True) for q in model.parameters)
        bare = replace(model, effects=(), ties=(), parameters=constants, states=(), balances=ClosedBalances())
        self._title, self._labels = model.title, [i.name for i in model.inputs]
        self._outputs = [o.name for o in model.outputs]
        self._local = build_local_model(bare, None, show_inputs=True)
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
        arriving = {
            name: values[np.minimum(np.arange(finer.rows) * 2 + (finer.courses[name] == "zero"), halves.rows - 1)]
            for name, values in self._arriving(seen).items()
        }
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
    inputs = {
        n: np.repeat(u, parts)[:rows] if experiment.courses[n] == "zero" else np.interp(time, experiment.time, u)
        for n, u in experiment.inputs.items()
    }
    return Experiment(experiment.name, time, inputs, {}, experiment.hold, conditions=experiment.conditions)
