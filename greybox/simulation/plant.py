"""Plants that are run from outside: an FMU, a frequency response, a black box, a simulator of somebody else's.

`Plant` is what such a thing can do: run over a record, and perhaps more. `PlantModel` states its signals and constants as a model does, so
that everything which takes a model takes it: `fit`, priors, ties, several starts, profiles, comparison. What needs equations says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from greybox.base.errors import DataError, GreyboxError, ModelError, nearest
from greybox.data.experiment import Experiment, stack_signals
from greybox.model.balance import ClosedBalances, closed_output
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.interface import GaussNewtonSums, check_sums
from greybox.simulation.kernel.record import Record


class PlantRunError(GreyboxError):
    """A run of a plant that failed: the search draws back from where it was asked for."""


class Plant(Protocol):
    """What can be run over a record. One method is enough; the others are abilities that a plant may have.

    ``name``, ``inputs``, ``outputs`` and ``parameters`` are those of a model (`Input`, `Output`, `Parameter` with units, bounds and start
    values). Optional: ``states`` (`State`), whose initial values a record may have for itself; `CanDifferentiate`, `CanLinearise`,
    `CanApproach`; and ``cheap = True`` where a run takes no time to speak of, so that nothing is done to save runs.

    Examples
    --------
    >>> class Decay:
    ...     name = "decay"
    ...     inputs = ()
    ...     outputs = (Output("y", "V"),)
    ...     parameters = (Parameter("rate", "1/s", 1.0, (0.01, 100.0)),)
    ...
    ...     def simulate(self, record, values):
    ...         return {"y": np.exp(-values["rate"] * record.time)}
    >>> as_model(Decay()).values
    {'rate': 1.0}
    """

    @property
    def name(self) -> str:
        """Letters, digits, ``_`` and ``-``."""

    @property
    def inputs(self) -> Sequence[Input]:
        """What drives it; none for what runs by itself."""

    @property
    def outputs(self) -> Sequence[Output]:
        """What is measured of it."""

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Its constants."""

    def simulate(self, record: Experiment, values: Mapping[str, float]) -> Mapping[str, np.ndarray]:
        """Outputs (N,) by name at the times of a record, with constants and initial states by name.

        Raises PlantRunError (or an ArithmeticError) where the run fails; an output that is not finite counts as such.
        """


