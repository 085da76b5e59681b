"""Plants that are run from outside: an FMU, a frequency response, a black box, a simulator of somebody else's.

`Plant` is what such a thing can do: run over a record, and perhaps more. `PlantModel` states its signals and constants as a model does, so
that everything which takes a model takes it: `fit`, priors, ties, several starts, profiles, comparison. What needs equations says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from greybox.base import DataError, GreyboxError, ModelError, nearest
from greybox.data.experiment import Experiment, stack_signals
from greybox.data.input_course import Hold
from greybox.model import Effect, Input, Model, Output, Parameter, State
from greybox.model.balance import ClosedBalances, closed_output
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.record import Record


class PlantRunError(GreyboxError):
    """A run of a plant that failed: the search draws back from where it was asked for."""


class PlantLostError(GreyboxError):
    """A plant whose code has ended its process again and again."""


class Plant(Protocol):
    """What can be run over a record. One method is enough; the others are abilities that a plant may have.

    ``name``, ``inputs``, ``outputs`` and ``parameters`` are those of a model (`Input`, `Output`, `Parameter` with units, bounds and start
    values). Optional: ``states`` (`State`), whose initial values a record may have for itself; `CanDifferentiate`, `CanLinearise`,
    `CanApproach`; ``cheap = True`` where a run takes no time to speak of, so that nothing is done to save runs; ``discrete = True`` for
    what steps from row to row and takes its inputs there alone; and ``is_native = True`` for machine code of others, which runs in a
    process of its own, as it may end that.

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

    def run(self, time: np.ndarray, u: np.ndarray, straight: np.ndarray) -> np.ndarray:
        """Outputs (N, ny) from rest to inputs (N, nu), those held that are not ``straight`` (nu,) between rows."""
        if not len(self.A):
            return np.asarray(u @ self.D.T)
        from scipy.signal import lsim  # half a second to import

        # The answers to the held inputs and to the straight ones add up.
        kinds = [(straight, True), (~straight, False)]
        runs = [
            lsim((self.A, self.B, self.C, self.D), np.where(which, u, 0.0), time - time[0], interp=is_straight)[1]
            for which, is_straight in kinds
            if which.any()
        ]
        return np.sum([np.reshape(y, (len(time), -1)) for y in runs], axis=0)


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


# What an effect does to balances, states and constants: inside of a plant, where no equation is open.
INSIDE = ("terms", "dry", "on_parameter", "on_state", "on_term", "on_storage")


@dataclass(frozen=True, eq=False)
class PlantModel(Model):
    """The model of a `Plant`: signals, constants and initial states as stated, and in the place of equations the plant itself.

    `Model.fix`, `free`, `start`, `bound`, `prior` and `tie` hold as for any model. ``model + effect`` is the plant with an effect at one of
    its inputs or outputs, which begins at the state that it declares.
    """

    plant: Any = None

    @property
    def may_end_process(self) -> bool:
        """Whether its runs may take their process along, which is then one of its own."""
        return bool(getattr(self.plant, "is_native", False))

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

    def __add__(self, effect: Effect) -> Model:
        if not isinstance(effect, Effect):
            return NotImplemented
        if self.equations is not None:
            raise ModelError(
                f"{self.title} rests on equations: add {effect.name} to its model, and make the plant of that"
            )
        if any(getattr(effect, name) for name in INSIDE):
            ports = ", ".join([*(i.name for i in self.inputs), *(o.name for o in self.outputs)])
            raise ModelError(
                f"effect {effect.name!r} acts inside, and {self.title} is run from outside: effects act at its inputs and outputs ({ports})"
            )
        if effect.is_of_record:
            raise ModelError(
                f"effect {effect.name!r} says how a record holds an input, and {self.title} is run from outside: say it of the record"
                " (Experiment(..., hold=...)), or correct its column"
            )
        return replace(self, effects=(*self.effects, effect))

    def require_equations(self, purpose: str) -> None:
        """Refuse ``purpose``, which begins the reason. Raises ModelError."""
        if self.equations is not None:
            raise ModelError(
                f"{self.title}: {purpose} takes the model behind this plant (``equations``), and not the plant"
            )
        super().require_equations(purpose)

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

    def with_other_course(self, column: int, name: str) -> PlantRecord:
        """The record with one input held that was straight between rows, or straight that was held."""
        other = super().with_other_course(column, name)
        assert isinstance(other, PlantRecord)
        course: Hold = "first" if other.is_linear[column] else "zero"
        return replace(other, experiment=self.experiment.with_hold({name: course}))

    def with_inputs(self, u: np.ndarray, names: Sequence[str]) -> PlantRecord:
        """The record with other values (N, nu) of its inputs, which have these names."""
        inputs = {**self.experiment.inputs, **dict(zip(names, u.T, strict=True))}
        return replace(self, u=u, experiment=replace(self.experiment, inputs=inputs))


def to_plant_record(model: PlantModel, experiment: Experiment) -> PlantRecord:
    """An experiment with its columns in the order of the plant's signals; an output that was not measured is a column of NaN.

    Raises DataError where an input is missing, or outputs were measured but none of the plant's.
    """
    missing = [i.name for i in model.inputs if i.name not in experiment.inputs]
    names = [o.name for o in model.outputs]
    if experiment.outputs_are_means or "mean" in experiment.courses.values():
        raise DataError(
            f"experiment {experiment.name!r}: hold 'mean' needs equations, and {model.title!r} is run from outside; say held ('zero') and"
            " write each mean where its interval begins"
        )
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
    return PlantRecord(u, y, h, np.zeros(len(h)), one, find_straight(experiment, model.inputs), experiment=experiment)


def find_straight(experiment: Experiment, inputs: Sequence[Input]) -> np.ndarray:
    """Which of these inputs (nu,) move between the rows of a record, and are not held."""
    return np.array([experiment.courses[i.name] != "zero" for i in inputs], bool)


def make_plant_step(model: PlantModel, method: str = "automatic", substeps: int = 0, **asked: object) -> Step:
    """What stands for a discrete step: the plant steps by itself, exactly as far as anybody here can tell.

    Raises ModelError where a ``method``, ``substeps``, or anything else that needs equations, was ``asked`` for.
    """
    given = {"method": method != "automatic" and method, "substeps": substeps if substeps > 1 else 0, **asked}
    idle = ", ".join(f"{name} {value!r}" for name, value in given.items() if value)
    if idle:
        raise ModelError(
            f"{model.title} is run from outside, as it steps by itself: {idle} would have no effect; leave it out"
        )
    nothing = ca.Function("closed", [ca.SX.sym("x", 0)], [ca.SX(0, 1)])

    def coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((1, 0)), np.zeros((1, 0, len(which)))

    return Step(f"run by {model.description}", nothing, nothing, coefficients, per_interval=True)