@runtime_checkable
class CanDifferentiate(Protocol):
    """Slopes of its own. Without them a slope is a difference of two runs."""

    def differentiate(
        self, record: Experiment, values: Mapping[str, float], names: Sequence[str], outputs: Mapping[str, np.ndarray]
    ) -> np.ndarray | None:
        """Slopes (N, ny, n) of the outputs along the constants and initial states ``names`` at ``values``, where the run gave ``outputs``.

        None where it cannot give them after all: differences take their place from then on.
        """


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """``x' = A x + B du``, ``dy = C x + D du``: what small changes of the inputs change in the outputs along a run.

    Attributes
    ----------
    A, B, C, D
        Matrices (n, n), (n, nu), (ny, n), (ny, nu), continuous in time.
    explained
        Output -> share of the answer to such a change that it follows.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    explained: Mapping[str, float]

    def run(self, time: np.ndarray, u: np.ndarray, hold: str) -> np.ndarray:
        """Outputs (N, ny) from rest to inputs (N, nu)."""
        if not len(self.A):
            return np.asarray(u @ self.D.T)
        from scipy.signal import lsim  # half a second to import

        _, y, _ = lsim((self.A, self.B, self.C, self.D), u, time - time[0], interp=hold != "zero")
        return np.asarray(y).reshape(len(time), -1)


@runtime_checkable
class CanLinearise(Protocol):
    """A linear system about a run of its own."""

    def linearise(self, record: Experiment, values: Mapping[str, float]) -> LinearResponse | None:
        """The answer to small changes of the inputs along a record; None where no linear system follows it."""


@runtime_checkable
class CanApproach(Protocol):
    """Start values nearer to the records than the given ones: a first search in which a bad start does no harm."""

    def approach(
        self, records: Sequence[Experiment], values: Mapping[str, float], free: Sequence[str]
    ) -> Mapping[str, float]:
        """Better values of the constants ``free``, by name."""


# What makes a plant.
PLANT_ATTRIBUTES = ("name", "inputs", "outputs", "parameters", "simulate")


def is_plant(value: Any) -> bool:
    """Whether a value, and not a class, is a `Plant` without equations."""
    return not isinstance(value, type) and all(hasattr(value, name) for name in PLANT_ATTRIBUTES)


def as_model(plant: Model | Plant | Any) -> Model:
    """A model as it is; a plant as the model that states its signals and constants.

    Parameters
    ----------
    plant
        A `Model`, a `Plant`, or what has one as ``model``: a fit, a black box.

    Raises
    ------
    ModelError
        For anything else, with what it lacks.
    """
    if isinstance(plant, Model):
        return plant
    stated = getattr(plant, "model", None)
    if stated is not None:
        return as_model(stated)
    missing = [name for name in PLANT_ATTRIBUTES if not hasattr(plant, name)]
    if missing:
        raise ModelError(f"{type(plant).__name__} is neither a model nor a plant: it has no {', '.join(missing)}")
    return PlantModel.of(plant)


@dataclass(frozen=True, eq=False)
class PlantModel(Model):
    """The model of a `Plant`: signals, constants and initial states as stated, and in the place of equations the plant itself.

    `Model.fix`, `free`, `start`, `bound`, `prior` and `tie` hold as for any model.
    """

    plant: Any = None

    @classmethod
    def of(cls, plant: Plant) -> PlantModel:
        """The model of ``plant``. Raises ModelError for names that clash."""
        states: tuple[State, ...] = tuple(getattr(plant, "states", ()))
        return cls(
            plant.name,
            states=states,
            inputs=tuple(plant.inputs),
            outputs=tuple(replace(o, equation=closed_output) for o in plant.outputs),
            parameters=tuple(plant.parameters),
            balances=ClosedBalances(states),
            description=getattr(plant, "description", "") or type(plant).__name__,
            plant=plant,
        )

    @property
    def is_cheap(self) -> bool:
        """Whether a run takes no time to speak of."""
        return bool(getattr(self.plant, "cheap", False))

    @property
    def equations(self) -> Model | None:
        """The equations behind the plant at the present values, where it has a model with equations as ``equations``."""
        behind, constants = getattr(self.plant, "equations", None), {**self.values, **self.tied_values}
        return behind.start(**{n: constants[n] for n in behind.values}) if isinstance(behind, Model) else None

    @property
    def identity(self) -> str:
        """What tells this plant from others: its own ``identity``, or its class."""
        return str(
            getattr(self.plant, "identity", "") or f"{type(self.plant).__module__}.{type(self.plant).__qualname__}"
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class PlantRecord(Record):
    """An experiment as arrays, which a plant sees as it is."""

    experiment: Experiment

    def cut(self, first: int, end: int) -> PlantRecord:
        """Rows ``first`` up to but without ``end``; all of them are the record itself."""
        if first == 0 and end >= len(self.u):
            return self
        part = super().cut(first, end)
        assert isinstance(part, PlantRecord)
        return replace(part, experiment=self.experiment.window(first, end))


def to_plant_record(model: PlantModel, experiment: Experiment) -> PlantRecord:
    """An experiment with its columns in the order of the plant's signals; an output that was not measured is a column of NaN.

    Raises DataError where an input is missing, or outputs were measured but none of the plant's.
    """
    missing = [i.name for i in model.inputs if i.name not in experiment.inputs]
    names = [o.name for o in model.outputs]
    if missing:
        raise DataError(
            f"experiment {experiment.name!r} has no input {missing[0]!r}; {nearest(missing[0], experiment.inputs)}"
        )
    if experiment.outputs and not any(name in experiment.outputs for name in names):
        has = ", ".join(map(repr, experiment.outputs))
        raise DataError(
            f"experiment {experiment.name!r} has none of the outputs of {model.title!r}: it has {has};"
            f" {nearest(next(iter(experiment.outputs)), names)}"
        )
    gap = np.full(experiment.rows, np.nan)
    y = stack_signals([experiment.outputs.get(name, gap) for name in names], experiment.rows)
    u = stack_signals([experiment.inputs[i.name] for i in model.inputs], experiment.rows)
    h, one = experiment.intervals, np.ones(1)
    return PlantRecord(u, y, h, np.zeros(len(h)), one, experiment.hold != "zero", experiment=experiment)


def make_plant_step(model: PlantModel) -> Step:
    """What stands for a discrete step: the plant steps by itself, exactly as far as anybody here can tell."""
    nothing = ca.Function("closed", [ca.SX.sym("x", 0)], [ca.SX(0, 1)])

    def coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((1, 0)), np.zeros((1, 0, len(which)))

    return Step(f"run by {model.description}", nothing, nothing, coefficients, per_interval=True)


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
        self.model, self.plant = model, model.plant
        self.runs = self.failures = self.rows = 0
        self.central, self._can_differentiate = False, isinstance(model.plant, CanDifferentiate)
        self._known: dict[tuple, np.ndarray | PlantRunError] = {}
        self._slopes: dict[tuple, np.ndarray] = {}
        quantities = model.stated_parameters
        starts = {**model.values, **{n: float(v) for n, v in model.tied_values.items()}}
        values = np.array([*(starts[q.name] for q in quantities), *(0.0 for _ in model.all_states)])
        self._names = [*(q.name for q in quantities), *(s.name for s in model.all_states)]
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

    def run_experiment(self, experiment: Experiment) -> dict[str, np.ndarray]:
        """Outputs (N,) by name over an experiment, at the model's present values. Raises PlantRunError."""
        record, p, x0 = self._at_present(experiment)
        y = self.run(record, p, x0)
        return {o.name: y[:, j] for j, o in enumerate(self.model.outputs)}

    def differentiate_experiment(self, experiment: Experiment) -> np.ndarray:
        """Slopes (N, ny, nf) of the outputs over an experiment along the free constants. Raises PlantRunError."""
        record, p, x0 = self._at_present(experiment)
        names, free = list(self.model.values), [q.name for q in self.model.free_parameters]
        dp = np.eye(len(names))[:, [names.index(name) for name in free]]
        return self.differentiate(record, p, dp, x0, np.zeros((len(x0), len(free))))

    def _at_present(self, experiment: Experiment) -> tuple[PlantRecord, np.ndarray, np.ndarray]:
        p = np.array(list(self.model.values.values()))
        return to_plant_record(self.model, experiment), p, np.asarray(self.model.system.start_function(p)[0]).ravel()

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
        assert isinstance(record, PlantRecord)
        key = record.experiment.fingerprint, record.experiment.hold, settings.tobytes()
        if key not in self._known:
            if len(self._known) >= KEPT_RUNS:
                self._known.pop(next(iter(self._known)))
            try:
                self._known[key] = self._simulate(record.experiment, settings)
            except PlantRunError as error:
                # A failure is remembered, too: an optimiser asks the same point for its cost and for its slopes.
                self._known[key] = error
        run = self._known[key]
        if isinstance(run, PlantRunError):
            raise run
        return run

    def _simulate(self, experiment: Experiment, settings: np.ndarray) -> np.ndarray:
        self.runs += 1
        self.rows += experiment.rows
        title = self.model.title
        try:
            run = self.plant.simulate(experiment, dict(zip(self._names, settings.tolist(), strict=True)))
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

    def residuals(
        self,
        record: Record,
        q: np.ndarray,
        dq: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        x0: np.ndarray,
        dx0: np.ndarray,
        weight: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, ny) and their Jacobian (N, ny, L), NaN in gaps and where the run fails."""
        try:
            y = self.run(record, p, x0)
            slopes = self.differentiate(record, p, dp, x0, dx0)
        except PlantRunError:
            return np.full(record.y.shape, np.nan), np.full((*record.y.shape, dx0.shape[1]), np.nan)
        return (record.y - y) * weight, -slopes * weight[None, :, None]

    def sums(
        self,
        record: Record,
        q: np.ndarray,
        dq: np.ndarray,
        p: np.ndarray,
        dp: np.ndarray,
        x0: np.ndarray,
        dx0: np.ndarray,
        weight: np.ndarray,
        rows: int | None = None,
    ) -> GaussNewtonSums:
        """Cost, gradient and Gauss-Newton matrix over the first ``rows`` samples (None: all)."""
        part = record if rows is None else record.first(rows)
        r, jacobian = self.residuals(part, q, dq, p, dp, x0, dx0, weight)
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
        key = experiment.fingerprint, experiment.hold, settings.tobytes(), which.tobytes(), self.central
        if key not in self._slopes:
            if len(self._slopes) >= KEPT_RUNS:
                self._slopes.pop(next(iter(self._slopes)))
            self._slopes[key] = self._find_slopes(record, settings, which)
        return self._slopes[key]

    def _find_slopes(self, record: PlantRecord, settings: np.ndarray, which: np.ndarray) -> np.ndarray:
        y = self._run_at(record, settings)
        if self._can_differentiate and not self.central and len(which):
            outputs = {o.name: y[:, j] for j, o in enumerate(self.model.outputs)}
            values = dict(zip(self._names, settings.tolist(), strict=True))
            names = [self._names[k] for k in which]
            slopes = self.plant.differentiate(record.experiment, values, names, outputs)
            if slopes is not None:
                self.runs += 1
                self.rows += record.experiment.rows * (1 + len(which))
                return np.asarray(slopes, float)
            self._can_differentiate = False
        result = np.zeros((*y.shape, len(which)))
        for column, k in enumerate(which):
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
            if each:
                # Both sides cancel the second order: half the sum of the two one-sided slopes.
                result[:, :, column] = np.mean(each, axis=0)
        return result


def choose_sizes(values: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Sizes (n,) of constants with start ``values`` (n,) and ``bounds`` (n, 2): the values; the width of the bounds where that is zero."""
    widths = np.diff(bounds, axis=1).ravel()
    return np.where(values != 0, np.abs(values), np.where(np.isfinite(widths), widths, 1.0))
